"""Recordings that others made public: where they are, and their way into subject folders."""

from wrapjax.public.catalogue import PUBLIC_RECORDINGS as PUBLIC_RECORDINGS
from wrapjax.public.catalogue import PublicFile as PublicFile
from wrapjax.public.catalogue import PublicRecording as PublicRecording
from wrapjax.public.download import SERVER as SERVER
from wrapjax.public.download import write_public_subject as write_public_subject

__all__ = ["PUBLIC_RECORDINGS", "SERVER", "PublicFile", "PublicRecording", "write_public_subject"]
