"""One subject of a cohort, calibrated and diagnosed in a process of its own.

``cohort``: many subjects calibrated, and diagnosed, side by side.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from wrapjax.calibration.problem import METHODS
from wrapjax.cohorts.scheduling import Finished, run_jobs
from wrapjax.comparison.samples import file_name
from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import code_hash, content_hash, new_folder, write_json
from wrapjax.io.json_and_arrays import load_json
from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax
from wrapjax.progress import print_progress, progress_bar
from wrapjax.subject.subject import Subject, load_subject, read_legs

#: Says what a member's folder answers.
SUBJECT_FILE = "subject.json"
#: Folders within it.
CALIBRATION, DIAGNOSIS = "calibration", "diagnosis"
_SCHEMA = 1


@dataclass(frozen=True)
class Job:
    """What is to be done for one subject, in plain values that any process reads.

    Parameters
    ----------
    folder
        Of the subject.
    place
        Folder of the result.
    method, starts, seed
        As of `calibrate`.
    diagnose
        Whether to diagnose, too.
    resume
        Take what is there if it answers the same question.
    """

    folder: str
    place: str
    method: str
    diagnose: bool
    starts: int
    seed: int
    resume: bool


def cached_result(job: Job) -> dict[str, Any] | None:
    """Recall what was answered to the same question of the same files; None if that is not there."""
    try:
        return _kept(Path(job.place), _fingerprint(job, load_subject(job.folder))) if job.resume else None
    except (InputError, OSError):
        return None  # whoever is to answer says why


def process_subject(job: Job) -> dict[str, Any]:
    """Calibrate a subject (and diagnose it), and write its folder whole or not at all.

    Returns
    -------
    dict
        What ``subject.json`` holds; for a subject that cannot be read, only that it failed, and why.
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
    # Imported by a worker, after its threads are set.
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
        raise RuntimeError("interrupted; what was done of it is kept")
    with new_folder(place, force=True) as folder:
        # Its journal stays, so that the diagnosis need not calibrate again.
        replace(calibration, checkpoints=None).save(folder / CALIBRATION)
        gap = None
        if job.diagnose:
            diagnosis = diagnose(subject, job.method, paths, starts=job.starts, seed=job.seed)
            diagnosis.save(folder / DIAGNOSIS)
            gap = _gap(_stored(folder / DIAGNOSIS / "gap.json"))
        summary = _stored(folder / CALIBRATION / "summary.json")
        content = {
            "schema": _SCHEMA,
            "question": question,
            "state": "done",
            "subject": subject.name,
            "side": subject.side,
            "paretic": subject.paretic,
            **{name: summary[name] for name in ("method", "converged", "message", "mae_Nm", "rmse_Nm")},
            "diagnosis": gap,
            "seconds": time.perf_counter() - began,
        }
        write_json(folder / SUBJECT_FILE, content)
    return content


def _gap(content: dict[str, Any]) -> dict[str, Any]:
    names = ("outcome", "reason", "named", "ties", "explainable_share", "shrinkage")
    return {name: content.get(name) for name in names}


def _stored(file: Path) -> dict[str, Any]:
    return load_json(file)


def _kept(place: Path, question: str) -> dict[str, Any] | None:
    """Recall an answer to the same question; None if there is none."""
    try:
        content = _stored(place / SUBJECT_FILE)
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and content.get("question") == question else None


def _fingerprint(job: Job, subject: Subject) -> str:
    """Name what is asked by all files of the subject and by all settings."""
    files: set[Path] = set()
    for leg in read_legs(subject):
        files |= {path for path in leg.folder.rglob("*") if path.is_file()}
        files.add(leg.model_file)
        for trial in leg.recordings:
            named = (trial.angles, trial.moments, trial.emg, trial.ground_forces, trial.external_loads)
            files |= {path for path in named if path is not None}
    asked = (job.method, job.diagnose, job.starts, job.seed, code_hash(), _SCHEMA)
    return content_hash(repr(asked), *sorted({path.resolve() for path in files}))


#: Starts of each calibration.
STARTS = 4
_FILE = "cohort.json"
_WAITING = {"state": "waiting"}


