"""Preparation of a subject folder from a laboratory's raw files, or from a project of the NMSM Pipeline."""

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
from wrapjax.io.storage import Storage
from wrapjax.io.toml import collect_problems
from wrapjax.osim.model import describe_model
from wrapjax.osim.tools import marker_names, scale_masses, scale_model
from wrapjax.preprocessing.files.joint_angles import find_coupled_coordinates
from wrapjax.preprocessing.files.laboratory_settings import LaboratorySettings, read_laboratory_settings
from wrapjax.preprocessing.files.recorded_files import PreparationModel, read_emg
from wrapjax.preprocessing.gait.force_plates import SIDES
from wrapjax.preprocessing.nmsm.muscle_analysis import compare_muscle_analyses
from wrapjax.preprocessing.nmsm.project import Project, read_project, write_project_as_subject
from wrapjax.preprocessing.prepared_folder import RAW_TITLE, PreparedTrial, write_subject_folder
from wrapjax.preprocessing.trial_preparation import prepare_trial
from wrapjax.renamed import renamed_arguments
from wrapjax.subject.description import Table
from wrapjax.subject.subject import (
    describe_masses,
    load_subject,
    mass_agrees_with_model,
    mass_looks_like_pounds,
)

_NONE_KEPT_BACK = (
    "no cycle is kept back for validation; of one long recording, list some in a second [[trial]] with "
    'use = "validation"'
)


