"""One calibration from several starts, in stages, resumable after any step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.solvers.augmented_lagrangian import (
    AugmentedLagrangian,
    ConstrainedSolution,
    LagrangianState,
)
from wrapjax.calibration.solvers.checkpoints import Checkpoints
from wrapjax.calibration.solvers.interface import AbstractCalibration, Iteration, Status

# How far random starts lie from the first, in parts of the way to each bound.
_SPREAD = 0.3

#: Called after each iteration with the number of the start, the iteration and the solver's state.
IterationCallback = Callable[[int, Iteration, LagrangianState], None]


@dataclass(frozen=True)
class Outcome:
    """Where one start led."""

    #: None for the model's own values.
    seed: int | None
    start: Float[np.ndarray, " variable"]
    solution: ConstrainedSolution

    @property
    def seconds(self) -> float:
        """Time that went into solving, over all stages."""
        return self.solution.history[-1].seconds


def starting_points(
    problem: AbstractCalibration, first: Float[np.ndarray, " variable"], count: int, seed: int
) -> list[tuple[int | None, Float[np.ndarray, " variable"]]]:
    """Give the first start and random ones around it, each with the seed that makes it again.

    A random start lies up to 30 % of the way from the first towards either bound, uniformly; variables
    without bounds start where the first does.
    """
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    down = np.where(np.isfinite(lower), first - lower, 0.0)
    up = np.where(np.isfinite(upper), upper - first, 0.0)
    points: list[tuple[int | None, Float[np.ndarray, " variable"]]] = [(None, first)]
    for number in range(1, count):
        own = seed + number
        share = np.random.default_rng(own).uniform(-_SPREAD, _SPREAD, first.size)
        points.append((own, first + share * np.where(share < 0.0, down, up)))
    return points


def solve_from_starts(
    stages: Sequence[AbstractCalibration],
    starts: Sequence[tuple[int | None, Float[np.ndarray, " variable"]]],
    solver: AugmentedLagrangian,
    watch: IterationCallback | None = None,
    checkpoints: Checkpoints | None = None,
) -> tuple[Outcome, ...]:
    """Solve the stages one after the other from every start.

    Each stage frees more than the one before and starts where that ended: so the many variables of the
    last begin near an optimum of the few.

    Parameters
    ----------
    stages
        Problems over the same parameter trees.
    starts
        Seeds and points, in the first stage's variables.
    solver
        For every stage.
    watch
        Called after each iteration; see `AugmentedLagrangian.solve` for stopping.
    journal
        Keeps what is finished and where the rest stands. What it holds already is not done again.

    Returns
    -------
    tuple of Outcome
        In the order of the starts; fewer if interrupted.
    """
    outcomes: list[Outcome] = []
    for number, (seed, point) in enumerate(starts):
        solution = None
        for place, problem in enumerate(stages):
            if solution is None:
                at = jnp.asarray(point)
            else:
                at = problem.start(stages[place - 1].parameters(jnp.asarray(solution.variables)))
            before = () if solution is None else solution.history
            solution = _solve(problem, at, solver, (number, place), before, watch, checkpoints)
            if solution.status is Status.interrupted:
                break
        assert solution is not None
        outcomes.append(Outcome(seed, np.asarray(point), solution))
        if solution.status is Status.interrupted:
            break
    return tuple(outcomes)


def best_start(outcomes: Sequence[Outcome]) -> int:
    """Number of the start that ended lowest, among those that converged if any did."""

    def rank(number: int) -> tuple[bool, float]:
        solution = outcomes[number].solution
        return not solution.status.converged, solution.cost

    return min(range(len(outcomes)), key=rank)


def _solve(
    problem: AbstractCalibration,
    at: Float[Array, " variable"],
    solver: AugmentedLagrangian,
    key: tuple[int, int],
    before: tuple[Iteration, ...],
    watch: IterationCallback | None,
    checkpoints: Checkpoints | None,
) -> ConstrainedSolution:
    """Solve one stage of one start, or recall how it ended."""
    number, place = key
    name = f"start_{number}_stage_{place}"
    entry = checkpoints.read(name) if checkpoints else None
    if entry is not None and entry.status is not None:
        return solver.restore(problem, entry.state, entry.status, entry.history)

    def note(iteration: Iteration, state: LagrangianState) -> None:
        log.append(iteration)
        if checkpoints:
            checkpoints.write(name, state, log)
        if watch:
            watch(number, iteration, state)

    start, history = (at, before) if entry is None else (entry.state, entry.history)
    log = list(history)
    solution = solver.solve(problem, start, note, history)
    if checkpoints and solution.status is not Status.interrupted:
        checkpoints.write(name, solution.state, solution.history, solution.status)
    return solution
