"""Cohorts: calibration, and on request diagnosis, of many subjects in parallel.

Each subject is calculated in a process of its own, and its folder appears when it is complete.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wrapjax.calibration.problem import METHODS
from wrapjax.cohorts.scheduling import Finished, run_jobs
from wrapjax.comparison.samples import file_name
from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import new_folder, write_json
from wrapjax.io.json_and_arrays import load_json
from wrapjax.io.store import fingerprint
from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax
from wrapjax.progress import print_progress, progress_bar
from wrapjax.subject.subject import Subject, load_subject, read_legs

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset


#: File of a subject's result in its folder.
SUBJECT_FILE = "subject.json"
#: Folders of a subject's calibration and diagnosis in its folder.
CALIBRATION, DIAGNOSIS = "calibration", "diagnosis"
#: Default number of starting points of each calibration.
STARTS = 4
_COHORT_FILE = "cohort.json"
_SCHEMA = 1
_WAITING = {"state": "waiting"}


@dataclass(frozen=True)
class Cohort:
    """Results of a cohort.

    Parameters
    ----------
    folder
        Output folder, with a folder for each subject, ``cohort.json`` and ``report.html``.
    content
        Content of ``cohort.json``.
    """

    folder: Path
    content: dict[str, Any]

    @property
    def failed(self) -> dict[str, str]:
        """Error messages of the subjects that failed, by name."""
        subjects = self.content["subjects"].items()
        return {name: subject["message"] for name, subject in subjects if subject["state"] == "failed"}

    def summary(self) -> dict[str, Any]:
        """Return the content of ``cohort.json``."""
        return self.content

    def to_dataset(self) -> Dataset:
        """Return mean absolute errors by subject, use and coordinate as an `xarray.Dataset`.

        Raises
        ------
        InputError
            If no subject is done.
        """
        from wrapjax.report.labelled.arrays import cohort_dataset

        return cohort_dataset(self._done)

    def plot_errors(self) -> Figure:
        """Draw the mean absolute error (N m) of every subject by coordinate, and the median over subjects.

        Raises
        ------
        InputError
            If no subject is done.
        """
        from wrapjax.report.cohort_page import population_figure

        return population_figure(list(self._done.values()))

    @property
    def _done(self) -> dict[str, dict[str, Any]]:
        subjects = self.content["subjects"].items()
        done = {name: one for name, one in subjects if one["state"] == "done"}
        if not done:
            raise InputError(Problem(str(self.folder), "no subject is done"))
        return done

    @property
    def complete(self) -> bool:
        """Whether all subjects are done, converged, and diagnosed where that was requested."""
        undiagnosed = ("insufficient_data", "not_converged")
        return all(
            subject["state"] == "done"
            and subject["converged"]
            and (subject["diagnosis"] is None or subject["diagnosis"]["outcome"] not in undiagnosed)
            for subject in self.content["subjects"].values()
        )


def cohort(
    subjects: Sequence[str | Path],
    folder: str | Path,
    method: str = "NGA",
    *,
    diagnose: bool = False,
    scheduler: str | None = None,
    workers: int | None = None,
    starts: int = STARTS,
    seed: int = 0,
    resume: bool = False,
    force: bool = False,
    quiet: bool = True,
) -> Cohort:
    """Calibrate many subjects in parallel, each in a process of one thread.

    The folder of each subject appears in ``folder`` under the name of the subject's own folder when it is
    complete. A subject that cannot be read or fails does not stop the others. ``cohort.json`` is up to date
    whenever the computation is stopped.

    Parameters
    ----------
    subjects
        Subject folders, with different names. Each is calibrated by itself (with its ``other_leg`` if it has
        one), so that two legs that name each other are calibrated twice if both are given.
    folder
        Output folder.
    method
        Method of calibration, as in `calibrate`.
    diagnose
        Also diagnose each subject.
    scheduler
        Address of a dask scheduler whose workers see the same files, or ``slurm`` for jobs of a SLURM
        cluster. By default processes on this machine.
    workers
        Number of processes; by default one per core.
    starts
        Number of starting points of each calibration.
    seed
        Seed of the random starting points.
    resume
        Keep results of subjects whose files and settings are unchanged.
    force
        Replace the folder of an earlier cohort.
    quiet
        Print no progress.

    Returns
    -------
    Cohort
        Results; ``complete`` tells whether all subjects succeeded, ``failed`` which did not.

    Raises
    ------
    InputError
        If there is no subject, the method is unknown, two subjects have the same name, the folder exists, or
        no scheduler answers.
    KeyboardInterrupt
        If interrupted; continue with ``resume``.
    """
    if method not in METHODS:
        hint = nearest_name(method, METHODS)
        raise InputError(Problem("method", f"'{method}' is not known", hint=hint))
    place = Path(folder).resolve()
    folders = _folders_by_name(subjects)
    _prepare_folder(place, resume=resume, force=force)
    jobs = {
        name: Job(str(subject_folder), str(place / name), method, diagnose, starts, seed, resume)
        for name, subject_folder in folders.items()
    }
    states: dict[str, dict[str, Any]] = dict.fromkeys(folders, _WAITING)
    # Before workers are started, which may not be needed.
    for name in list(jobs):
        cached = cached_result(jobs[name])
        if cached is not None:
            del jobs[name]
            states[name] = _state(Finished(name, cached))
    result = Cohort(place, _write(place, folders, states, method, diagnose))
    if len(jobs) < len(folders):
        print_progress(f"{len(folders) - len(jobs)} of {len(folders)} subjects are done already", quiet=quiet)
    running = run_jobs(process_subject, jobs, scheduler=scheduler, workers=workers or os.cpu_count() or 1)
    with progress_bar("subjects", len(jobs), quiet=quiet) as advance:
        for number, finished in enumerate(running if jobs else (), 1):
            states[finished.name] = _state(finished)
            result = Cohort(place, _write(place, folders, states, method, diagnose))
            print_progress(f"{finished.name}: {_summary_line(states[finished.name])}", quiet=quiet)
            advance(number)
    _write_report(result)
    return result


def redraw_cohort(folder: Path) -> None:
    """Render the report of a cohort again from ``cohort.json``.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    file = folder / _COHORT_FILE
    try:
        _write_report(Cohort(folder, load_json(file)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        hint = "make it anew with 'wrapjax cohort --resume', which keeps what is done"
        raise InputError(Problem(str(file), f"is damaged ({error})", hint=hint)) from error


@dataclass(frozen=True)
class Job:
    """Computation for one subject, in plain values that can be sent to another process.

    Parameters
    ----------
    folder
        Subject folder.
    place
        Folder of the result.
    method
        Method of calibration, as in `calibrate`.
    diagnose
        Whether to diagnose the subject as well.
    starts, seed
        As in `calibrate`.
    resume
        Whether to use a stored result of the same files and settings.
    """

    folder: str
    place: str
    method: str
    diagnose: bool
    starts: int
    seed: int
    resume: bool


def cached_result(job: Job) -> dict[str, Any] | None:
    """Read the stored result of the same files and settings; None if there is none or resuming is off."""
    if not job.resume:
        return None
    try:
        question = _fingerprint(job, load_subject(job.folder))
    except (InputError, OSError):
        return None  # `process_subject` reports the error.
    try:
        content = load_json(Path(job.place) / SUBJECT_FILE)
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and content.get("question") == question else None


def process_subject(job: Job) -> dict[str, Any]:
    """Calibrate (and diagnose) a subject, and write its folder completely or not at all.

    Returns
    -------
    dict
        Content of ``subject.json``; for a subject that cannot be read, only its state and error message.
    """
    set_up_jax()
    try:
        return _process_subject(job)
    except InputError as error:
        more = len(error.problems) - 1
        tail = f" (and {more} more)" if more else ""
        return {"state": "failed", "message": f"{error.problems[0]}{tail}"}
    finally:
        clear_caches_near_map_limit()


def _process_subject(job: Job) -> dict[str, Any]:
    # Imported here, because a worker sets its threads before it loads JAX.
    from wrapjax.calibration.calibration import cached_calibration
    from wrapjax.calibration.problem import fit_for_methods
    from wrapjax.calibration.solvers.interface import Status
    from wrapjax.diagnosis.diagnosis import diagnose

    began = time.perf_counter()
    subject = load_subject(job.folder)
    question = _fingerprint(job, subject)
    place = Path(job.place)
    paths = fit_for_methods((job.method,), subject, seed=job.seed, processes=1)
    calibration = cached_calibration(subject, job.method, paths, starts=job.starts, seed=job.seed)
    if calibration.status is Status.interrupted:
        raise RuntimeError("interrupted; its checkpoints are kept")
    with new_folder(place, force=True) as folder:
        # Saved without `checkpoints`, which it would delete: the diagnosis reads the calibration from them.
        replace(calibration, checkpoints=None).save(folder / CALIBRATION)
        diagnosis_summary = None
        if job.diagnose:
            diagnosis = diagnose(subject, job.method, paths, starts=job.starts, seed=job.seed)
            diagnosis.save(folder / DIAGNOSIS)
            diagnosis_summary = _diagnosis_summary(load_json(folder / DIAGNOSIS / "gap.json"))
        summary = load_json(folder / CALIBRATION / "summary.json")
        content = {
            "schema": _SCHEMA,
            "question": question,
            "state": "done",
            "subject": subject.name,
            "side": subject.side,
            "paretic": subject.paretic,
            **{name: summary[name] for name in ("method", "converged", "message", "mae_Nm", "rmse_Nm")},
            "diagnosis": diagnosis_summary,
            "seconds": time.perf_counter() - began,
        }
        write_json(folder / SUBJECT_FILE, content)
    return content


def _diagnosis_summary(content: dict[str, Any]) -> dict[str, Any]:
    names = ("outcome", "reason", "named", "ties", "family", "explainable_share", "shrinkage")
    return {name: content.get(name) for name in names}


def _fingerprint(job: Job, subject: Subject) -> str:
    """Compute the fingerprint of all files of the subject and all settings."""
    files: set[Path] = set()
    for leg in read_legs(subject):
        files |= {path for path in leg.folder.rglob("*") if path.is_file()}
        files.add(leg.model_file)
        for trial in leg.recordings:
            trial_files = (
                trial.angles,
                trial.moments,
                trial.emg,
                trial.ground_forces,
                trial.external_loads,
            )
            files |= {path for path in trial_files if path is not None}
    settings = (job.method, job.diagnose, job.starts, job.seed, _SCHEMA)
    return fingerprint(repr(settings), *sorted({path.resolve() for path in files}))


def _folders_by_name(subjects: Sequence[str | Path]) -> dict[str, Path]:
    """Name subjects by their folders, because the settings of some may not be readable."""
    if not subjects:
        raise InputError(Problem("subjects", "expected at least one, found none"))
    folders: dict[str, Path] = {}
    problems = []
    for subject in map(Path, subjects):
        folder = (subject.parent if subject.name == "subject.toml" else subject).resolve()
        label = file_name(folder.name)
        first = next((other for name, other in folders.items() if name.lower() == label.lower()), None)
        if first is not None:
            message = f"would have the same folder in the result as {first}"
            problems.append(Problem(str(folder), message, hint="rename one of both folders"))
        folders.setdefault(label, folder)
    if problems:
        raise InputError(problems)
    return folders


def _prepare_folder(place: Path, *, resume: bool, force: bool) -> None:
    """Create or empty the output folder; raise an error if it may not be used."""
    if not place.exists():
        place.mkdir(parents=True)
        return
    is_cohort = place.is_dir() and ((place / _COHORT_FILE).is_file() or not any(place.iterdir()))
    if not is_cohort:
        raise InputError(Problem(str(place), "is there already, and is no folder of a cohort"))
    if force and not resume:
        shutil.rmtree(place)
        place.mkdir()
    elif not resume and any(place.iterdir()):
        hint = "keep what is done with --resume, or replace all of it with --force"
        raise InputError(Problem(str(place), "exists already and is not overwritten", hint=hint))
    for incomplete in place.glob(".*"):  # Partial results of workers that were killed.
        if incomplete.is_dir() and not incomplete.is_symlink():
            shutil.rmtree(incomplete, ignore_errors=True)
        else:
            incomplete.unlink(missing_ok=True)


def _state(finished: Finished) -> dict[str, Any]:
    if finished.failure:
        return {"state": "failed", "message": finished.failure}
    return {name: value for name, value in finished.value.items() if name not in ("schema", "question")}


def _summary_line(state: dict[str, Any]) -> str:
    if state["state"] == "failed":
        return f"failed: {state['message']}"
    errors = state["mae_Nm"]["calibration"]
    summary = "" if errors is None else f"{errors['mean']:.2f} N m"
    diagnosis = state["diagnosis"]
    return summary if diagnosis is None else f"{summary}, diagnosis {diagnosis['outcome']}"


def _write(
    place: Path, folders: dict[str, Path], states: dict[str, dict[str, Any]], method: str, diagnose: bool
) -> dict[str, Any]:
    """Write ``cohort.json``, and return its content."""
    from wrapjax.report.cohort_page import describe_cohort, write_content

    subjects = {}
    for name, folder in folders.items():
        reports = {}
        if states[name]["state"] == "done":
            reports["report"] = f"{name}/{CALIBRATION}/report.html"
            if states[name]["diagnosis"] is not None:
                reports["diagnosis_report"] = f"{name}/{DIAGNOSIS}/report.html"
        subjects[name] = {"folder": os.path.relpath(folder, place), **states[name], **reports}
    content = describe_cohort(method, diagnose, subjects)
    write_content(content, place)
    return content


def _write_report(result: Cohort) -> None:
    from wrapjax.report.cohort_page import write_page

    write_page(result.content, result.folder)
