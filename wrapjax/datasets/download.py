"""Downloads, checked against their checksums and kept for the next time.

``fetch``: recordings that others made public, as subject folders.
"""

from __future__ import annotations

from pathlib import Path

from wrapjax.datasets.public_recordings import PUBLIC_RECORDINGS, PublicFile, PublicRecording
from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import cache_folder, new_folder, write_text
from wrapjax.progress import progress_bar

#: Where repositories are read from, file by file.
SERVER = "https://raw.githubusercontent.com"
#: How often a download that failed, or came damaged, is tried again.
RETRIES = 3


def write_public_subject(
    recording: PublicRecording,
    folder: Path,
    *,
    server: str = SERVER,
    force: bool = False,
    quiet: bool = True,
) -> None:
    """Download a recording and write it as a subject folder.

    Files are kept in the user's cache: what is there, and has the right checksum, is not asked for again.

    Parameters
    ----------
    recording
        One of `PUBLIC_RECORDINGS`.
    folder
        Where to; it appears when complete.
    server
        Where repositories are read from.
    force
        Replace a folder that exists.
    quiet
        Print no progress.

    Raises
    ------
    InputError
        If a file cannot be had, or is another than was published; nothing is then written.
    """
    with new_folder(folder, force=force) as place:
        with progress_bar(f"fetching {recording.name}", len(recording.files), quiet=quiet) as advance:
            for number, file in enumerate(recording.files, start=1):
                content = _download(recording, file, server).read_bytes()
                for published, ours in file.renamed:
                    content = content.replace(published.encode(), ours.encode())
                target = place / file.target
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
                advance(number)
        write_text(place / "ORIGIN.txt", recording.origin)
        for own, text in recording.own_files.items():
            write_text(place / own, text)


def _download(recording: PublicRecording, file: PublicFile, server: str) -> Path:
    """Give a file out of the cache, downloaded if it is not there."""
    import pooch
    from requests.exceptions import HTTPError, RequestException

    pooch.get_logger().setLevel("ERROR")
    url = f"{server}/{recording.place}/{file.source}"
    store = pooch.create(
        path=cache_folder("public") / recording.name,
        base_url=f"{server}/{recording.place}/",
        registry={file.source: f"sha256:{file.sha256}"},
        retry_if_failed=RETRIES,
    )
    try:
        return Path(store.fetch(file.source))
    except HTTPError as error:
        answer = "nothing" if error.response is None else f"status {error.response.status_code}"
        message = f"cannot be downloaded: the server answered with {answer}"
        problem = Problem(url, message, hint="try again later; what was downloaded is kept")
    except RequestException as error:
        message = f"cannot be downloaded: no answer ({type(error).__name__})"
        problem = Problem(url, message, hint="is this machine online? What was downloaded before is kept")
    except ValueError:
        message = "is damaged on its way, or is another file than was published: its checksum is wrong"
        problem = Problem(url, message, hint="try again later; nothing of it was used")
    raise InputError(problem)


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
