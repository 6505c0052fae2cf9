"""One case of a blind bank, diagnosed in a process of its own; its answers for the scorer."""

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

#: Beside an answer: what it is an answer to.
QUESTION = "question.json"


@dataclass(frozen=True)
class Job:
    """A case, where its answers go (None: not asked for), and how many starts its calibration has."""

    case: Path
    answer: Path
    starts: int
    baselines: Path | None = None
    ablations: Path | None = None
    withheld: Path | None = None

    @property
    def cause(self) -> str | None:
        """Its only cause, from the bank's truth, where that is one of the catalogue; else None."""
        file = self.case.parent.parent / "truth" / f"{self.case.name}.json"
        truth = json.loads(file.read_text(encoding="utf-8"))
        return truth["causes"][0]["id"] if truth["tier"] == "single" else None


def answer(job: Job) -> str:
    """Answer all that is asked of a case and not answered yet; give what is said, in words."""
    began = time.perf_counter()
    set_up_jax()
    try:
        said = _answer(job)
    finally:
        clear_caches_near_map_limit()
    return f"{said} ({time.perf_counter() - began:.0f} s)"


def _answer(job: Job) -> str:
    # Imported by a worker, after its threads are set.
    import wrapjax

    question = calibration_fingerprint(job.case)
    kept = _kept(job.answer, question)
    # Beside an answer to another question they are of that one, too.
    others = {name: own for name, own in _others(job).items() if not (kept and (own / "gap.json").exists())}
    # What is withheld is asked for after the answer is there, and only then.
    if kept and not others and (job.withheld is None or _kept_withheld(job, question)):
        return "as before"
    subject = wrapjax.load_subject(job.case)
    paths = wrapjax.fit(subject, "engine", processes=1)
    done = wrapjax.diagnose(subject, "NGA", paths, starts=job.starts)
    write_others(done, others)
    if not kept:
        _keep(done, job.answer, question)
    said = _in_words(done)
    if job.withheld is not None and (cause := job.cause) is not None:
        blinded = done.without(cause)
        _keep(blinded, job.withheld / job.case.name, question | {"without": [cause]})
        said += f"; withheld: {_in_words(blinded)}"
    return said


def calibration_fingerprint(case: Path) -> dict[str, object]:
    """Name what an answer depends on: a subject's files and the package."""
    from wrapjax.io.files import code_hash, content_hash

    files = sorted(path for path in case.rglob("*") if path.is_file())
    return {"case": content_hash(*files), "code": code_hash(), "without": []}


def _others(job: Job) -> dict[str, Path]:
    """Who else answers, by name, and where."""
    from validation.diagnosis.ablations import ABLATIONS
    from validation.diagnosis.baselines import BASELINES

    asked = ((job.baselines, BASELINES), (job.ablations, ABLATIONS))
    return {name: place / name / job.case.name for place, known in asked if place for name in known}


def write_others(done: Diagnosis, folders: Mapping[str, Path]) -> None:
    """Let those who rank effects on the lines of a finished diagnosis answer, each into its folder."""
    from validation.diagnosis.ablations import ABLATIONS, ablated
    from validation.diagnosis.baselines import BASELINES, write_answer, write_silence

    lines = done.result.lines
    for name, folder in folders.items():
        if lines is None:
            write_silence(done.result.outcome, folder)
        elif name in BASELINES:
            write_answer(BASELINES[name](lines), folder)
        else:
            sizes = done.case.measured_sizes
            write_answer(ablated(ABLATIONS[name], lines, sizes, done.result.detection_threshold), folder)


def _kept(folder: Path, question: Mapping[str, object]) -> bool:
    kept = folder / QUESTION
    return kept.exists() and bool(json.loads(kept.read_text(encoding="utf-8")) == question)


def _kept_withheld(job: Job, question: dict[str, object]) -> bool:
    assert job.withheld is not None
    cause = job.cause
    return cause is None or _kept(job.withheld / job.case.name, question | {"without": [cause]})


def _keep(done: Diagnosis, folder: Path, question: Mapping[str, object]) -> None:
    from wrapjax.io.files import write_json

    shutil.rmtree(folder, ignore_errors=True)
    done.save(folder)
    write_json(folder / QUESTION, dict(question))


def _in_words(done: Diagnosis) -> str:
    return f"{done.result.outcome} {', '.join(done.result.named or sum(done.result.ties, ()))}".strip()
