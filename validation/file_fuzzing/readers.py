"""All file readers of wrapjax, with valid inputs and assertions on the results."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.preprocessing.marker_legs import legs_text
from validation.file_fuzzing import seeds
from wrapjax.errors import InputError, Problem

#: Modules whose coverage guides the fuzzing.
READING = (
    *(
        "wrapjax.errors",
        "wrapjax.io.files",
        "wrapjax.io.xml",
        "wrapjax.io.json_and_arrays",
        "wrapjax.subject",
    ),
    *(
        "wrapjax.preprocessing",
        "wrapjax.joints",
        "wrapjax.io",
        "wrapjax.evaluation.stored_run",
        "wrapjax.path_sources.polynomial_fit",
    ),
    *(
        "wrapjax.path_sources.polynomial_paths",
        "wrapjax.calibration.solvers.checkpoints",
        "wrapjax.report.overview",
    ),
    *("wrapjax.report.calibration.evaluation_page", "wrapjax.report.cohort_page", "wrapjax.osim.bones"),
)


@dataclass(frozen=True)
class Prepared:
    """Reader prepared in a separate folder.

    Parameters
    ----------
    file
        File that inputs are written to.
    seeds
        Valid inputs.
    read
        Function that reads the file and checks the result.
    """

    file: Path
    seeds: tuple[bytes, ...]
    read: Callable[[], object]


@dataclass(frozen=True)
class Reader:
    """Reader of one kind of file.

    Parameters
    ----------
    name
        Name in the table.
    prepare
        Function of the folder of finished results and an empty folder.
    share
        Relative number of inputs.
    archive
        Whether inputs are ``.npz`` files.
    separate_process
        Whether compiled code reads the file, so that each input needs a separate process.
    """

    name: str
    prepare: Callable[[Path, Path], Prepared]
    share: float = 1.0
    archive: bool = False
    separate_process: bool = False


def _finite(*arrays: np.ndarray) -> None:
    assert all(np.isfinite(one).all() for one in arrays), "a value is not finite"


def _storage(finished: Path, place: Path) -> Prepared:
    from wrapjax.io.storage import read_storage, read_storage_header

    file = place / "table.sto"

    def read() -> None:
        read_storage_header(file)
        table = read_storage(file)
        _finite(table.time, table.values)
        assert (np.diff(table.time) > 0.0).all() and table.values.shape[1] == len(table.columns)

    return Prepared(file, (seeds.TABLE, seeds.OLD_TABLE), read)


def _subject_part(name: str, *contents: bytes) -> Callable[[Path, Path], Prepared]:
    """Read a whole subject with one file of it changed."""

    def prepare(finished: Path, place: Path) -> Prepared:
        from wrapjax.subject.description import describe_subject, render_tables
        from wrapjax.subject.subject import load_subject

        folder = seeds.small_subject(place / "subject")

        def read() -> None:
            subject = load_subject(folder)
            trials = subject.trials
            _finite(trials.time, trials.angles, trials.angular_velocities, trials.moments, trials.emg)
            render_tables(describe_subject(subject))

        file = folder / name
        return Prepared(file, (*contents, *((file.read_bytes(),) if file.is_file() else ())), read)

    return prepare


def _plain(
    suffix: str, function: Callable[[Path], object], *contents: bytes
) -> Callable[[Path, Path], Prepared]:
    def prepare(finished: Path, place: Path) -> Prepared:
        file = place / f"input{suffix}"
        return Prepared(file, contents, lambda: function(file))

    return prepare


def _model(path: Path) -> None:
    from wrapjax.io.model_file import read_model_file

    model = read_model_file(path)
    muscles = model.muscles
    _finite(muscles.max_isometric_force, muscles.optimal_fiber_length, muscles.tendon_slack_length)
    _finite(muscles.pennation_angle, np.array([one.default_value for one in model.coordinates]))


def _muscles(path: Path) -> None:
    from wrapjax.subject.muscle_parameters import read_muscle_parameters

    read_muscle_parameters(path)


def _loads(path: Path) -> None:
    from wrapjax.subject.external_loads import read_external_loads

    read_external_loads(path)


def _bone(path: Path) -> None:
    from wrapjax.osim.bones import read_vtp

    vertices, triangles = read_vtp(path)
    _finite(vertices)
    assert not triangles.size or triangles.max() < len(vertices), "a triangle has no vertex"


def _osimx(path: Path) -> None:
    from wrapjax.preprocessing.nmsm.files import read_osimx

    for muscle in read_osimx(path):
        _finite(np.array(list(muscle.values.values())))


def _trc(path: Path) -> None:
    from wrapjax.preprocessing.files.markers import read_trc

    markers = read_trc(path)
    _finite(markers.time)
    assert not np.isinf(markers.positions).any(), "a position is infinite"


def _c3d(finished: Path, place: Path) -> Prepared:
    from tests.preprocessing import c3d_file
    from wrapjax.preprocessing.files.c3d import read_c3d_analog, read_c3d_markers, read_plates
    from wrapjax.preprocessing.gait.force_plates import ForceColumns

    valid, file = place / "valid.c3d", place / "input.c3d"
    c3d_file.write(str(valid), 1.0, "mm")

    def read() -> None:
        read_c3d_markers(file)
        read_c3d_analog(file)
        read_plates(file, {"l": ForceColumns("calcn_l", plates=(1,))}, np.eye(3))

    return Prepared(file, (valid.read_bytes(),), read)


def _project(finished: Path, place: Path) -> Prepared:
    from wrapjax.preprocessing.nmsm.project import read_project

    file = seeds.nmsm_project(place / "project") / "settings.xml"
    return Prepared(file, (seeds.PROJECT,), lambda: read_project(file))


def _laboratory(finished: Path, place: Path) -> Prepared:
    from wrapjax.preprocessing.files.laboratory_settings import read_laboratory_settings

    file = seeds.laboratory(place / "laboratory") / "prepare.toml"
    return Prepared(file, (seeds.LABORATORY,), lambda: read_laboratory_settings(file))


def _joint_settings(finished: Path, place: Path) -> Prepared:
    from wrapjax.joints.settings import read_joint_settings

    file = seeds.laboratory(place / "laboratory") / "joints.toml"
    return Prepared(file, (seeds.JOINT_SETTINGS, seeds.LABORATORY), lambda: read_joint_settings(file))


def _joint_tasks(finished: Path, place: Path) -> Prepared:
    from wrapjax.joints.nmsm_settings import read_nmsm_settings

    file = seeds.laboratory(place / "laboratory") / "settings.xml"
    (file.parent / "model.osim").write_text(legs_text())
    return Prepared(file, (seeds.JOINT_TASKS,), lambda: read_nmsm_settings(file))


def _joint_spread(path: Path) -> None:
    from wrapjax.subject.joint_spread import read_joint_spread

    for spread in read_joint_spread(path, ["hip_flexion_l", "knee_angle_l"]).values():
        known = [value for value in (*spread.translation, *spread.orientation) if value is not None]
        _finite(np.array(known))


def _opensim(finished: Path, place: Path) -> Prepared:
    from wrapjax.io.model_file import read_model_file
    from wrapjax.osim.loading import import_opensim
    from wrapjax.osim.model import describe_model

    import_opensim()
    file = place / "model.osim"

    def read() -> None:
        read_model_file(file)
        describe_model(file)

    return Prepared(file, (seeds.PLAIN_MODEL,), read)


def _run_part(name: str) -> Callable[[Path, Path], Prepared]:
    def prepare(finished: Path, place: Path) -> Prepared:
        from wrapjax.evaluation.stored_run import load_run

        folder = Path(shutil.copytree(finished / "run", place / "run"))
        return Prepared(folder / name, ((folder / name).read_bytes(),), lambda: load_run(folder))

    return prepare


def _fit_part(name: str) -> Callable[[Path, Path], Prepared]:
    def prepare(finished: Path, place: Path) -> Prepared:
        from wrapjax.path_sources.polynomial_fit import load_fit

        folder = Path(shutil.copytree(finished / "fit", place / "fit"))
        return Prepared(folder / name, ((folder / name).read_bytes(),), lambda: load_fit(folder))

    return prepare


def _journal(finished: Path, place: Path) -> Prepared:
    from wrapjax.calibration.solvers.checkpoints import Checkpoints

    folder = Path(shutil.copytree(finished / "journal", place / "journal"))
    question = json.loads((folder / "question.json").read_text())["question"]
    entries = sorted(folder.glob("start_*.npz"))
    checkpoints = Checkpoints.open(folder, question, resume=True)

    def read() -> None:
        # A damaged checkpoint is ignored, and its work is repeated.
        if checkpoints.read(entries[0].stem) is None:
            raise InputError(Problem(entries[0].name, "is damaged"))

    return Prepared(entries[0], (entries[0].read_bytes(),), read)


def _fingerprint(finished: Path, place: Path) -> Prepared:
    from wrapjax.calibration.solvers.checkpoints import Checkpoints

    folder = Path(shutil.copytree(finished / "journal", place / "journal"))
    file = folder / "question.json"
    question = json.loads(file.read_text())["question"]
    return Prepared(file, (file.read_bytes(),), lambda: Checkpoints.open(folder, question, resume=True))


def _redrawn(kind: str, file: str) -> Callable[[Path, Path], Prepared]:
    def prepare(finished: Path, place: Path) -> Prepared:
        from wrapjax.cli.report import redraw

        folder = Path(shutil.copytree(finished / kind, place / kind))
        return Prepared(folder / file, ((folder / file).read_bytes(),), lambda: redraw(folder))

    return prepare


def _overview(finished: Path, place: Path) -> Prepared:
    from wrapjax.report.overview import KINDS, find_results, render_overview

    folders = {"cohort": "cohort", "evaluation": "evaluation", "fit": "fit", "calibration": "run"}
    contents = tuple((finished / own / KINDS[kind].file).read_bytes() for kind, own in folders.items())
    results = place / "results"
    results.mkdir()
    written = results / "input.json"

    def read() -> None:
        # Write the same input in the place of every kind of result.
        for kind in KINDS:
            own = results / kind
            own.mkdir(exist_ok=True)
            shutil.copyfile(written, own / KINDS[kind].file)
        render_overview(results, find_results(results))

    return Prepared(written, contents, read)


#: Readers by name, in the order of the table.
READERS: dict[str, Reader] = {
    reader.name: reader
    for reader in (
        Reader("table (.sto, .mot)", _storage, 3.0),
        Reader("subject.toml", _subject_part("subject.toml", seeds.SUBJECT_SETTINGS, seeds.WITH_TABLE), 3.0),
        Reader("angles of a subject", _subject_part("trials/walk_a/angles.sto")),
        Reader("EMG of a subject", _subject_part("trials/walk_a/emg.sto")),
        Reader("muscle parameters (.csv)", _plain(".csv", _muscles, seeds.MUSCLE_PARAMETERS), 2.0),
        Reader("model (.osim)", _plain(".osim", _model, seeds.PLAIN_MODEL, seeds.OLD_MODEL), 3.0),
        Reader("external loads (.xml)", _plain(".xml", _loads, seeds.EXTERNAL_LOADS)),
        Reader("bone (.vtp)", _plain(".vtp", _bone, seeds.BONE)),
        Reader("muscles (.osimx)", _plain(".osimx", _osimx, seeds.OSIMX)),
        Reader("NMSM project (.xml)", _project),
        Reader("laboratory's settings (.toml)", _laboratory, 2.0),
        Reader("markers (.trc)", _plain(".trc", _trc, seeds.MARKERS), 2.0),
        Reader("joints' settings (.toml)", _joint_settings),
        Reader("joints' tasks of the NMSM Pipeline (.xml)", _joint_tasks, 0.1, separate_process=True),
        Reader("joints.json", _plain(".json", _joint_spread, seeds.JOINTS)),
        Reader("summary.json of a run", _run_part("summary.json")),
        Reader("settings.json of a run", _run_part("settings.json")),
        Reader("parameters.csv of a run", _run_part("parameters.csv")),
        Reader("paths.npz of a run", _run_part("paths.npz"), archive=True),
        Reader("fit.json", _fit_part("fit.json")),
        Reader("fit.npz", _fit_part("fit.npz"), archive=True),
        Reader("journal's entry (.npz)", _journal, archive=True),
        Reader("journal's question (.json)", _fingerprint),
        Reader("evaluation.json", _redrawn("evaluation", "evaluation.json"), 0.05),
        Reader("cohort.json", _redrawn("cohort", "cohort.json"), 0.05),
        Reader("results for an index (.json)", _overview, 0.5),
        Reader("markers and forces (.c3d)", _c3d, 0.1, separate_process=True),
        Reader("model, by OpenSim (.osim)", _opensim, 0.1, separate_process=True),
    )
}
