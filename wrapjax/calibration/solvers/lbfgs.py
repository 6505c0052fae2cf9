"""L-BFGS-B of jaxopt with the interface of `AbstractBoundedSolver`, an independent check of solutions.

It uses first derivatives alone and takes hundreds of times as many iterations as Levenberg-Marquardt. jaxopt
is no longer maintained; it is an optional dependency.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.solvers.interface import (
    FIRST_GROWTH,
    AbstractBoundedSolver,
    AbstractLeastSquares,
    DampingState,
    Iteration,
    Solution,
    SolverState,
    Status,
)
from wrapjax.errors import InputError, Problem

# Number of iterations over which the decrease of the cost is compared with ``ftol``: some steps are short.
_PATIENCE = 20


@dataclass(frozen=True)
class BoundedLBFGS(AbstractBoundedSolver):
    """L-BFGS-B solver of jaxopt.

    Parameters
    ----------
    gtol, ftol, max_iterations
        See `AbstractBoundedSolver`. The default tolerances are larger than those of Levenberg-Marquardt, in
        accordance with the accuracy that a first-order method reaches.

    Raises
    ------
    InputError
        If jaxopt is not installed.
    """

    gtol: float = 1e-5
    ftol: float = 1e-9
    max_iterations: int = 20000

    def __post_init__(self):
        if find_spec("jaxopt") is None:
            raise InputError(
                Problem(
                    "jaxopt",
                    "is not installed",
                    hint="pip install 'wrapjax[jaxopt]', or use the usual solver",
                )
            )

    def compile(self, problem: AbstractLeastSquares, start: Float[Array | np.ndarray, " variable"]) -> None:
        """Compile the functions that `solve` calls; see `AbstractBoundedSolver`."""
        inside = jnp.clip(jnp.asarray(start), problem.lower, problem.upper)
        jax.block_until_ready(_advance(problem, inside, _begin(problem, inside)))
        jax.block_until_ready(problem.linearized_at(inside))

    def solve(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
        callback: Callable[[Iteration, SolverState], None] | None = None,
        damping_state: DampingState | None = None,
    ) -> Solution:
        """Minimise the cost from a starting point; see `AbstractBoundedSolver`.

        ``damping_state`` is ignored.
        """
        began = time.perf_counter()
        variables = jnp.clip(jnp.asarray(start), problem.lower, problem.upper)
        damping_state = DampingState(jnp.asarray(0.0), jnp.asarray(FIRST_GROWTH))
        carry = _begin(problem, variables)
        linearization = problem.linearized_at(variables)
        history: list[Iteration] = []

        def record(number: int, step: float) -> None:
            at_bounds = jnp.sum((variables <= problem.lower) | (variables >= problem.upper))
            seconds = time.perf_counter() - began
            history.append(
                Iteration(number, float(carry.value), float(carry.error), 0.0, step, int(at_bounds), seconds)
            )
            if callback:
                callback(history[-1], SolverState(variables, linearization, damping_state))

        status, cost_at_restart = Status.iterations, np.inf
        try:
            record(0, 0.0)
            for number in range(1, self.max_iterations + 1):
                if history[-1].optimality <= self.gtol:
                    status = Status.gradient
                    break
                previous = variables
                variables, carry = _advance(problem, variables, carry)
                move = jnp.linalg.norm(variables - previous) / (1.0 + jnp.linalg.norm(previous))
                record(number, float(move))
                fall = history[max(0, number - _PATIENCE)].cost - history[-1].cost
                if number > _PATIENCE and fall <= self.ftol * history[-1].cost:
                    status = Status.cost
                    break
                if carry.failed_linesearch:
                    # Discard the approximate Hessian, unless that did not help the last time.
                    if cost_at_restart - history[-1].cost <= self.ftol * history[-1].cost:
                        status = Status.cost
                        break
                    cost_at_restart = history[-1].cost
                    carry = _begin(problem, variables)
        except KeyboardInterrupt:
            status = Status.interrupted
        linearization = problem.linearized_at(variables)
        return Solution(
            variables=np.asarray(variables),
            cost=float(linearization.cost),
            status=status,
            linearization=linearization,
            damping_state=damping_state,
            history=tuple(history),
        )


def _solver(problem: AbstractLeastSquares) -> Any:
    with warnings.catch_warnings():
        # jaxopt warns at import that it is no longer maintained.
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt
    return jaxopt.LBFGSB(problem.value, tol=0.0)


def _bounds(problem: AbstractLeastSquares) -> tuple[Array, Array]:
    return jnp.asarray(problem.lower), jnp.asarray(problem.upper)


@eqx.filter_jit
def _begin(problem: AbstractLeastSquares, variables: Float[Array, " variable"]) -> Any:
    return _solver(problem).init_state(variables, bounds=_bounds(problem))


@eqx.filter_jit
def _advance(problem: AbstractLeastSquares, variables: Float[Array, " variable"], carry: Any) -> Any:
    return tuple(_solver(problem).update(variables, carry, bounds=_bounds(problem)))
