"""Ranking of causes with the simulator's truth in place of one assumption of the diagnosis after the other.

``python -m validation.diagnosis.ladder --bank BANK --out DIR`` records the cases of the world `thelen` of the
bank `worlds` again, with the same people, causes, effect sizes and noise of moments, but a model file that
has the person's own paths, or envelopes without noise; or calibrates with the law of the person's muscles.
It linearizes and scores them, and prints a table: the assumption whose truth raises the ranks most is the one
that costs most.
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

from benchmarks.machine import pin_threads
from validation.blind.anatomy import Leg
from validation.blind.background import background_of, with_background
from validation.blind.case import ALL
from validation.blind.folder import write_folder
from validation.blind.library import library_of
from validation.blind.make import person_of, variants_of
from validation.blind.noise import moment_noise, noisy_envelopes
from validation.blind.oracle import cycles
from validation.blind.person import Person
from validation.blind.plan import Bank, banks_of, plan_cases, settings_of
from validation.blind.world import record
from validation.diagnosis.bank_cases import development_truth
from validation.diagnosis.linearizations import Job, linearize_case, load
from validation.diagnosis.scored_cases import ScoredCase
from validation.diagnosis.simulator_signatures import score_both
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.errors import InputError, Problem
from wrapjax.muscle.published_laws import GIVEN_LAW

#: World whose people have a published muscle law that a calibration can take.
WORLD = "thelen"


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
        rows = [_row(step, options.bank, bank, options.out.resolve(), options.workers) for step in STEPS]
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    columns = (
        *("given of the truth", "first", "first, d* above 5", "first three"),
        "strongest evidence with nothing amiss, median and largest (nats)",
        "first, signatures of the simulator",
    )
    print(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", *rows, sep="\n")
    return 0


def _bank_of(folder: Path, cases: int) -> Bank:
    (bank,) = banks_of("worlds", cases, WORLD)
    if not any((folder / "truth").glob("*.json")):
        hint = f"make it with python -m validation.blind make --bank worlds --cases {cases} --world {WORLD}"
        raise InputError(Problem(str(folder), "no cases of the world", place=WORLD, hint=hint))
    return bank


def _row(step: Step, folder: Path, bank: Bank, out: Path, workers: int) -> str:
    """Record, linearize and score all single causes and people with nothing amiss; return a row."""
    truths = {}
    jobs = {}
    for planned in plan_cases(bank, variants_of(settings_of(bank, bank.first_person))):
        if planned.tier not in ("single", "none"):
            continue
        truths[planned.id] = development_truth(folder, planned.id)
        case, file = out / step.name / "cases" / planned.id, out / step.name / f"{planned.id}.npz"
        if not case.exists():
            _record(step, bank, planned.order, truths[planned.id], case)
        if not file.exists():
            jobs[planned.id] = Job(case, file, starts=2, muscle_law=WORLD if step.law else GIVEN_LAW)
    for number, one in enumerate(run_jobs(linearize_case, jobs, workers=workers) if jobs else (), 1):
        print(f"{step.name} {number}/{len(jobs)} {one.name}: {one.failure or one.value}", file=sys.stderr)
    scored = [
        score_both(truth, load(out / step.name / f"{id}.npz"), library_of(folder, truth["person"]))
        for id, truth in truths.items()
        if (out / step.name / f"{id}.npz").exists()
    ]
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
    )
    return f"| {' | '.join(entries)} |"


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
    clean, settings = record(world), world.settings
    # Drawn in the same order as for the bank, so that the noise of the moments is the same.
    noise = moment_noise(world.walk, world.leg.mass, rng, settings.moments)
    emg = np.maximum(clean.emg, 0.0)
    if not step.emg:
        emg = noisy_envelopes(clean.emg, truth["emg_noise"], rng, settings.emg)
    recorded = {"moments": clean.moments + noise, "emg": emg, "pose": clean.pose, "ground": clean.ground}
    work = folder.with_name(f"partial_{folder.name}") / folder.name
    shutil.rmtree(work.parent, ignore_errors=True)
    write_folder(
        work,
        _own_paths(who) if step.paths else who.nominal,
        who.paretic,
        who.world.walk.speeds,
        cycles(who.world),
        recorded,
        settings.gait.calibration,
        settings.emg.unrecorded,
    )
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
