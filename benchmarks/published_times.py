"""Published effort of another tool's calibration, compared with the measured effort of wrapjax."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.metric import Metric
from benchmarks.timed_run import Run


@dataclass(frozen=True)
class PublishedRun:
    """Published calibration by another tool on another machine.

    Parameters
    ----------
    name, source
        Name of the tool, and publication of its figures.
    evaluations, iterations
        Evaluations of the cost, and iterations of the optimizer.
    minutes, threads
        Wall time, and number of threads. All threads are assumed to be busy.
    problem
        Description of the problem.
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
        """Upper bound of the processor time (s)."""
        return 60.0 * self.minutes * self.threads


#: The NMSM Pipeline's muscle-tendon personalisation, by MATLAB's SQP with finite differences.
NMSM_PIPELINE = PublishedRun(
    name="nmsm_pipeline",
    source="the NMSM Pipeline's tutorial on muscle-tendon personalisation, right leg",
    evaluations=161_831,
    iterations=409,
    minutes=7.4,
    threads=16,
    problem="one trial, 43 muscles, EMG of some extrapolated by synergies",
)

#: Target ratio of published evaluations to those of wrapjax.
EVALUATIONS_TARGET = 1000


def compare_with_published(ours: Run, cost_seconds: float, size: str, theirs: PublishedRun) -> list[Metric]:
    """Compute ratios of published evaluations, iterations and core-seconds to those of wrapjax.

    Problems and machines differ, so only orders of magnitude are meaningful.

    Parameters
    ----------
    ours
        Measured run of wrapjax.
    cost_seconds
        Processor time (s) of one evaluation of the cost by wrapjax. It expresses the whole solve, with its
        expensive linearizations, in evaluations of the cost.
    size
        Size of the measured problem, as text.
    theirs
        Published run.
    """
    prefix = f"solve/{theirs.name}"
    return [
        Metric(
            "solve/wrapjax/cost_evaluations_worth",
            ours.core_seconds / cost_seconds,
            "evaluations",
            "lower",
            "evaluations of the cost alone that take as much processor time as the whole solve",
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
