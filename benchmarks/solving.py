"""Time, effort and final cost of NGA solves by wrapjax and by other optimizers from one start."""

from __future__ import annotations

import time

import jax
import numpy as np

from benchmarks.case import Case
from benchmarks.counting import counted_evaluations
from benchmarks.metric import INFORMATION, Metric
from benchmarks.other_solvers import OTHER_SOLVERS
from benchmarks.published_times import NMSM_PIPELINE, compare_with_published
from benchmarks.timed_run import Run
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt

#: Relative distance from the cost of wrapjax at which another optimizer counts as converged. The problem has
#: several minima less than one percent apart, and which of them an optimizer finds depends on chance.
CONVERGED = 1e-2

OURS = "wrapjax"
#: Evaluations of the cost over which its time is averaged.
_COSTS = 20


def our_solve(case: Case, *, quick: bool = False) -> tuple[Run, list[Metric]]:
    """Solve NGA by wrapjax; measure time, cost and effort, and compare with published effort."""
    ours = _our_run(case, repeats=2 if quick else 5)
    value = case.compiled(lambda problem, x: problem.value(x))
    jax.block_until_ready(value(case.start))
    began = time.process_time()
    for _ in range(_COSTS):
        jax.block_until_ready(value(case.start))
    cost_seconds = (time.process_time() - began) / _COSTS
    return ours, [
        *_metrics(case, ours),
        *compare_with_published(ours, cost_seconds, case.size, NMSM_PIPELINE),
    ]


def solves(case: Case, *, quick: bool = False, limit: float = 120.0) -> list[Metric]:
    """Solve NGA by wrapjax and by other optimizers from one start; measure times and final costs.

    Each of the other optimizers runs for at most ``limit`` seconds.
    """
    ours, metrics = our_solve(case, quick=quick)
    for name, solve in OTHER_SOLVERS.items():
        try:
            run = solve(case, limit)
        except ImportError as error:
            note = f"not installed: {error.name}"
            metrics.append(Metric(f"solve/{name}", np.nan, "s", "lower", note, INFORMATION))
            continue
        metrics += _metrics(case, run) + [_speedup(ours, run)]
    return metrics


def _our_run(case: Case, repeats: int) -> Run:
    solver = ProjectedLevenbergMarquardt()
    solver.compile(case.problem, case.start)
    # The first solve may compile programs that only the second step needs; its evaluations count, not its
    # time.
    with counted_evaluations() as asked:
        solver.solve(case.problem, case.start)
    seconds, core_seconds = [], []
    for _ in range(repeats):
        began, began_core = time.perf_counter(), time.process_time()
        solution = solver.solve(case.problem, case.start)
        jax.block_until_ready(solution.linearization)
        seconds.append(time.perf_counter() - began)
        core_seconds.append(time.process_time() - began_core)
    trace = tuple((one.seconds, one.cost) for one in solution.history)
    return Run(
        name=OURS,
        seconds=float(np.median(seconds)),
        core_seconds=float(np.median(core_seconds)),
        cost=solution.cost,
        variables=solution.variables,
        trace=trace,
        message=f"{asked.values} costs and {asked.linearizations} linearizations; {solution.status.value}",
        evaluations=asked.total,
        iterations=solution.iterations,
    )


def _metrics(case: Case, run: Run) -> list[Metric]:
    prefix = f"solve/{run.name}"
    tolerance = None if run.name == OURS else INFORMATION
    figures = [
        ("", run.seconds, "s", run.message),
        ("/core_seconds", run.core_seconds, "core s", "of all processors"),
        ("/evaluations", run.evaluations, "evaluations", "of cost or residuals"),
        ("/cost", run.cost, "1", ""),
        *((f"/mae_{use}", error, "N m", "") for use, error in case.moment_mae(run.variables).items()),
    ]
    if run.iterations:
        figures.append(("/iterations", run.iterations, "iterations", ""))
    return [
        Metric(f"{prefix}{name}", value, unit, "lower", note, tolerance)
        for name, value, unit, note in figures
    ]


def _speedup(ours: Run, other: Run) -> Metric:
    """Compute the time of another optimizer to reach the cost of wrapjax, over the time of wrapjax."""
    reached = other.seconds_to_reach(ours.cost * (1.0 + CONVERGED))
    seconds = other.seconds if reached is None else reached
    note = "its time to within 1 % of wrapjax's cost, over wrapjax's time to convergence"
    if reached is None:
        note = f"lower bound: never within 1 % of wrapjax's cost (best {other.cost:.5g} to {ours.cost:.5g})"
    return Metric(f"solve/{other.name}/slower", seconds / ours.seconds, "x", "higher", note, tolerance=1.0)