@dataclass(frozen=True)
class Preparation:
    """Subject prepared from a laboratory's raw files.

    Parameters
    ----------
    settings
        Laboratory settings.
    model
        Scaled model: bytes of its ``.osim`` file.
    trials
        Prepared trials, in the order of the settings.
    notes
        Remarks on the model.
    contractions
        Raw EMG of maximal contractions, V.
    """

    settings: LaboratorySettings
    model: bytes
    trials: tuple[PreparedTrial, ...]
    notes: tuple[str, ...] = ()
    contractions: tuple[Storage, ...] = ()

    def save(self, folder: Path | str, *, force: bool = False) -> None:
        """Write the subject folder atomically, provided that `load_subject` can read it.

        Parameters
        ----------
        folder
            Subject folder to create.
        force
            Replace an existing folder.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is false, or the result is not a valid subject.
        """
        folder = Path(folder)
        with new_folder(folder, force=force) as temporary, _errors_naming(temporary, folder):
            with tempfile.TemporaryDirectory(prefix="wrapjax-") as beside:
                file = Path(beside) / "model.osim"
                file.write_bytes(self.model)
                write_subject_folder(temporary, self.settings, file, self.trials, self.contractions)
            write_json(temporary / "preparation.json", self.summary())
            _write_page(temporary, self.tables(), self._sources(), self.trials)

    def summary(self) -> dict:
        """Return the content of ``preparation.json``: filters, cycles, checks and notes of each trial."""
        return {
            "schema": 1,
            "subject": self.settings.name,
            **({"notes": self.notes} if self.notes else {}),
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

    def _sources(self) -> str:
        """Write what the recordings consist of, as 'markers, ground forces and raw EMG'."""
        given = [prepared.trial for prepared in self.trials]
        raw = self.settings.emg_kind == "raw"
        parts = {
            "markers": any(trial.markers for trial in given),
            "joint angles": any(trial.angles for trial in given),
            "ground forces": any(trial.forces for trial in given),
            "joint moments": any(trial.moments for trial in given),
            "dynamometers": any(trial.dynamometer for trial in given),
            "raw EMG" if raw else "EMG envelopes": any(trial.emg for trial in given),
        }
        *first, last = [name for name, present in parts.items() if present]
        return f"{', '.join(first)} and {last}" if first else last

    def tables(self) -> tuple[Table, ...]:
        """Return the tables that `wrapjax prepare` prints: trials, checks and notes."""
        trials = tuple(
            (prepared.trial.name, prepared.trial.use, len(prepared.cycles), prepared.cutoff_hz)
            for prepared in self.trials
        )
        checks = tuple(
            (prepared.trial.name, check.found) for prepared in self.trials for check in prepared.checks
        )
        notes = (
            *(("model", note) for note in self.notes),
            *([] if "validation" in {use for _, use, *_ in trials} else [("all", _NONE_KEPT_BACK)]),
            *((prepared.trial.name, note) for prepared in self.trials for note in prepared.notes),
        )
        return (
            Table("Trials", ("trial", "use", "cycles", "low-pass (Hz)"), trials),
            Table("Checks", ("trial", "found"), checks),
            Table("Notes", ("trial", "note"), notes),
        )


@dataclass(frozen=True)
class ProjectPreparation:
    """Subject prepared from a project of the NMSM Pipeline, whose files are copied unchanged.

    Parameters
    ----------
    project
        Content of the project.
    """

    project: Project

    def save(self, folder: Path | str, *, force: bool = False) -> None:
        """Write the subject folder atomically, provided that `load_subject` can read it.

        Parameters
        ----------
        folder
            Subject folder to create; its name becomes the name of the subject.
        force
            Replace an existing folder.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is false, or the result is not a valid subject.
        """
        folder = Path(folder)
        with new_folder(folder, force=force) as temporary, _errors_naming(temporary, folder):
            write_project_as_subject(self.project, temporary, folder.name)
            shutil.copyfile(self.project.settings.file, temporary / "prepared_from.xml")
            write_json(temporary / "preparation.json", self.summary())
            _write_page(temporary, self.tables(), "a project of the NMSM Pipeline")

    def summary(self) -> dict:
        """Return the content of ``preparation.json``: project, cycles and notes."""
        return {
            "schema": 1,
            "project": str(self.project.settings.file),
            "trials": {trial.name: {"cycles": [trial.cycle]} for trial in self.project.trials},
            "notes": self.project.notes,
        }

    def tables(self) -> tuple[Table, ...]:
        """Return the tables that `wrapjax prepare` prints: trials, channels and notes."""
        trials = tuple((trial.name, *trial.cycle) for trial in self.project.trials)
        channels = tuple((name, ", ".join(muscles)) for name, muscles in self.project.channels.items())
        notes = tuple((note,) for note in self.project.notes)
        return (
            Table("Trials", ("trial", "from (s)", "to (s)"), trials),
            Table("Channels", ("channel", "muscles"), channels),
            Table("Notes", ("note",), notes),
        )


@renamed_arguments(tell="log")
def prepare_subject(
    settings_file: Path | str, *, log: Callable[[str], None] = lambda line: None
) -> Preparation | ProjectPreparation:
    """Prepare a subject from a laboratory's raw files, or from a project of the NMSM Pipeline.

    Raw files: markers (or joint angles) and ground reaction forces are low-pass filtered at 7 over the gait
    period (zero-lag Butterworth filter of fourth order), OpenSim's inverse kinematics and inverse dynamics
    compute angles and moments, and motion, forces and EMG are checked for agreement in time, leg and unit.
    EMG is not filtered here but by `load_subject`.

    Project of the NMSM Pipeline: its model, angles, moments and EMG are used unchanged. Its ``MAData``
    (lengths and moment arms), if present, are compared with the muscle paths of its model.

    Parameters
    ----------
    settings_file
        Laboratory settings (TOML), or the settings of the project's muscle-tendon personalisation (``.xml``).
    log
        Function called with each line of progress.

    Returns
    -------
    Preparation or ProjectPreparation
        Prepared subject; its method ``save`` writes the subject folder.

    Raises
    ------
    InputError
        With all faults of the files and all failed checks, with their numbers.

    Examples
    --------
    >>> wrapjax.prepare_subject("lab/prepare.toml").save("P07_left")  # doctest: +SKIP
    """
    if Path(settings_file).suffix.lower() == ".xml":
        project = read_project(settings_file)
        notes = (*project.notes, *compare_muscle_analyses(project, log))
        return ProjectPreparation(replace(project, notes=notes))
    settings = read_laboratory_settings(Path(settings_file))
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        path = settings.model_file
        if settings.scaling is not None:
            log("scaling the model")
            path = Path(folder) / "scaled.osim"
            scale_model(settings.model_file, settings.scaling, settings.mass_kg, path)
        on_model: tuple[str, ...] = ()
        if settings.scales_masses:
            path = Path(folder) / "scaled.osim"
            factor = scale_masses(settings.model_file, settings.mass_kg, path)
            on_model = (
                f"masses and inertias of all bodies were multiplied by {factor:.4g}, to "
                f"{settings.mass_kg:g} kg; lengths, joint centers, muscle paths and muscle strengths are "
                "those of the generic model, so that moments are of a person of the model's size",
            )
        model = _read_model(path, settings)
        problems: list[Problem] = []
        contractions = []
        for file in settings.maximal_contractions:
            with collect_problems(problems):
                time, volts = read_emg(file, settings)
                contractions.append(Storage(RAW_TITLE, tuple(settings.channels), time, volts.T))
        trials = []
        for trial in settings.trials:
            with collect_problems(problems):
                trials.append(prepare_trial(trial, settings, model, log))
        if problems:
            raise InputError(dict.fromkeys(problems))
        return Preparation(settings, path.read_bytes(), tuple(trials), on_model, tuple(contractions))


def _read_model(path: Path, settings: LaboratorySettings) -> PreparationModel:
    """Read the model and check that it has the coordinates and bodies in the settings, and the mass."""
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
    muscles = file.muscles.names
    problems += [
        Problem(
            str(settings.file),
            f"muscle '{name}' is not in the model",
            f"[emg.channels] {channel}",
            nearest_name(name, muscles),
        )
        for channel, driven in settings.channels.items()
        for name in driven
        if name not in muscles
    ]
    # OpenSim's scale tool sets the mass of a model to that in the settings.
    if settings.scaling is None and not mass_agrees_with_model(settings.mass_kg, file.mass_kg):
        masses = describe_masses(settings.mass_kg, file.mass_kg)
        pounds = mass_looks_like_pounds(settings.mass_kg, file.mass_kg)
        problems.append(
            Problem(
                str(settings.file),
                f"expected the mass of a model scaled to the person, found that {masses}",
                "[subject] mass_kg",
                "is it in lb? Give kg" if pounds else "scale the model to the person, or correct mass_kg",
            )
        )
    if problems:
        raise InputError(problems)
    return PreparationModel(path, file, find_coupled_coordinates(description.coordinates), marker_names(path))


def _write_page(
    folder: Path, tables: Sequence[Table], came_from: str, trials: Sequence[PreparedTrial] = ()
) -> None:
    """Read the subject folder and write the report page."""
    from wrapjax.report.preparation_page import ForceTrace, render_preparation

    forces = [
        ForceTrace(
            trial=prepared.trial.name,
            cycles=prepared.cycles,
            time=prepared.forces.time,
            vertical={SIDES[side]: prepared.forces.vertical(side) for side in prepared.forces.sides},
            needed_time=prepared.required_time,
            needed=prepared.required_force,
        )
        for prepared in trials
        if prepared.forces is not None
    ]
    subject = load_subject(folder)
    # The folder has its final name later.
    notes = tuple(note.replace(f"{folder}/", "") for note in subject.notes)
    page = render_preparation(replace(subject, notes=notes), tables, forces, came_from)
    write_text(folder / "report.html", page)


@contextmanager
def _errors_naming(temporary: Path, folder: Path) -> Iterator[None]:
    """Replace the temporary folder by the final one in error messages."""
    try:
        yield
    except InputError as error:
        raise InputError(
            replace(problem, file=problem.file.replace(str(temporary), str(folder)))
            for problem in error.problems
        ) from error
