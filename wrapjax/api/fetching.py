"""``fetch``: recordings that others made public, as subject folders."""

from __future__ import annotations

from pathlib import Path

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.public import PUBLIC_RECORDINGS, SERVER, write_public_subject


def fetch(
    name: str,
    folder: str | Path | None = None,
    *,
    server: str = SERVER,
    force: bool = False,
    quiet: bool = True,
) -> Path:
    """Download a public recording of walking as a subject folder.

    Parameters
    ----------
    name
        One of `public_recordings`.
    folder
        Where to; by default a folder of that name here.
    server
        Where repositories are read from: the public one, or a mirror.
    force
        Replace a folder that exists.
    quiet
        Print no progress.

    Returns
    -------
    Path
        The folder, for `load_subject`.

    Raises
    ------
    InputError
        If there is no such recording, or a file cannot be had or is another than was published.
    """
    if name not in PUBLIC_RECORDINGS:
        hint = nearest_name(name, tuple(PUBLIC_RECORDINGS))
        raise InputError(Problem(name, "is no public recording that can be fetched", hint=hint))
    place = Path(name if folder is None else folder)
    write_public_subject(PUBLIC_RECORDINGS[name], place, server=server, force=force, quiet=quiet)
    return place


def public_recordings() -> dict[str, str]:
    """Say what each recording that can be fetched is, by name."""
    return {name: f"{one.about}. Licence {one.licence}" for name, one in PUBLIC_RECORDINGS.items()}
