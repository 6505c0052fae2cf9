"""Time, effort and quality of whole solves, ours and those of peers, from one start."""

from __future__ import annotations

import time

import jax
import numpy as np

from benchmarks.case import Case
from benchmarks.counting import counted_evaluations
from benchmarks.metric import INFORMATION, Metric
from benchmarks.peers import PEERS
from benchmarks.published import NMSM_PIPELINE, beside_published
from benchmarks.race import Run
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt

#: A peer has arrived when its cost is this close to ours, relatively. The problem has several minima
#: less than one percent apart, and which of them an optimizer meets is luck.
ARRIVED = 1e-2

OURS = "wrapjax"
#: How many costs are evaluated to learn what one takes.
_COSTS = 20


def our_solve(case: Case, *, quick: bool = False) -> tuple[Run, list[Metric]]:
    """Solve NGA with our solver: time, quality and effort, beside what was published of another tool's."""
    ours = _our_run(case, repeats=2 if quick else 5)
    value = case.compiled(lambda problem, x: problem.value(x))
    jax.block_until_ready(value(case.start))
    began = time.process_time()
    for _ in range(_COSTS):
        jax.block_until_ready(value(case.start))
    cost_seconds = (time.process_time() - began) / _COSTS
    return ours, [*_metrics(case, ours), *beside_published(ours, cost_seconds, case.size, NMSM_PIPELINE)]


def solves(case: Case, *, quick: bool = False, limit: float = 120.0) -> list[Metric]:
    """Solve NGA with our solver and with peers, from one start; quality beside time.

    No peer runs longer than ``limit`` seconds.
    """
    ours, metrics = our_solve(case, quick=quick)
    for name, solve in PEERS.items():
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
    # The first solve may still compile what only the second step needs; it is counted, but not timed.
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


def _speedup(ours: Run, peer: Run) -> Metric:
    """Peer's time to come near our cost, over the time of our whole solve."""
    arrival = peer.arrival(ours.cost * (1.0 + ARRIVED))
    seconds = peer.seconds if arrival is None else arrival
    note = "its time to within 1 % of our cost, over our time to the end"
    if arrival is None:
        note = f"at least: it never came within 1 % of our cost (best {peer.cost:.5g} to {ours.cost:.5g})"
    return Metric(f"solve/{peer.name}/slower", seconds / ours.seconds, "x", "higher", note, tolerance=1.0)
