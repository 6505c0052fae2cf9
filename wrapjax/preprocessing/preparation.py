"""From a laboratory's raw files to a subject folder."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.io.model_file import read_model_file
from wrapjax.io.toml import collecting
from wrapjax.osim.model import describe_model
from wrapjax.osim.tools import marker_names, scale_model
from wrapjax.preprocessing.force_plates import SIDES
from wrapjax.preprocessing.joint_angles import couplers_of
from wrapjax.preprocessing.laboratory_settings import RawSettings, read_raw_settings
from wrapjax.preprocessing.nmsm_paths import geometry_notes
from wrapjax.preprocessing.nmsm_project import Project, fill_subject_folder, read_project
from wrapjax.preprocessing.prepared_folder import PreparedTrial, write_folder
from wrapjax.preprocessing.raw_trial import RawModel, prepare_trial
from wrapjax.subject.description import Table
from wrapjax.subject.subject import agrees_with_model, load_subject, looks_like_pounds, mass_beside_model


@dataclass(frozen=True)
class Preparation:
    """A laboratory's files, made ready.

    Parameters
    ----------
    settings
        What was asked for.
    model
        The scaled model, as an ``.osim`` document.
    trials
        In the order of the settings.
    """

    settings: RawSettings
    model: bytes
    trials: tuple[PreparedTrial, ...]

    def save(self, folder: Path | str, *, force: bool = False) -> None:
        """Write the subject folder, whole or not at all, and only if it can be read as one.

        Raises
        ------
        InputError
            If the folder exists, or what would be written is no fit subject.
        """
        folder = Path(folder)
        with new_folder(folder, force=force) as temporary, _called(temporary, folder):
            with tempfile.TemporaryDirectory(prefix="wrapjax-") as beside:
                file = Path(beside) / "model.osim"
                file.write_bytes(self.model)
                write_folder(temporary, self.settings, file, self.trials)
            write_json(temporary / "preparation.json", self.summary())
            _write_page(temporary, self.tables(), "markers, forces and raw EMG", self.trials)

    def summary(self) -> dict:
        """Give what ``preparation.json`` holds: filters, cycles, checks with numbers, notes of each trial."""
        return {
            "schema": 1,
            "subject": self.settings.name,
            "trials": {
                prepared.trial.name: {
                    "motion_and_force_low_pass_hz": prepared.cutoff_hz,
                    "cycles": prepared.cycles,
                    "checks": [asdict(check) for check in prepared.checks],
                    "notes": prepared.notes,
                }
                for prepared in self.trials
            },
        }

    def tables(self) -> tuple[Table, ...]:
        """Give what the command prints: trials, then every check."""
        trials = tuple(
            (each.trial.name, each.trial.use, len(each.cycles), each.cutoff_hz) for each in self.trials
        )
        rows = tuple((each.trial.name, check.found) for each in self.trials for check in each.checks)
        notes = tuple((each.trial.name, note) for each in self.trials for note in each.notes)
        return (
            Table("Trials", ("trial", "use", "cycles", "low-pass (Hz)"), trials),
            Table("Checks", ("trial", "found"), rows),
            Table("Notes", ("trial", "note"), notes),
        )


@dataclass(frozen=True)
class ProjectPreparation:
    """A project of the NMSM Pipeline, whose files are taken over as they are."""

    project: Project

    def save(self, folder: Path | str, *, force: bool = False) -> None:
        """Write the subject folder, whole or not at all, and only if it can be read as one.

        Raises
        ------
        InputError
            If the folder exists, or what would be written is no fit subject.
        """
        folder = Path(folder)
        with new_folder(folder, force=force) as temporary, _called(temporary, folder):
            fill_subject_folder(self.project, temporary, folder.name)
            shutil.copyfile(self.project.settings.file, temporary / "prepared_from.xml")
            write_json(temporary / "preparation.json", self.summary())
            _write_page(temporary, self.tables(), "a project of the NMSM Pipeline")

    def summary(self) -> dict:
        """Give what ``preparation.json`` holds: where it is from, cycles, notes."""
        return {
            "schema": 1,
            "project": str(self.project.settings.file),
            "trials": {trial.name: {"cycles": [trial.cycle]} for trial in self.project.trials},
            "notes": self.project.notes,
        }

    def tables(self) -> tuple[Table, ...]:
        """Give what the command prints."""
        trials = tuple((trial.name, *trial.cycle) for trial in self.project.trials)
        channels = tuple((name, ", ".join(own)) for name, own in self.project.channels.items())
        notes = tuple((note,) for note in self.project.notes)
        return (
            Table("Trials", ("trial", "from (s)", "to (s)"), trials),
            Table("Channels", ("channel", "muscles"), channels),
            Table("Notes", ("note",), notes),
        )


def prepare_subject(
    settings_file: Path | str, *, log: Callable[[str], None] = lambda line: None
) -> Preparation | ProjectPreparation:
    """Read a laboratory's raw files, check that they belong together, and solve motion and moments.

    Or, by the settings (``.xml``) of the NMSM Pipeline's muscle-tendon personalisation, take over what that
    project holds already; its ``MAData`` are compared with its model's own muscle paths.

    Markers and forces are filtered low-pass at 7 over the gait period, forwards and backwards; OpenSim's own
    tools solve angles and moments. EMG stays raw: `load_subject` filters it.

    Parameters
    ----------
    settings_file
        TOML: who, which model, which files, whose forces, which electrodes. Or a project's XML.
    tell
        Called with a line of progress.

    Returns
    -------
    Preparation or ProjectPreparation
        With ``save``.

    Raises
    ------
    InputError
        With everything wrong in the files, and every check that failed, with its numbers.

    Examples
    --------
    >>> wrapjax.prepare_subject("lab/prepare.toml").save("P07_left")  # doctest: +SKIP
    """
    if Path(settings_file).suffix.lower() == ".xml":
        project = read_project(settings_file)
        notes = (*project.notes, *geometry_notes(project, log))
        return ProjectPreparation(replace(project, notes=notes))
    settings = read_raw_settings(Path(settings_file))
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        path = settings.model_file
        if settings.scaling is not None:
            log("scaling the model")
            path = Path(folder) / "scaled.osim"
            scale_model(settings.model_file, settings.scaling, settings.mass_kg, path)
        model = _model(path, settings)
        problems: list[Problem] = []
        trials = []
        for trial in settings.trials:
            with collecting(problems):
                trials.append(prepare_trial(trial, settings, model, log))
        if problems:
            raise InputError(dict.fromkeys(problems))
        return Preparation(settings, path.read_bytes(), tuple(trials))


def _model(path: Path, settings: RawSettings) -> RawModel:
    """Read the model, and check what the settings name in it."""
    file = read_model_file(path)
    description = describe_model(path)
    known = tuple(info.name for info in file.coordinates)
    problems = [
        Problem(
            str(settings.file),
            f"coordinate '{name}' is not in the model",
            "[model]",
            nearest_name(name, known),
        )
        for name in settings.coordinates
        if name not in known
    ]
    bodies = tuple(joint.child_body for joint in description.joints)
    problems += [
        Problem(
            str(settings.file),
            f"body '{foot.body}' is not in the model",
            f"[forces.{side}] body",
            nearest_name(foot.body, bodies),
        )
        for side, foot in settings.feet.items()
        if foot.body not in bodies
    ]
    # The scale tool makes bodies as heavy as it is told.
    if settings.scaling is None and not agrees_with_model(settings.mass_kg, file.mass_kg):
        beside = mass_beside_model(settings.mass_kg, file.mass_kg)
        pounds = looks_like_pounds(settings.mass_kg, file.mass_kg)
        problems.append(
            Problem(
                str(settings.file),
                f"expected the mass of a model scaled to the person, found that {beside}",
                "[subject] mass_kg",
                "is it in lb? Give kg" if pounds else "scale the model to the person, or correct mass_kg",
            )
        )
    if problems:
        raise InputError(problems)
    return RawModel(path, file, couplers_of(description.coordinates), marker_names(path))


def _write_page(
    folder: Path, tables: Sequence[Table], came_from: str, trials: Sequence[PreparedTrial] = ()
) -> None:
    """Read what was written as commands will, and show it."""
    from wrapjax.report.preparation_page import ForceTrace, render_preparation

    forces = [
        ForceTrace(
            trial=each.trial.name,
            cycles=each.cycles,
            time=each.forces.time,
            vertical={SIDES[side]: each.forces.vertical(side) for side in each.forces.sides},
            needed_time=each.needed_time,
            needed=each.needed_force,
        )
        for each in trials
    ]
    page = render_preparation(load_subject(folder), tables, forces, came_from)
    write_text(folder / "report.html", page)


@contextmanager
def _called(temporary: Path, folder: Path) -> Iterator[None]:
    """Name files by where they would have been."""
    try:
        yield
    except InputError as error:
        raise InputError(
            replace(problem, file=problem.file.replace(str(temporary), str(folder)))
            for problem in error.problems
        ) from error
