"""Whether what is compiled serves again: for the next solve, and for the next person of the same shape."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.counting import counted_programs
from benchmarks.metric import Metric
from benchmarks.tiled import another_person
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt


def recompilations(problem: Objective) -> list[Metric]:
    """Count the programs that XLA is asked for by a second solve, and by two steps with a second person."""
    solver = ProjectedLevenbergMarquardt(max_iterations=2)
    # Indefinite Hessians need a program of their own, which not every solve meets; this one compiles it, too.
    solver.compile(problem, problem.variables.start())
    solver.solve(problem, problem.variables.start())
    with counted_programs() as again:
        solver.solve(problem, problem.variables.start())
    other = another_person(problem, seed=1)
    with counted_programs() as elsewhere:
        solver.compile(other, other.variables.start())
        solver.solve(other, other.variables.start())
    return [
        Metric("recompilation/second_solve", len(again), "programs", "lower", _names(again)),
        Metric("recompilation/second_person", len(elsewhere), "programs", "lower", _names(elsewhere)),
    ]


def _names(programs: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(programs)) or "all that is needed is there"
