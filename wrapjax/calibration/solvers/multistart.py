"""Solution of a calibration from several starting points, in stages, with checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from threadpoolctl import threadpool_limits

from wrapjax.calibration.solvers.augmented_lagrangian import (
    AugmentedLagrangian,
    ConstrainedSolution,
    LagrangianState,
)
from wrapjax.calibration.solvers.checkpoints import Checkpoints
from wrapjax.calibration.solvers.interface import AbstractCalibration, Iteration, Status

# Largest distance of random starts from the first one, as a fraction of the distance to each bound.
_SPREAD = 0.3

#: Called after each iteration with the number of the start, the iteration and the solver's state.
IterationCallback = Callable[[int, Iteration, LagrangianState], None]


@dataclass(frozen=True)
class Outcome:
    """Result of the solves from one starting point."""

    #: Seed of the random starting point; None for the first one, the values of the model.
    seed: int | None
    start: Float[np.ndarray, " variable"]
    solution: ConstrainedSolution

    @property
    def seconds(self) -> float:
        """Time of all stages without compilation."""
        return self.solution.history[-1].seconds


def starting_points(
    problem: AbstractCalibration, first: Float[np.ndarray, " variable"], count: int, seed: int
) -> list[tuple[int | None, Float[np.ndarray, " variable"]]]:
    """Draw random starting points around the first one.

    A random start lies, uniformly, up to 30 % of the way from the first one towards either bound; variables
    without bounds have the same value as in the first one.

    Parameters
    ----------
    problem
        Problem with the bounds.
    first
        First starting point.
    count
        Number of starting points, the first one included.
    seed
        Start number n is drawn with the seed ``seed + n``.

    Returns
    -------
    list of (int or None, Array)
        Seed (None for the first) and point of each start.
    """
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    down = np.where(np.isfinite(lower), first - lower, 0.0)
    up = np.where(np.isfinite(upper), upper - first, 0.0)
    points: list[tuple[int | None, Float[np.ndarray, " variable"]]] = [(None, first)]
    for number in range(1, count):
        start_seed = seed + number
        fraction = np.random.default_rng(start_seed).uniform(-_SPREAD, _SPREAD, first.size)
        points.append((start_seed, first + fraction * np.where(fraction < 0.0, down, up)))
    return points


def solve_from_starts(
    stages: Sequence[AbstractCalibration],
    starts: Sequence[tuple[int | None, Float[np.ndarray, " variable"]]],
    solver: AugmentedLagrangian,
    callback: IterationCallback | None = None,
    checkpoints: Checkpoints | None = None,
) -> tuple[Outcome, ...]:
    """Solve the stages one after the other from every starting point.

    Each stage frees more parameters than the one before and starts from its solution.

    Parameters
    ----------
    stages
        Problems over the same parameter trees.
    starts
        Seed and starting point of each start, in the variables of the first stage.
    solver
        Solver of every stage.
    callback
        Called after each iteration; see `AugmentedLagrangian.solve` for interruptions.
    checkpoints
        Checkpoints of the solves. Finished ones are not repeated, and an unfinished one is continued.

    Returns
    -------
    tuple of Outcome
        Results in the order of the starts; fewer after an interruption.
    """
    # LAPACK's own threads wait for each other and for XLA's: one alone makes SGA an eighth faster.
    with threadpool_limits(1, user_api="blas"):
        return tuple(_outcomes(stages, starts, solver, callback, checkpoints))


def _outcomes(
    stages: Sequence[AbstractCalibration],
    starts: Sequence[tuple[int | None, Float[np.ndarray, " variable"]]],
    solver: AugmentedLagrangian,
    callback: IterationCallback | None,
    checkpoints: Checkpoints | None,
) -> Iterator[Outcome]:
    for number, (seed, point) in enumerate(starts):
        solution = None
        for place, problem in enumerate(stages):
            if solution is None:
                at = jnp.asarray(point)
            else:
                at = problem.start(stages[place - 1].parameters(jnp.asarray(solution.variables)))
            before = () if solution is None else solution.history
            solution = _solve(problem, at, solver, (number, place), before, callback, checkpoints)
            if solution.status is Status.interrupted:
                break
        assert solution is not None
        yield Outcome(seed, np.asarray(point), solution)
        if solution.status is Status.interrupted:
            break


def best_start(outcomes: Sequence[Outcome]) -> int:
    """Find the start with the lowest cost, among those that converged if any did."""

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
    callback: IterationCallback | None,
    checkpoints: Checkpoints | None,
) -> ConstrainedSolution:
    """Solve one stage of one start, or restore its solution from a checkpoint."""
    number, place = key
    name = f"start_{number}_stage_{place}"
    checkpoint = checkpoints.read(name) if checkpoints else None
    if checkpoint is not None and checkpoint.status is not None:
        return solver.restore(problem, checkpoint.state, checkpoint.status, checkpoint.history)

    def record(iteration: Iteration, state: LagrangianState) -> None:
        log.append(iteration)
        if checkpoints:
            checkpoints.write(name, state, log)
        if callback:
            callback(number, iteration, state)

    start, history = (at, before) if checkpoint is None else (checkpoint.state, checkpoint.history)
    log = list(history)
    solution = solver.solve(problem, start, record, history)
    if checkpoints and solution.status is not Status.interrupted:
        checkpoints.write(name, solution.state, solution.history, solution.status)
    return solution
