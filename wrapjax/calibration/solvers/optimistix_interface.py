"""The bounded Levenberg-Marquardt method as a solver of optimistix, for any residual function.

``optimistix.least_squares`` has no bounds. With `BoundedLevenbergMarquardt` as its solver they are options::

    optimistix.least_squares(
        residuals, BoundedLevenbergMarquardt(), y0, options={"lower": 0.0, "upper": jnp.ones(3)}
    )

The method is that of `wrapjax.calibration.solvers.levenberg_marquardt`, whose steps it shares. Derivatives
are those of JAX for a residual function without structure: forward mode for the Jacobian, and the Jacobian of
the gradient for second derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree, Scalar

from wrapjax.calibration.solvers.interface import (
    FIRST_GROWTH,
    AbstractLeastSquares,
    DampingState,
    Linearization,
    SolverState,
)
from wrapjax.calibration.solvers.levenberg_marquardt import (
    evaluate_step,
    half_hessian,
    propose_step,
)

#: Damping above which no step of usable length is left: the derivatives or the residuals are not finite.
_LARGEST_DAMPING = 1e12


class _Residuals(AbstractLeastSquares):
    """Least-squares problem of one vector of residuals."""

    function: Callable[[Float[Array, " variable"]], Float[Array, " row"]]
    bounds: tuple[Float[Array, " variable"], Float[Array, " variable"]]

    @property
    def lower(self) -> Float[Array, " variable"]:
        """Lower bounds."""
        return self.bounds[0]

    @property
    def upper(self) -> Float[Array, " variable"]:
        """Upper bounds."""
        return self.bounds[1]

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Compute the sum of squares."""
        rows = self.function(variables)
        return rows @ rows

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute the sum of squares and its exact first and second derivatives."""
        rows, jacobian = self.function(variables), jax.jacfwd(self.function)(variables)
        half = jax.jacfwd(jax.grad(lambda at: 0.5 * jnp.sum(self.function(at) ** 2)))(variables)
        gauss_newton = jacobian.T @ jacobian
        return Linearization(rows @ rows, jacobian.T @ rows, gauss_newton, half - gauss_newton)


class BoundedState(eqx.Module):
    """State of `BoundedLevenbergMarquardt` after a step."""

    solver: SolverState
    aux: PyTree
    #: Largest change of a variable by a projected gradient step.
    optimality: Float[Array, ""]
    #: Whether a criterion of convergence is met.
    converged: Bool[Array, ""]


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver[PyTree, PyTree, PyTree, BoundedState]):
    """Levenberg-Marquardt solver with bounds for ``optimistix.least_squares``.

    Bounds are given as ``options={"lower": ..., "upper": ...}``: each a number, or a tree of the structure of
    ``y``; without one of them that side is unbounded. ``y0`` is clipped to the bounds. Every point at which
    the residuals are evaluated is within them.

    Parameters
    ----------
    rtol
        Stop when the predicted and the actual relative decrease of the sum of squares are at most this.
    atol
        Stop when ``max |clip(y - g, lower, upper) - y|``, with g half the gradient of the sum of squares, is
        at most this.
    norm
        Norm of the changes of ``y`` by a projected gradient step, by which ``atol`` is measured.
    xtol
        Stop when the length of an accepted step, relative to one plus the norm of ``y``, is at most this.
    initial_damping
        Damping of the first step, relative to the diagonal of J'J.

    Notes
    -----
    Derivatives of the solution by optimistix' ``ImplicitAdjoint`` assume that the gradient vanishes there.
    They are therefore right only where no bound is active.
    """

    rtol: float = 1e-12
    atol: float = 1e-8
    norm: Callable[[PyTree], Scalar] = optx.max_norm
    xtol: float = 1e-10
    initial_damping: float = 1e-4

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> BoundedState:
        """Evaluate the starting point; see ``optimistix.AbstractIterativeSolver``."""
        problem = _problem(fn, y, args, options)
        start = jnp.clip(ravel_pytree(y)[0], problem.lower, problem.upper)
        damping = DampingState(
            jnp.asarray(self.initial_damping, start.dtype), jnp.asarray(FIRST_GROWTH, start.dtype)
        )
        state = SolverState(start, problem.linearize(start), damping)
        aux = fn(ravel_pytree(y)[1](start), args)[1]
        optimality = self._optimality(state, problem)
        return BoundedState(state, aux, optimality, optimality <= self.atol)

    def step(self, fn, y, args, options, state: BoundedState, tags) -> tuple[PyTree, BoundedState, PyTree]:
        """Try one step; ``y`` stays where it is if the step is rejected."""
        unravel = ravel_pytree(y)[1]
        problem, own = _problem(fn, y, args, options), state.solver
        hessian = half_hessian(own.linearization)
        candidate = propose_step(own, hessian, problem.lower, problem.upper)
        candidate = jax.lax.cond(
            jnp.isfinite(candidate).all(),
            lambda: candidate,
            lambda: propose_step(own, _absolute_value(hessian), problem.lower, problem.upper),
        )
        step = evaluate_step(own, candidate, problem.value(candidate))
        after = SolverState(candidate, own.linearization, step.after_acceptance)
        rejected = BoundedState(
            SolverState(own.variables, own.linearization, step.after_rejection),
            state.aux,
            state.optimality,
            _small(step.predicted, step.actual, own, self.rtol) & (own.damping_state.damping <= 1.0),
        )

        def evaluated() -> BoundedState:
            fresh = eqx.tree_at(lambda one: one.linearization, after, problem.linearize(candidate))
            optimality = self._optimality(fresh, problem)
            small = _small(step.predicted, step.actual, own, self.rtol)
            converged = (optimality <= self.atol) | small | (step.length <= self.xtol)
            accepted = BoundedState(fresh, fn(unravel(candidate), args)[1], optimality, converged)
            # Where the costs are equal to rounding, the gradients decide.
            better = step.decreases | (optimality < state.optimality)
            return jax.tree.map(lambda new, old: jnp.where(better, new, old), accepted, rejected)

        new = jax.lax.cond(step.decreases | step.unchanged, evaluated, lambda: rejected)
        return unravel(new.solver.variables), new, new.aux

    def terminate(
        self, fn, y, args, options, state: BoundedState, tags
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Decide whether to stop, and why."""
        finite = jnp.isfinite(state.solver.linearization.cost)
        diverged = ~finite | (state.solver.damping_state.damping > _LARGEST_DAMPING)
        failed = diverged & ~state.converged
        result = optx.RESULTS.where(failed, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return state.converged | diverged, result

    def postprocess(self, fn, y, aux, args, options, state: BoundedState, tags, result):
        """Return the last accepted point, the sum of squares and its optimality."""
        solution = ravel_pytree(y)[1](state.solver.variables)
        stats = {"sum_of_squares": state.solver.linearization.cost, "optimality": state.optimality}
        return solution, state.aux, stats

    def _optimality(self, state: SolverState, problem: _Residuals) -> Float[Array, ""]:
        moved = jnp.clip(state.variables - state.linearization.gradient, problem.lower, problem.upper)
        return self.norm(moved - state.variables)


def _problem(fn: Callable[..., Any], y: PyTree, args: PyTree, options: dict[str, Any]) -> _Residuals:
    """Build the problem of a vector of variables from a function of a tree."""
    flat, unravel = ravel_pytree(y)

    def bound(name: str, default: float) -> Float[Array, " variable"]:
        given = options.get(name, default)
        if isinstance(given, float | int | jax.Array) and jnp.ndim(given) == 0:
            return jnp.full_like(flat, given)
        filled = jax.tree.map(lambda leaf, one: jnp.broadcast_to(jnp.asarray(one), jnp.shape(leaf)), y, given)
        return ravel_pytree(filled)[0].astype(flat.dtype)

    def residuals(variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        return ravel_pytree(fn(unravel(variables), args)[0])[0]

    return _Residuals(residuals, (bound("lower", -jnp.inf), bound("upper", jnp.inf)))


def _absolute_value(hessian: Float[Array, "variable variable"]) -> Float[Array, "variable variable"]:
    """Replace the eigenvalues of a symmetric matrix by their absolute values, in a compiled program."""
    values, vectors = jnp.linalg.eigh(hessian)
    return (vectors * jnp.abs(values)[None, :]) @ vectors.T


def _small(
    predicted: Float[Array, ""], actual: Float[Array, ""], state: SolverState, rtol: float
) -> Bool[Array, ""]:
    """Whether neither the predicted nor the actual decrease exceeds a share of the sum of squares."""
    limit = rtol * state.linearization.cost
    return (predicted > 0.0) & (predicted <= limit) & (actual <= limit)
