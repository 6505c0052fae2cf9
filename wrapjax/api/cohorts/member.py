"""One subject of a cohort, calibrated and diagnosed in a process of its own."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError
from wrapjax.files import code_hash, content_hash, new_folder, write_json
from wrapjax.jax_setup import forget_if_crowded, set_up_jax
from wrapjax.stored import load_json
from wrapjax.subject import Subject, read_legs, read_subject

#: Says what a member's folder answers.
MEMBER_FILE = "subject.json"
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


def kept_answer(job: Job) -> dict[str, Any] | None:
    """Recall what was answered to the same question of the same files; None if that is not there."""
    try:
        return _kept(Path(job.place), _question(job, read_subject(job.folder))) if job.resume else None
    except (InputError, OSError):
        return None  # whoever is to answer says why


def answer(job: Job) -> dict[str, Any]:
    """Calibrate a subject (and diagnose it), and write its folder whole or not at all.

    Returns
    -------
    dict
        What ``subject.json`` holds; for a subject that cannot be read, only that it failed, and why.
    """
    set_up_jax()
    try:
        return _answer(job)
    except InputError as error:
        more = len(error.problems) - 1
        tail = f" (and {more} more)" if more else ""
        return {"state": "failed", "message": f"{error.problems[0]}{tail}"}
    finally:
        forget_if_crowded()


def _answer(job: Job) -> dict[str, Any]:
    # Imported by a worker, after its threads are set.
    from wrapjax.api.calibrating.calibration import kept_calibration
    from wrapjax.api.calibrating.problem import source_for
    from wrapjax.api.diagnosing.diagnosis import diagnose
    from wrapjax.calibrate import Status

    began = time.perf_counter()
    subject = read_subject(job.folder)
    question = _question(job, subject)
    place = Path(job.place)
    paths = source_for((job.method,), subject, seed=job.seed, processes=1)
    calibration = kept_calibration(subject, job.method, paths, starts=job.starts, seed=job.seed)
    if calibration.status is Status.interrupted:
        raise RuntimeError("interrupted; what was done of it is kept")
    with new_folder(place, force=True) as folder:
        # Its journal stays, so that the diagnosis need not calibrate again.
        replace(calibration, journal=None).save(folder / CALIBRATION)
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
        write_json(folder / MEMBER_FILE, content)
    return content


def _gap(content: dict[str, Any]) -> dict[str, Any]:
    names = ("outcome", "reason", "named", "ties", "explainable_share", "shrinkage")
    return {name: content.get(name) for name in names}


def _stored(file: Path) -> dict[str, Any]:
    return load_json(file)


def _kept(place: Path, question: str) -> dict[str, Any] | None:
    """Recall an answer to the same question; None if there is none."""
    try:
        content = _stored(place / MEMBER_FILE)
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and content.get("question") == question else None


def _question(job: Job, subject: Subject) -> str:
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
