"""Scores of recorded walking and running with known errors: ``python -m validation.recorded --out DIR``.

The true cause in a recording of a person is unknown, but an added error is known. Every recording is scored
untouched and with each error that is possible in it (`manipulations_of`), in linearised models. The tables
show by how much the evidence of the added effect rises over the untouched recording, which effect's rises
most, and what the decision and the gates of linearised fits leave of it. Linearised models are stored in DIR,
so that an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.machine import pin_threads
from validation.diagnosis.case_answers import calibration_fingerprint
from validation.diagnosis.linearizations import Job, linearize_case, load
from validation.diagnosis.scored_cases import ScoredCase, decision_on, score_case
from validation.recorded.manipulations import Manipulation, manipulations_of, write_manipulation
from validation.recorded.recordings import add_subjects_argument
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.diagnosis.claims.decision import DecisionConstants
from wrapjax.diagnosis.effects.catalogue import family_of
from wrapjax.errors import InputError, Problem

#: Folders of $WRAPJAX_DATA that are used by default.
PEOPLE = ("s1_left", "healthy_treadmill", "healthy_running")
UNTOUCHED = Manipulation("untouched", "as it was recorded", list, None)
#: Target share of manipulations whose effect or family rises most, and largest share that is named wrongly.
TARGET, WRONG = 0.80, 0.03
_RESAMPLES = 2000


@dataclass(frozen=True)
class Row:
    """Result of one manipulation.

    Parameters
    ----------
    person, says, effect
        Name of the person's folder, description of the change, and the effect that should be found.
    detectability
        d' of the effect at its prior size in the untouched recording, or in the changed one where it is
        testable there alone; None where it is not testable.
    rise
        Increase of the evidence of each effect over the untouched recording, nats, the largest first.
    outcome, accepted, family
        What the decision says: its outcome, named or tied effects, and the family; all by linearised fits.
    """

    person: str
    says: str
    effect: str
    detectability: float | None
    rise: Mapping[str, float]
    outcome: str
    accepted: tuple[str, ...]
    family: str

    @property
    def first(self) -> str:
        """Effect whose evidence rises most."""
        return next(iter(self.rise))

    @property
    def right(self) -> bool:
        """Whether the effect that rises most is the added one, or of its family."""
        return family_of(self.first) == family_of(self.effect)

    @property
    def named_wrongly(self) -> bool:
        """Whether something is named or tied that neither is the added effect nor has its family."""
        claimed = {*map(family_of, self.accepted), *([self.family] if self.family else [])}
        return bool(claimed) and family_of(self.effect) not in claimed


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    try:
        jobs: dict[str, tuple[Manipulation, Job]] = {}
        for person in options.subjects:
            jobs |= _jobs(person, options)
        failed = _linearize(jobs, options.workers)
        scored = _score_all(jobs, options.workers)
        rows = [row for person in options.subjects for row in _rows(person.name, jobs, scored)]
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(untouched(scored), table(rows), sep="\n\n", end="")
    return 1 if failed else 0


def _jobs(person: Path, options: argparse.Namespace) -> dict[str, tuple[Manipulation, Job]]:
    """Write the folders of a person that are requested, by the name of person and manipulation."""
    from wrapjax.subject.subject import load_subject

    load_subject(person)
    possible = {one.name: one for one in manipulations_of(person, options.magnitudes)}
    if unknown := [name for name in options.only or () if name not in possible]:
        hint = f"there are {', '.join(possible)}"
        raise InputError(Problem("--only", f"{person.name} has no manipulation '{unknown[0]}'", hint=hint))
    jobs = {}
    for one in (UNTOUCHED, *(possible[name] for name in options.only or possible)):
        name = f"{person.name}.{one.name}"
        folder = (options.out / "subjects" / name).resolve()
        write_manipulation(person, folder, one)
        file = (options.out / "linearized" / f"{name}.npz").resolve()
        jobs[name] = (one, Job(folder, file, options.starts))
    return jobs


def _linearize(jobs: Mapping[str, tuple[Manipulation, Job]], workers: int) -> int:
    """Linearise what is not yet linearised with this code and these files; return how many failed."""
    from wrapjax.io.files import write_json

    open_jobs, questions = {}, {}
    for name, (_, job) in jobs.items():
        questions[name] = {**calibration_fingerprint(job.case), "starts": job.starts}
        beside = job.file.with_suffix(".json")
        known = json.loads(beside.read_text(encoding="utf-8")) if beside.exists() else None
        if known != questions[name] or not job.file.exists():
            job.file.unlink(missing_ok=True)
            job.file.parent.mkdir(parents=True, exist_ok=True)
            open_jobs[name] = job
    failed = 0
    for number, one in enumerate(
        run_jobs(linearize_case, open_jobs, workers=workers) if open_jobs else (), 1
    ):
        failed += bool(one.failure)
        if not one.failure:
            write_json(jobs[one.name][1].file.with_suffix(".json"), questions[one.name])
        text = one.failure or one.value
        print(f"{number}/{len(open_jobs)} {one.name}: {text}", file=sys.stderr, flush=True)
    return failed


def _score(job: Job) -> ScoredCase:
    """Score a linearised recording; its truth is not used."""
    truth = {"tier": "none", "causes": [], "ties": [], "d_star": 0.0}
    return score_case(truth, load(job.file))


def _score_all(jobs: Mapping[str, tuple[Manipulation, Job]], workers: int) -> dict[str, ScoredCase]:
    """Score all linearised recordings in the order of ``jobs``."""
    known = {name: job for name, (_, job) in jobs.items() if job.file.exists()}
    found = {one.name: one for one in run_jobs(_score, known, workers=workers)} if known else {}
    if failed := [one for one in found.values() if one.failure]:
        raise InputError([Problem(one.name, f"was not scored: {one.failure}") for one in failed])
    return {name: found[name].value for name in known}


def _rows(
    person: str, jobs: Mapping[str, tuple[Manipulation, Job]], scored: Mapping[str, ScoredCase]
) -> list[Row]:
    """Compare every manipulation of a person with the untouched recording; none without that."""
    constants = DecisionConstants.shipped()
    before = scored.get(f"{person}.{UNTOUCHED.name}")
    if before is None:
        return []
    rows = []
    for name, case in scored.items():
        manipulation = jobs[name][0]
        if name.split(".")[0] != person or manipulation.effect is None:
            continue
        decision = decision_on(case, constants)
        # An effect that can be tested only with the error, such as a lost channel, had no evidence before.
        rise = {id: value - before.evidence.get(id, 0.0) for id, value in case.evidence.items()}
        detectability = {**case.detectability, **before.detectability}
        rows.append(
            Row(
                person=person,
                says=manipulation.says,
                effect=manipulation.effect,
                detectability=detectability.get(manipulation.effect),
                rise={id: rise[id] for id in sorted(rise, key=lambda id: -rise[id])},
                outcome=decision.outcome,
                accepted=decision.accepted,
                family=decision.family,
            )
        )
    return rows


def untouched(scored: Mapping[str, ScoredCase]) -> str:
    """Say what the decision is on every untouched recording."""
    constants = DecisionConstants.shipped()
    lines = []
    for name, case in scored.items():
        person, _, manipulation = name.partition(".")
        if manipulation == UNTOUCHED.name:
            decision = decision_on(case, constants)
            lines.append(f"{person}, untouched: {decision.outcome} {', '.join(decision.accepted)}".rstrip())
    return "\n".join(lines)


def table(rows: Sequence[Row]) -> str:
    """Format Markdown tables of all manipulations, and the counts by person and over all."""
    lines = [
        "| recording | added error | its effect: d' at prior size, rise (nats), rank | largest rise | said |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        if row.effect in row.rise:
            rank = list(row.rise).index(row.effect) + 1
            own = f"`{row.effect}`: {row.detectability or 0.0:.1f}, {row.rise[row.effect]:+.1f}, {rank}"
        else:
            own = f"`{row.effect}`: not testable"
        said = f"{row.outcome} {', '.join([*row.accepted, *([row.family] if row.family else [])])}".strip()
        first = f"`{row.first}` {row.rise[row.first]:+.1f}"
        lines.append(f"| {row.person} | {row.says} | {own} | {first} | {said} |")
    if rows:
        lines += ["", *_counts(rows)]
    return "\n".join(lines) + "\n"


def _counts(rows: Sequence[Row]) -> list[str]:
    people = list(dict.fromkeys(row.person for row in rows))
    by_person = [[row.right for row in rows if row.person == name] for name in people]
    share = np.mean([row.right for row in rows])
    each = ", ".join(f"{name} {sum(own)} of {len(own)}" for name, own in zip(people, by_person, strict=True))
    constant, times = Counter(family_of(row.effect) for row in rows).most_common(1)[0]
    wrong = sum(row.named_wrongly for row in rows)
    return [
        f"The added effect or its family rises most in {share:.0%} of {len(rows)} "
        f"({_interval(by_person)}target {TARGET:.0%}): {each}.",
        f"The best constant answer, `{constant}`, would be right in {times / len(rows):.0%}.",
        f"Named wrongly: {wrong} of {len(rows)} (target at most {WRONG:.0%}).",
    ]


def _interval(by_person: Sequence[Sequence[bool]]) -> str:
    """Describe the 95 % interval of a share by resampling people; empty for one person.

    People are the independent units, and not the manipulations of one person.
    """
    people = len(by_person)
    if people < 2:
        return ""
    drawn = np.random.default_rng(0).integers(people, size=(_RESAMPLES, people))
    shares = [np.mean(np.concatenate([by_person[place] for place in draw])) for draw in drawn]
    low, high = np.quantile(shares, [0.025, 0.975])
    return f"{low:.0%} to {high:.0%} by resampling people; "


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.recorded", description=__doc__)
    add_subjects_argument(parser, PEOPLE)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="manipulations to run (default: all)")
    parser.add_argument(
        "--magnitudes",
        type=float,
        nargs="+",
        default=[2.0],
        help="sizes of the added errors in prior standard deviations (default: 2)",
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--starts", type=int, default=2, help="starts of each calibration (default: 2)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