@dataclass(frozen=True)
class Cohort:
    """What came of many subjects.

    Parameters
    ----------
    folder
        With a folder for each subject, ``cohort.json`` and ``report.html``.
    content
        Of ``cohort.json``.
    """

    folder: Path
    content: dict[str, Any]

    @property
    def failed(self) -> dict[str, str]:
        """Why those failed that did, by name."""
        subjects = self.content["subjects"].items()
        return {name: own["message"] for name, own in subjects if own["state"] == "failed"}

    @property
    def complete(self) -> bool:
        """Whether every subject is there, converged, and could be diagnosed where that was asked for."""
        undiagnosed = ("insufficient_data", "not_converged")
        return all(
            own["state"] == "done"
            and own["converged"]
            and (own["diagnosis"] is None or own["diagnosis"]["outcome"] not in undiagnosed)
            for own in self.content["subjects"].values()
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
    """Calibrate many subjects side by side, each in a process of one thread.

    Each subject's folder appears in ``folder``, under the name of its own, when it is complete. One that
    cannot be read or fails stops no other. ``cohort.json`` is up to date whenever the work is stopped.

    Parameters
    ----------
    subjects
        Folders; their last names tell them apart. Each is handled alone (with its ``other_leg`` if it names
        one), so that two legs that name each other are calibrated twice if both are given.
    folder
        Where to.
    method, starts, seed
        As of `calibrate`.
    diagnose
        Diagnose each subject, too.
    scheduler
        Address of a dask scheduler, whose workers see the same files; ``slurm`` for jobs of a SLURM cluster.
        By default processes on this machine.
    workers
        How many processes; by default one a core.
    resume
        Keep subjects that are done already and were asked the same question of the same files.
    force
        Replace the folder of an earlier cohort.
    quiet
        Print no progress.

    Returns
    -------
    Cohort
        Whether all went well is in ``complete``; who failed in ``failed``.

    Raises
    ------
    InputError
        If there is no subject, two have the same name, the folder exists, or no scheduler answers.
    KeyboardInterrupt
        If interrupted; with ``resume`` it goes on.
    """
    if method not in METHODS:
        hint = nearest_name(method, METHODS)
        raise InputError(Problem("method", f"'{method}' is not known", hint=hint))
    place = Path(folder).resolve()
    labels = _labels(subjects)
    _open(place, resume=resume, force=force)
    jobs = {
        label: Job(str(own), str(place / label), method, diagnose, starts, seed, resume)
        for label, own in labels.items()
    }
    states: dict[str, dict[str, Any]] = dict.fromkeys(labels, _WAITING)
    # Before there are workers, which may not be needed.
    for label in list(jobs):
        kept = cached_result(jobs[label])
        if kept is not None:
            del jobs[label]
            states[label] = _state(Finished(label, kept))
    found = Cohort(place, _write(place, labels, states, method, diagnose))
    if len(jobs) < len(labels):
        print_progress(f"{len(labels) - len(jobs)} of {len(labels)} subjects are done already", quiet=quiet)
    running = run_jobs(process_subject, jobs, scheduler=scheduler, workers=workers or os.cpu_count() or 1)
    with progress_bar("subjects", len(jobs), quiet=quiet) as advance:
        for number, one in enumerate(running if jobs else (), 1):
            states[one.name] = _state(one)
            found = Cohort(place, _write(place, labels, states, method, diagnose))
            print_progress(f"{one.name}: {_line(states[one.name])}", quiet=quiet)
            advance(number)
    _draw(found)
    return found


def redraw_cohort(folder: Path) -> None:
    """Draw the report of a cohort again from ``cohort.json``.

    Raises
    ------
    InputError
        If that is damaged.
    """
    file = folder / _FILE
    try:
        _draw(Cohort(folder, load_json(file)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        hint = "make it anew with 'wrapjax cohort --resume', which keeps what is done"
        raise InputError(Problem(str(file), f"is damaged ({error})", hint=hint)) from error


def _labels(subjects: Sequence[str | Path]) -> dict[str, Path]:
    """Name subjects by their folders: some of them may have no settings that can be read."""
    if not subjects:
        raise InputError(Problem("subjects", "expected at least one, found none"))
    found: dict[str, Path] = {}
    problems = []
    for one in map(Path, subjects):
        own = (one.parent if one.name == "subject.toml" else one).resolve()
        label = file_name(own.name)
        first = next((other for name, other in found.items() if name.lower() == label.lower()), None)
        if first is not None:
            message = f"would have the same folder in the result as {first}"
            problems.append(Problem(str(own), message, hint="rename one of both folders"))
        found.setdefault(label, own)
    if problems:
        raise InputError(problems)
    return found


def _open(place: Path, *, resume: bool, force: bool) -> None:
    """Refuse what is no cohort's folder, or may not be touched; make way for a new one."""
    if not place.exists():
        place.mkdir(parents=True)
        return
    ours = place.is_dir() and ((place / _FILE).is_file() or not any(place.iterdir()))
    if not ours:
        raise InputError(Problem(str(place), "is there already, and is no folder of a cohort"))
    if force and not resume:
        shutil.rmtree(place)
        place.mkdir()
    elif not resume and any(place.iterdir()):
        hint = "keep what is done with --resume, or replace all of it with --force"
        raise InputError(Problem(str(place), "exists already and is not overwritten", hint=hint))
    for torn in place.glob(".*"):  # what workers that were killed left half-written
        if torn.is_dir() and not torn.is_symlink():
            shutil.rmtree(torn, ignore_errors=True)
        else:
            torn.unlink(missing_ok=True)


def _state(one: Finished) -> dict[str, Any]:
    if one.failure:
        return {"state": "failed", "message": one.failure}
    return {name: value for name, value in one.value.items() if name not in ("schema", "question")}


def _line(state: dict[str, Any]) -> str:
    if state["state"] == "failed":
        return f"failed: {state['message']}"
    errors = state["mae_Nm"]["calibration"]
    said = "" if errors is None else f"{errors['mean']:.2f} N m"
    gap = state["diagnosis"]
    return said if gap is None else f"{said}, diagnosis {gap['outcome']}"


def _write(
    place: Path, labels: dict[str, Path], states: dict[str, dict[str, Any]], method: str, diagnose: bool
) -> dict[str, Any]:
    from wrapjax.report.cohort_page import describe_cohort, write_content

    subjects = {}
    for label, own in labels.items():
        reports = {}
        if states[label]["state"] == "done":
            reports["report"] = f"{label}/{CALIBRATION}/report.html"
            if states[label]["diagnosis"] is not None:
                reports["diagnosis_report"] = f"{label}/{DIAGNOSIS}/report.html"
        subjects[label] = {"folder": os.path.relpath(own, place), **states[label], **reports}
    content = describe_cohort(method, diagnose, subjects)
    write_content(content, place)
    return content


def _draw(found: Cohort) -> None:
    from wrapjax.report.cohort_page import write_page

    write_page(found.content, found.folder)
