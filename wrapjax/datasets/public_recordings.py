"""Public recordings and their download as subject folders, verified by the checksum of every file."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import cache_folder, new_folder, write_text
from wrapjax.progress import progress_bar

#: Server of the repositories' files.
SERVER = "https://raw.githubusercontent.com"
#: Number of further attempts after a failed or damaged download.
RETRIES = 3


@dataclass(frozen=True)
class PublicFile:
    """One file of a public recording.

    Parameters
    ----------
    source
        Name of the published file.
    target
        Path in the subject folder.
    sha256
        Checksum of the published file.
    renamed
        Pairs of the published and the local names of other files that this one mentions.
    """

    source: str
    target: str
    sha256: str
    renamed: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class PublicRecording:
    """Published recording of walking from which a subject folder can be made.

    Parameters
    ----------
    name
        Name of the recording and of the subject.
    about
        Description of the subject and of the recorded signals.
    place
        Repository (owner/name), commit and folder, separated by slashes.
    licence
        Licence of the published files.
    files
        Files to download.
    added
        Pairs of a file of this package and its path in the subject folder, for data that the recording needs
        and that were not published with it.
    """

    name: str
    about: str
    place: str
    licence: str
    files: tuple[PublicFile, ...]
    added: tuple[tuple[str, str], ...] = ()

    @property
    def added_files(self) -> dict[str, str]:
        """Text of the files that the package adds, by path in the subject folder; ``subject.toml`` first."""
        package = files("wrapjax.datasets")
        sources = ((f"{self.name}.toml", "subject.toml"), *self.added)
        return {target: package.joinpath(source).read_text(encoding="utf-8") for source, target in sources}

    @property
    def origin(self) -> str:
        """Content of ``ORIGIN.txt``: source and licence of the files, and changes to them."""
        repository = "/".join(self.place.split("/")[:2])
        commit = self.place.split("/")[2]
        return (
            f"{self.about}.\n\n"
            f"Downloaded from github.com/{repository}, commit {commit},\n"
            f"folder {'/'.join(self.place.split('/')[3:])}; licence {self.licence}.\n"
            f"Added by wrapjax: {', '.join(self.added_files)}. Files were renamed, also in files that name "
            f"them;\n"
            "nothing else was changed.\n"
        )


_OVERGROUND = PublicRecording(
    name="healthy_overground",
    about="A healthy adult walking overground: one cycle of the right leg, 10 EMG channels, ground forces",
    place="opensim-org/opensim-core/0435b081dc383498e217f92ca63bb97616145c14"
    "/OpenSim/Examples/Moco/example3DWalking",
    licence="Apache-2.0",
    files=(
        PublicFile(
            "subject_walk_scaled.osim",
            "model.osim",
            "806ad1b248c6b2bc48ab43b58865915d1664e144b4ff6846457d80adacc23ce5",
        ),
        PublicFile(
            "coordinates.sto",
            "trials/walk/angles.sto",
            "981e94b5d7bb6fcae403a381fee8c3011533d8c683b17460096b400d20044cdb",
        ),
        PublicFile(
            "id_walk.sto",
            "trials/walk/moments.sto",
            "5eabf736a0f239b24eed4725289b5217b30d7fa0d88ad6f0f994cb33bdfd4515",
        ),
        PublicFile(
            "electromyography.sto",
            "trials/walk/emg.sto",
            "0746a08b1107f816ef35183d7639ca46dc863b60e178404d822ddc42fbb58061",
        ),
        PublicFile(
            "grf_walk.mot",
            "trials/walk/ground_forces.mot",
            "372d59855f80d7de81303cb7d3a5c5878ef8e0cb82a53a27cfce44e93357e42c",
        ),
        PublicFile(
            "grf_walk.xml",
            "trials/walk/external_loads.xml",
            "3c5313d5680c52fd130a0ed86620472fe3c576a5a9599ed08a53652b84dd82e6",
            renamed=(("grf_walk.mot", "ground_forces.mot"),),
        ),
    ),
)

_TREADMILL = PublicRecording(
    name="healthy_treadmill",
    about="A healthy adult on a treadmill for a minute: 53 cycles of the left leg, 6 EMG channels about knee "
    "and ankle, ground forces",
    place="stanfordnmbl/MatlabStaticOptimization/7a54da3008cb9949722681b346ebe8d8f1bf04e7/TestData",
    licence="Apache-2.0",
    files=(
        PublicFile(
            "Rajagopal_scaled_Sub1_gasAvoid.osim",
            "model.osim",
            "eec9c15fa28ca26137454b713b32be1dec87b9b9e683b2ddc9a1b8c05ed31c42",
        ),
        PublicFile(
            "results_ik.sto",
            "trials/walk/angles.sto",
            "3d794a53658b1ffa71088aa3b99446a930de8e641f9495c44783d4ec66f0a1e8",
        ),
        PublicFile(
            "results_id.sto",
            "trials/walk/moments.sto",
            "bd163bbdf2a2a640a17e05d7a64fa2c9408e323a8d2af253363ce5f81d1e432e",
        ),
        PublicFile(
            "EMG_allMuscles.sto",
            "trials/walk/emg.sto",
            "9550875ec3cf959158db92e7ca568a60e3d542a3de458fb6b90a5d1bd5118158",
        ),
        PublicFile(
            "walking_baseline1_forces.mot",
            "trials/walk/ground_forces.mot",
            "1c7541c3b9565f0ebf9e2db9cc0221935c23b0715512c8baf323c08a3d44614c",
        ),
    ),
    # Assigns the columns of the ground forces to the feet: inverse dynamics with it give the published
    # moments.
    added=(("healthy_treadmill_external_loads.xml", "trials/walk/external_loads.xml"),),
)

#: Public recordings by name.
PUBLIC_RECORDINGS = {recording.name: recording for recording in (_OVERGROUND, _TREADMILL)}


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
