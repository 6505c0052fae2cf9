"""Number of programs compiled again by a second solve and by a second subject of the same shape."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.counting import counted_programs
from benchmarks.metric import Metric
from benchmarks.tiled_problems import perturb_problem
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt


def recompilations(problem: Objective) -> list[Metric]:
    """Count the programs requested from XLA by a second solve, and by two steps with a second subject."""
    solver = ProjectedLevenbergMarquardt(max_iterations=2)
    # An indefinite Hessian needs its own program, which not every solve requires; `compile` compiles it, too.
    solver.compile(problem, problem.variables.start())
    solver.solve(problem, problem.variables.start())
    with counted_programs() as again:
        solver.solve(problem, problem.variables.start())
    second = perturb_problem(problem, seed=1)
    with counted_programs() as by_second:
        solver.compile(second, second.variables.start())
        solver.solve(second, second.variables.start())
    return [
        Metric("recompilation/second_solve", len(again), "programs", "lower", _names(again)),
        Metric("recompilation/second_person", len(by_second), "programs", "lower", _names(by_second)),
    ]


def _names(programs: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(programs)) or "no program requested"
