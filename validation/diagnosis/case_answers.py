"""Diagnosis of one case of a blind bank in a worker process, and its answers for the scorer."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax

if TYPE_CHECKING:
    from wrapjax.diagnosis.diagnosis import Diagnosis

#: File beside an answer with the fingerprint of its inputs.
QUESTION = "question.json"


@dataclass(frozen=True)
class Job:
    """Case, folders of its answers (None: not requested), and number of calibration starts."""

    case: Path
    answer: Path
    starts: int
    baselines: Path | None = None
    ablations: Path | None = None
    withheld: Path | None = None

    @property
    def cause(self) -> str | None:
        """Its single cause of the catalogue from the bank's truth; otherwise None."""
        file = self.case.parent.parent / "truth" / f"{self.case.name}.json"
        truth = json.loads(file.read_text(encoding="utf-8"))
        return truth["causes"][0]["id"] if truth["tier"] == "single" else None


def answer(job: Job) -> str:
    """Write all requested answers of a case that do not exist yet; return a description."""
    began = time.perf_counter()
    set_up_jax()
    try:
        description = _answer(job)
    finally:
        clear_caches_near_map_limit()
    return f"{description} ({time.perf_counter() - began:.0f} s)"


def _answer(job: Job) -> str:
    # Imported in the worker process after its thread counts are set.
    import wrapjax

    question = calibration_fingerprint(job.case)
    current = _is_current(job.answer, question)
    # Answers of other methods beside an outdated answer are outdated, too.
    others = {
        name: folder
        for name, folder in _other_answers(job).items()
        if not (current and (folder / "gap.json").exists())
    }
    # Answers with the cause withheld are requested only once the answer itself exists.
    if current and not others and (job.withheld is None or _is_withheld_current(job, question)):
        return "unchanged"
    subject = wrapjax.load_subject(job.case)
    paths = wrapjax.fit(subject, "engine", processes=1)
    done = wrapjax.diagnose(subject, "NGA", paths, starts=job.starts)
    write_other_answers(done, others)
    if not current:
        _save(done, job.answer, question)
    description = _describe(done)
    if job.withheld is not None and (cause := job.cause) is not None:
        blinded = done.without(cause)
        _save(blinded, job.withheld / job.case.name, question | {"without": [cause]})
        description += f"; withheld: {_describe(blinded)}"
    return description


def calibration_fingerprint(case: Path) -> dict[str, object]:
    """Return the fingerprint of the inputs of an answer: the subject's files and the package."""
    from wrapjax.io.files import content_hash
    from wrapjax.io.store import code_hash

    files = sorted(path for path in case.rglob("*") if path.is_file())
    return {"case": content_hash(*files), "code": code_hash(), "without": []}


def _other_answers(job: Job) -> dict[str, Path]:
    """Return the answer folders of baselines and ablations by name."""
    from validation.diagnosis.ablations import ABLATIONS
    from validation.diagnosis.baselines import BASELINES

    requested = ((job.baselines, BASELINES), (job.ablations, ABLATIONS))
    return {name: place / name / job.case.name for place, known in requested if place for name in known}


def write_other_answers(done: Diagnosis, folders: Mapping[str, Path]) -> None:
    """Rank effects by the other methods on the linearised model of a diagnosis, each into its folder."""
    from validation.diagnosis.ablations import ABLATIONS, score_ablated
    from validation.diagnosis.baselines import BASELINES, write_answer, write_no_answer

    linearized = done.result.linearized
    for name, folder in folders.items():
        if linearized is None:
            write_no_answer(done.result.outcome, folder)
        elif name in BASELINES:
            write_answer(BASELINES[name](linearized), folder)
        else:
            measured_moment_sd = done.data.measured_moment_sd
            write_answer(
                score_ablated(
                    ABLATIONS[name], linearized, measured_moment_sd, done.result.detection_threshold
                ),
                folder,
            )


def _is_current(folder: Path, question: Mapping[str, object]) -> bool:
    file = folder / QUESTION
    return file.exists() and bool(json.loads(file.read_text(encoding="utf-8")) == question)


def _is_withheld_current(job: Job, question: dict[str, object]) -> bool:
    assert job.withheld is not None
    cause = job.cause
    return cause is None or _is_current(job.withheld / job.case.name, question | {"without": [cause]})


def _save(done: Diagnosis, folder: Path, question: Mapping[str, object]) -> None:
    from wrapjax.io.files import write_json

    shutil.rmtree(folder, ignore_errors=True)
    done.save(folder)
    write_json(folder / QUESTION, dict(question))


def _describe(done: Diagnosis) -> str:
    return f"{done.result.outcome} {', '.join(done.result.named or sum(done.result.ties, ()))}".strip()
