"""Diagnose every case of a blind bank, one after the other, and keep the answers for its scorer.

``python -m benchmarks.diagnosed --bank BANK --out ANSWERS`` looks at a case's folder and at nothing else.
Cases that are answered already are not asked again, unless the case or the package is another than then: so
it goes on where it was stopped. ``--withheld FOLDER`` asks again of every case with a single cause, with that
effect left out of the catalogue: the cause is read from the bank's truth once the case's own answer is
written. ``--baselines FOLDER`` also answers as textbooks would (see `benchmarks.baselines`), a folder each.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import shutil
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.machine import pin_threads
from benchmarks.subjects import set_up_jax

if TYPE_CHECKING:
    from wrapjax.api.diagnosis import Diagnosis

#: Beside an answer: what it is an answer to.
QUESTION = "question.json"


def main() -> int:
    options = _parser().parse_args()
    cases = sorted(path for path in (options.bank / "cases").iterdir() if (path / "subject.toml").exists())
    cases = cases[: options.first]
    jobs = [
        Job(case, options.out / case.name, options.starts, options.baselines, options.withheld)
        for case in cases
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    parts = [jobs[number :: options.workers] for number in range(options.workers)]
    if options.workers == 1:
        return _answer_all(parts[0])
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.workers, mp_context=context) as pool:
        return max(pool.map(_answer_all, parts))


@dataclass(frozen=True)
class Job:
    """A case, where its answers go, and how many starts its calibration has."""

    case: Path
    answer: Path
    starts: int
    baselines: Path | None
    withheld: Path | None

    @property
    def cause(self) -> str | None:
        """Its only cause, from the bank's truth, where that is one of the catalogue; else None."""
        file = self.case.parent.parent / "truth" / f"{self.case.name}.json"
        truth = json.loads(file.read_text(encoding="utf-8"))
        return truth["causes"][0]["id"] if truth["tier"] == "single" else None


def _answer_all(jobs: list[Job]) -> int:
    """Answer in one process, so that what is compiled serves all; give 1 if any case failed."""
    pin_threads()
    set_up_jax()
    import jax

    failed = 0
    for number, job in enumerate(jobs, 1):
        began = time.perf_counter()
        try:
            said = _answer(job)
        except Exception as error:  # One case must not cost all others.
            said, failed = f"FAILED: {type(error).__name__}: {error}", 1
        seconds = time.perf_counter() - began
        if _crowded():
            jax.clear_caches()
        print(f"{number}/{len(jobs)} {job.case.name}: {said} ({seconds:.0f} s)", file=sys.stderr, flush=True)
    return failed


def _crowded() -> bool:
    """Say whether another case might not find room: each compiles hundreds of programs for its own sizes.

    Linux lets a process map only so many pieces of memory, and LLVM ends a process that it has none for.
    """
    try:
        most = int(Path("/proc/sys/vm/max_map_count").read_text())
        with Path("/proc/self/maps").open(encoding="utf-8") as maps:
            return sum(1 for _ in maps) > most // 3
    except (OSError, ValueError):
        return False


def _answer(job: Job) -> str:
    import wrapjax
    from benchmarks.baselines import BASELINES, write_answer, write_silence
    from wrapjax.files import content_hash

    files = sorted(path for path in job.case.rglob("*") if path.is_file())
    code = sorted(Path(wrapjax.__file__).parent.rglob("*.py")) + [
        Path(wrapjax.__file__).parent / "gap" / "calibration.json"
    ]
    question = {"case": content_hash(*files), "code": content_hash(*code), "without": []}
    others = {name: job.baselines / name / job.case.name for name in BASELINES} if job.baselines else {}
    answered = all((folder / "gap.json").exists() for folder in others.values()) and _kept(
        job.answer, question
    )
    # What is withheld is asked for after the answer is there, and only then.
    if answered and (job.withheld is None or _kept_withheld(job, question)):
        return "as before"
    subject = wrapjax.load_subject(job.case)
    paths = wrapjax.fit(subject, "engine", processes=1)
    done = wrapjax.diagnose(subject, "NGA", paths, starts=job.starts)
    if not answered:
        for name, folder in others.items():
            if done.result.lines is None:
                write_silence(done.result.outcome, folder)
            else:
                write_answer(BASELINES[name](done.result.lines), folder)
        _keep(done, job.answer, question)
    said = _in_words(done)
    if job.withheld is not None and (cause := job.cause) is not None:
        blinded = done.without(cause)
        _keep(blinded, job.withheld / job.case.name, question | {"without": [cause]})
        said += f"; withheld: {_in_words(blinded)}"
    return said


def _kept(answer: Path, question: dict[str, object]) -> bool:
    kept = answer / QUESTION
    return kept.exists() and json.loads(kept.read_text(encoding="utf-8")) == question


def _kept_withheld(job: Job, question: dict[str, object]) -> bool:
    assert job.withheld is not None
    cause = job.cause
    return cause is None or _kept(job.withheld / job.case.name, question | {"without": [cause]})


def _keep(done: Diagnosis, answer: Path, question: dict[str, object]) -> None:
    from wrapjax.files import write_json

    shutil.rmtree(answer, ignore_errors=True)
    done.save(answer)
    write_json(answer / QUESTION, question)


def _in_words(done: Diagnosis) -> str:
    return f"{done.result.outcome} {', '.join(done.result.named or sum(done.result.ties, ()))}".strip()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.diagnosed", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument(
        "--first", type=int, metavar="N", help="only the first N cases by their ids, which are hashes"
    )
    parser.add_argument("--baselines", type=Path, help="where to answer as textbooks would")
    parser.add_argument("--withheld", type=Path, help="where to answer with each single cause left out")
    return parser


if __name__ == "__main__":
    sys.exit(main())
