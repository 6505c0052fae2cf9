"""What others published of how long their tools take, restated beside what we counted in the same run."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.metric import Metric
from benchmarks.race import Run


@dataclass(frozen=True)
class PublishedRun:
    """A calibration that somebody else's tool did on somebody else's machine.

    Parameters
    ----------
    name, source
        Of the tool, and where its figures are.
    evaluations, iterations
        Of the cost, and of the optimizer.
    minutes, threads
        Wall time, and how many threads it was given. That all of them were busy is our assumption.
    problem
        In words.
    """

    name: str
    source: str
    evaluations: int
    iterations: int
    minutes: float
    threads: int
    problem: str

    @property
    def core_seconds(self) -> float:
        """Processor time at most."""
        return 60.0 * self.minutes * self.threads


#: The NMSM Pipeline's muscle-tendon personalisation, by MATLAB's SQP with finite differences.
NMSM_PIPELINE = PublishedRun(
    name="nmsm_pipeline",
    source="the NMSM Pipeline's tutorial on muscle-tendon personalisation, right leg",
    evaluations=161_831,
    iterations=409,
    minutes=7.4,
    threads=16,
    problem="one trial, 43 muscles, EMG of some made up by synergies",
)

#: How many times fewer evaluations we want to need than it did.
EVALUATIONS_TARGET = 1000


def beside_published(ours: Run, cost_seconds: float, size: str, theirs: PublishedRun) -> list[Metric]:
    """Restate a published run as evaluations, iterations and core-seconds, over ours.

    Problems and machines differ: orders of magnitude are meant, not digits.

    Parameters
    ----------
    ours
        Counted and timed now.
    cost_seconds
        Processor time of one evaluation of our cost: linearizations are dear, and this says how dear in all.
    size
        Of our problem, in words.
    theirs
        As published.
    """
    prefix = f"solve/{theirs.name}"
    return [
        Metric(
            "solve/wrapjax/cost_evaluations_worth",
            ours.core_seconds / cost_seconds,
            "evaluations",
            "lower",
            "as many evaluations of the cost alone take as much processor time as our whole solve",
            tolerance=1.0,
        ),
        Metric(
            f"{prefix}/evaluations_over_ours",
            theirs.evaluations / ours.evaluations,
            "x",
            "higher",
            f"{theirs.evaluations:,} to {ours.evaluations}; {theirs.problem}, to {size}; "
            f"target at least {EVALUATIONS_TARGET:,}",
        ),
        Metric(
            f"{prefix}/iterations_over_ours",
            theirs.iterations / ours.iterations if ours.iterations else float("nan"),
            "x",
            "higher",
            f"{theirs.iterations} to {ours.iterations}",
        ),
        Metric(
            f"{prefix}/core_seconds_over_ours",
            theirs.core_seconds / ours.core_seconds,
            "x",
            "higher",
            f"{theirs.minutes} min on {theirs.threads} threads, {theirs.core_seconds:,.0f} core-seconds at "
            f"most, to {ours.core_seconds:.3g}; published, on another machine: {theirs.source}",
            tolerance=1.0,
        ),
    ]
