"""Download of public recordings as subject folders, verified by checksums and cached."""

from __future__ import annotations

from pathlib import Path

from wrapjax.datasets.public_recordings import PUBLIC_RECORDINGS, PublicFile, PublicRecording
from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import cache_folder, new_folder, write_text
from wrapjax.progress import progress_bar

#: Server of the repositories' files.
SERVER = "https://raw.githubusercontent.com"
#: Number of further attempts after a failed or damaged download.
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

    Files are kept in the user's cache; a cached file with the right checksum is not downloaded again.

    Parameters
    ----------
    recording
        One of `PUBLIC_RECORDINGS`.
    folder
        Subject folder to write; it appears when it is complete.
    server
        Server of the files: the public one or a mirror.
    force
        Replace an existing folder.
    quiet
        Print no progress.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or a file cannot be downloaded or differs from the
        published one. Nothing is then written.
    """
    with new_folder(folder, force=force) as place:
        with progress_bar(f"fetching {recording.name}", len(recording.files), quiet=quiet) as advance:
            for number, file in enumerate(recording.files, start=1):
                content = _download(recording, file, server).read_bytes()
                for published, local in file.renamed:
                    content = content.replace(published.encode(), local.encode())
                target = place / file.target
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
                advance(number)
        write_text(place / "ORIGIN.txt", recording.origin)
        for name, text in recording.added_files.items():
            write_text(place / name, text)


def _download(recording: PublicRecording, file: PublicFile, server: str) -> Path:
    """Return the cached copy of a file, and download it if there is none."""
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
        message = "is damaged or differs from the published file: its checksum is wrong"
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
        Name of the recording, one of `public_recordings`.
    folder
        Subject folder to write; by default a folder of that name in the current folder.
    server
        Server of the files: the public one or a mirror.
    force
        Replace an existing folder.
    quiet
        Print no progress.

    Returns
    -------
    Path
        The subject folder, for `load_subject`.

    Raises
    ------
    InputError
        If there is no such recording, the folder exists and ``force`` is not set, or a file cannot be
        downloaded or differs from the published one.
    """
    if name not in PUBLIC_RECORDINGS:
        hint = nearest_name(name, tuple(PUBLIC_RECORDINGS))
        raise InputError(Problem(name, "is no public recording that can be fetched", hint=hint))
    place = Path(name if folder is None else folder)
    write_public_subject(PUBLIC_RECORDINGS[name], place, server=server, force=force, quiet=quiet)
    return place


def public_recordings() -> dict[str, str]:
    """Return the description of each public recording, by name."""
    return {
        name: f"{recording.about}. Licence {recording.licence}"
        for name, recording in PUBLIC_RECORDINGS.items()
    }
