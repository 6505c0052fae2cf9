"""Ranking of causes with the simulator's truth in place of one assumption of the diagnosis after the other.

``python -m validation.diagnosis.ladder --bank BANK --out DIR`` records the cases of the world `thelen` of the
bank `worlds` again, with the same people, causes, effect sizes and noise of moments, but a model file that
has the person's own paths, or envelopes without noise; or calibrates with the law of the person's muscles.
It linearizes and scores them, and prints a table: the assumption whose truth raises the ranks most is the one
that costs most. The last columns are what these null hypotheses allow at best: how often the cause would be
first if residuals were drawn from the most probable null and the simulator's signal were added to them.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.machine import pin_threads
from validation.blind.anatomy import Leg
from validation.blind.background import background_of, with_background
from validation.blind.case import ALL, record_with_noise, write_recorded
from validation.blind.library import library_of
from validation.blind.make import person_of, variants_of
from validation.blind.person import Person
from validation.blind.plan import Bank, PlannedCase, banks_of, plan_cases, settings_of
from validation.diagnosis.bank_cases import development_truth
from validation.diagnosis.linearizations import Job, LinearizedCase, linearize_case, load
from validation.diagnosis.scored_cases import ScoredCase
from validation.diagnosis.signal_losses import in_residual_order, signal_of
from validation.diagnosis.simulator_signatures import score_both, simulator_candidates
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.diagnosis.evidence.linearization import Candidate
from wrapjax.diagnosis.evidence.score_test import project, score_each
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.errors import InputError, Problem
from wrapjax.muscle.published_laws import GIVEN_LAW

#: World whose people have a published muscle law that a calibration can take.
WORLD = "thelen"
#: Residuals drawn for each case, and their seed.
DRAWS, SEED = 40, 5


@dataclass(frozen=True)
class Step:
    """What a diagnosis is given of the truth.

    Parameters
    ----------
    law
        Whether it calibrates with the law of the person's muscles.
    paths
        Whether the model file has the person's own muscle paths.
    emg
        Whether the envelopes are without noise.
    """

    law: bool = False
    paths: bool = False
    emg: bool = False

    @property
    def name(self) -> str:
        """Name of the folder and of the row of the table."""
        return "_".join(name for name, given in vars(self).items() if given) or "nothing"


STEPS = (
    Step(),
    Step(law=True),
    Step(paths=True),
    Step(emg=True),
    Step(law=True, paths=True),
    Step(law=True, paths=True, emg=True),
)


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    try:
        bank = _bank_of(options.bank, options.cases)
        failures = [_linearize(step, options.bank, bank, options.out, options.workers) for step in STEPS]
        if any(failures):
            return 1
        rows = [_row(step, options.bank, bank, options.out) for step in STEPS]
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    columns = (
        *("given of the truth", "first", "first, d* above 5", "first three"),
        "strongest evidence with nothing amiss, median and largest (nats)",
        "first, signatures of the simulator",
        "first, d* above 5, were the null exact",
        "the same, signatures of the simulator",
    )
    print(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", *rows, sep="\n")
    return 0


def _bank_of(folder: Path, cases: int) -> Bank:
    (bank,) = banks_of("worlds", cases, WORLD)
    if not any((folder / "truth").glob("*.json")):
        hint = f"make it with python -m validation.blind make --bank worlds --cases {cases} --world {WORLD}"
        raise InputError(Problem(str(folder), "no cases of the world", place=WORLD, hint=hint))
    return bank


def _cases_of(bank: Bank) -> list[PlannedCase]:
    """Select single causes and people with nothing amiss."""
    planned = plan_cases(bank, variants_of(settings_of(bank, bank.first_person)))
    return [case for case in planned if case.tier in ("single", "none")]


def _linearize(step: Step, folder: Path, bank: Bank, out: Path, workers: int) -> int:
    """Record and linearize the cases that are not yet linearized; return how many failed."""
    jobs = {}
    for planned in _cases_of(bank):
        truth = development_truth(folder, planned.id)
        case, file = (out / step.name / name for name in (f"cases/{planned.id}", f"{planned.id}.npz"))
        if not case.exists():
            _record(step, bank, planned.order, truth, case)
        if not file.exists():
            law = WORLD if step.law else GIVEN_LAW
            jobs[planned.id] = Job(case.resolve(), file.resolve(), starts=2, muscle_law=law)
    failed = 0
    for number, one in enumerate(run_jobs(linearize_case, jobs, workers=workers) if jobs else (), 1):
        failed += bool(one.failure)
        print(f"{step.name} {number}/{len(jobs)} {one.name}: {one.failure or one.value}", file=sys.stderr)
    return failed


def _row(step: Step, folder: Path, bank: Bank, out: Path) -> str:
    """Score all linearized cases; return a row of the table."""
    scored, exact = [], []
    for planned in _cases_of(bank):
        truth = development_truth(folder, planned.id)
        lines, library = load(out / step.name / f"{planned.id}.npz"), library_of(folder, truth["person"])
        scored.append(score_both(truth, lines, library))
        if scored[-1][0].clear and truth["d_star"] > 5.0:
            signal, accepted = signal_of(folder, truth), scored[-1][0].accepted
            candidates = lines.linearized.candidates, simulator_candidates(lines.linearized, library)
            exact.append([first_were_the_null_exact(lines, signal, accepted, own) for own in candidates])
    ours, theirs = ([pair[place] for pair in scored] for place in (0, 1))
    nothing = [max(one.evidence.values()) for one in ours if one.nothing_amiss]
    clear = [one for one in ours if one.clear]
    strong = [one for one in clear if one.truth["d_star"] > 5.0]
    entries = (
        step.name.replace("_", ", "),
        _first(clear),
        _first(strong),
        _first(clear, 3),
        f"{np.median(nothing):.1f}, {max(nothing):.1f}",
        _first([one for one in theirs if one.clear]),
        *(f"{share:.2f}" for share in np.mean(exact, axis=0)),
    )
    return f"| {' | '.join(entries)} |"


def first_were_the_null_exact(
    lines: LinearizedCase,
    signal: Float[np.ndarray, "cycle phase coordinate"],
    accepted: set[str],
    candidates: Sequence[Candidate],
) -> float:
    """Compute how often a cause is first in residuals that have the covariance of the most probable null.

    Parameters
    ----------
    lines
        Linearized model of a case.
    signal
        Change of the moments by the cause, N m.
    accepted
        Effects that are correct to rank first.
    candidates
        Effects to rank.

    Returns
    -------
    share
        Share of the draws in which an accepted effect has the largest evidence.
    """
    linearized = lines.linearized
    hypotheses = list(nulls(linearized, lines.recorded.measured_moment_sd))
    own = linearized.residual.reshape(1, -1)
    probable = max(hypotheses, key=lambda null: project(own, null, ()).weight[0])
    deviates = np.random.default_rng(SEED).standard_normal((DRAWS, own.size))
    residuals = in_residual_order(signal, linearized) + deviates @ np.linalg.cholesky(probable.covariance).T
    tests = score_each(residuals, hypotheses, candidates)
    strongest = [max(test.scores, key=lambda one: one.evidence).id for test in tests]
    return float(np.mean([id in accepted for id in strongest]))


def _first(cases: Sequence[ScoredCase], count: int = 1) -> str:
    return f"{sum(bool(set(one.ranked[:count]) & one.accepted) for one in cases)} of {len(cases)}"


def _record(step: Step, bank: Bank, order: int, truth: dict[str, Any], folder: Path) -> None:
    """Write a case again, with the same causes and effect sizes."""
    index = next(one for one in bank.persons if f"{bank.name}_{one:02d}" == truth["person"])
    who = person_of(bank, index)
    world = who.world
    for cause in truth["causes"]:
        world = ALL[cause["id"]].apply(world, cause["amount"], tuple(cause["variant"]))
    world = with_background(world, background_of(who, (bank.seed, 4, index)))
    rng = np.random.default_rng((bank.seed, 3, order))
    clean, noise, noisy = record_with_noise(world, truth["emg_noise"], rng)
    emg = clean.emg if step.emg else noisy
    recorded = {"moments": clean.moments + noise, "emg": emg, "pose": clean.pose, "ground": clean.ground}
    work = folder.with_name(f"partial_{folder.name}") / folder.name
    shutil.rmtree(work.parent, ignore_errors=True)
    write_recorded(work, who, _own_paths(who) if step.paths else who.nominal, recorded)
    folder.parent.mkdir(parents=True, exist_ok=True)
    work.rename(folder)
    work.parent.rmdir()


def _own_paths(who: Person) -> Leg:
    """Return the person's own leg, with the tendon slack lengths of the nominal one."""
    muscles = tuple(
        replace(own, tendon_slack_length=nominal.tendon_slack_length)
        for own, nominal in zip(who.world.leg.muscles, who.nominal.muscles, strict=True)
    )
    return replace(who.world.leg, muscles=muscles)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.diagnosis.ladder", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True, help=f"bank `worlds` with the world {WORLD}")
    parser.add_argument("--cases", type=int, default=320, help="size of the whole bank (default: 320)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the cases recorded again")
    parser.add_argument("--workers", type=int, default=2)
    return parser


if __name__ == "__main__":
    sys.exit(main())
