"""Step of the Levenberg-Marquardt method: the minimum of a local model of the cost within bounds.

The model of the change of the cost by a move s is::

    m(s) = 2 g's + s'H s + sum_i w_i (max(0, c_i + a_i's)^2 - e_i (c_i + a_i's)^2)

with half the gradient g and half the damped Hessian H of the cost. The sum is over limits, which most
problems lack: residuals that are zero below a bound, with excess c_i over it and derivatives a_i. The
squares of those that are exceeded at the point (e_i = 1, else 0) are in g and H, and are subtracted. A
quadratic model ignores limits that a step will reach, so that long steps are rejected and short ones end at
the next limit.

Within the bounds m is minimised by a semismooth Newton method (Qi & Sun 1993, doi:10.1007/BF01581275): the
quadratic model with the limits that are exceeded after the present move is minimised within the bounds, and
the minimum of m on the line to that point is the next move. A quadratic model is minimised by a primal-dual
active set method (Hintermueller, Ito & Kunisch 2002, doi:10.1137/S1052623401383558).
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy as jsp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.calibration.solvers.interface import AbstractLinearizedLimits

Vector = Float[Array, " variable"]
Matrix = Float[Array, "variable variable"]
Flags = Bool[Array, " variable"]

# Largest number of quadratic models, and share of the decrease so far that ends the iteration: where the
# model itself is approximate, so may be its minimum.
_MOST_MODELS = 20
_SMALL_SHARE = 1e-2
# Largest number of updates of the sets of variables at their bounds.
_MOST_SETS = 20
# Halvings of the interval in the search on a line.
_HALVINGS = 12


def minimize_model(
    gradient: Vector, hessian: Matrix, limits: AbstractLinearizedLimits | None, down: Vector, up: Vector
) -> Vector:
    """Minimise the model within bounds on the move.

    Parameters
    ----------
    gradient, hessian
        Half the gradient and half the damped Hessian of the cost.
    limits
        Limits about the point; None for a quadratic model.
    down, up
        Lower and upper bounds on the move; zero is within them.

    Returns
    -------
    Array
        Move; not finite where the Hessian is not positive definite. With limits it is approximate: the search
        ends when a quadratic model lowers m by at most 1 % of the decrease so far, or after 20 of them.
    """
    at_bounds = (down >= 0.0) & (gradient > 0.0), (up <= 0.0) & (gradient < 0.0)
    first, at_bounds = _minimize_quadratic(gradient, hessian, down, up, at_bounds)
    if limits is None:
        return first

    nowhere = jnp.zeros_like(gradient)
    start = _Search(
        move=nowhere,
        excess=limits.excess,
        change=jnp.zeros(()),
        exceeded=limits.excess > 0.0,
        hessian=hessian,
        minimum=first,
        at_bounds=at_bounds,
        ended=~jnp.isfinite(first).all(),
        models=jnp.asarray(1),
    )

    def advance(search: _Search) -> _Search:
        along = search.minimum - search.move
        excess_along = limits.change(along)
        share = _minimum_on_line(gradient, hessian, limits, search, along, excess_along)
        move = search.move + share * along
        excess = search.excess + share * excess_along
        change = model_change(gradient, hessian, limits, move, excess)
        exceeded = excess > 0.0
        exact = (share == 1.0) & jnp.all(exceeded == search.exceeded)
        ended = exact | (search.change - change <= -_SMALL_SHARE * change)

        def next_model() -> tuple[Matrix, Vector, tuple[Flags, Flags]]:
            sign = exceeded.astype(excess.dtype) - search.exceeded
            matrix = search.hessian + limits.gram(sign * limits.weight)
            slope = gradient + hessian @ move + limits.gradient(limits.weight * _beyond(limits, excess))
            further, at_bounds = _minimize_quadratic(slope, matrix, down - move, up - move, search.at_bounds)
            return matrix, move + further, at_bounds

        def no_model() -> tuple[Matrix, Vector, tuple[Flags, Flags]]:
            return search.hessian, search.minimum, search.at_bounds

        matrix, minimum, at_bounds = jax.lax.cond(ended, no_model, next_model)
        # Without limits that are no longer exceeded, the matrix may be indefinite: the move so far is kept.
        ended |= ~jnp.isfinite(minimum).all()
        return _Search(move, excess, change, exceeded, matrix, minimum, at_bounds, ended, search.models + 1)

    end = jax.lax.while_loop(lambda now: ~now.ended & (now.models <= _MOST_MODELS), advance, start)
    return jnp.where(jnp.isfinite(first), end.move, first)


def model_change(
    gradient: Vector,
    hessian: Matrix,
    limits: AbstractLinearizedLimits | None,
    move: Vector,
    excess: Float[Array, " row"] | None = None,
) -> Float[Array, ""]:
    """Compute the change of the cost by a move in the model.

    Parameters
    ----------
    gradient, hessian, limits
        See `minimize_model`; without damping it is the prediction of the true change.
    move
        Move.
    excess
        Excess over the limits after the move, if it is known.
    """
    quadratic = 2.0 * gradient @ move + move @ hessian @ move
    if limits is None:
        return quadratic
    if excess is None:
        excess = limits.excess + limits.change(move)
    return quadratic + limits.weight @ (_beyond(limits, excess) * excess)


class _Search(eqx.Module):
    """Move so far in a model with limits, and the quadratic model about it."""

    move: Vector
    #: Excess over the limits after the move, and the change of the cost by the model.
    excess: Float[Array, " row"]
    change: Float[Array, ""]
    #: Limits that are in the quadratic model, its Hessian and its minimum, and which variables are at bounds.
    exceeded: Bool[Array, " row"]
    hessian: Matrix
    minimum: Vector
    at_bounds: tuple[Flags, Flags]
    ended: Bool[Array, ""]
    #: Number of quadratic models.
    models: Int[Array, ""]


def _beyond(limits: AbstractLinearizedLimits, excess: Float[Array, " row"]) -> Float[Array, " row"]:
    """Compute the excess where it is positive, less that of limits that are in the Hessian of the cost."""
    return jnp.maximum(excess, 0.0) - (limits.excess > 0.0) * excess


def _minimum_on_line(
    gradient: Vector,
    hessian: Matrix,
    limits: AbstractLinearizedLimits,
    search: _Search,
    along: Vector,
    excess_along: Float[Array, " row"],
) -> Float[Array, ""]:
    """Find the share of a line at which the model is least, where its slope, which rises, is zero."""
    curved = hessian @ along
    first, second = gradient @ along + curved @ search.move, curved @ along

    def slope(share: Float[Array, ""]) -> Float[Array, ""]:
        beyond = _beyond(limits, search.excess + share * excess_along)
        return first + share * second + (limits.weight * beyond) @ excess_along

    def halve(_: Int[Array, ""], interval: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = interval
        middle = 0.5 * (low + high)
        falls = slope(middle) < 0.0
        return jnp.where(falls, middle, low), jnp.where(falls, high, middle)

    whole = jnp.ones_like(second)
    low, _ = jax.lax.fori_loop(0, _HALVINGS, halve, (jnp.zeros_like(second), whole))
    return jnp.where(slope(whole) <= 0.0, whole, low)


def _minimize_quadratic(
    gradient: Vector, hessian: Matrix, down: Vector, up: Vector, at_bounds: tuple[Flags, Flags]
) -> tuple[Vector, tuple[Flags, Flags]]:
    """Minimise a quadratic model by a primal-dual active set method.

    Variables that would leave the box are fixed at their bounds, and fixed variables whose multipliers have
    the wrong sign are released, until the sets no longer change (at most 20 times). The free variables
    minimise the model given the fixed ones, unlike in a step that is merely clipped to the bounds.

    Parameters
    ----------
    gradient, hessian
        Half the gradient and half the Hessian of the model.
    down, up
        Bounds on the move.
    at_bounds
        Variables to begin with at their lower bounds, and at their upper ones.

    Returns
    -------
    move, at_bounds
        Move and these sets at the minimum.
    """

    def solve(at_lower: Flags, at_upper: Flags) -> Vector:
        held = at_lower | at_upper
        fixed = jnp.where(at_lower, down, jnp.where(at_upper, up, 0.0))
        matrix = jnp.where(held[:, None] | held[None, :], jnp.diag(held.astype(hessian.dtype)), hessian)
        right_side = jnp.where(held, fixed, -(gradient + hessian @ fixed))
        return jsp.linalg.cho_solve(jsp.linalg.cho_factor(matrix), right_side)

    def sets_changed(carry):
        *_, changed, rounds = carry
        return changed & (rounds < _MOST_SETS)

    def update_sets(carry):
        at_lower, at_upper, _, _, rounds = carry
        move = solve(at_lower, at_upper)
        slope = gradient + hessian @ move
        next_lower = jnp.where(at_lower, slope > 0.0, move < down)
        next_upper = jnp.where(at_upper, slope < 0.0, move > up)
        changed = jnp.any((next_lower != at_lower) | (next_upper != at_upper))
        return next_lower, next_upper, move, changed, rounds + 1

    start = (*at_bounds, jnp.zeros_like(gradient), jnp.asarray(True), 0)
    at_lower, at_upper, move, *_ = jax.lax.while_loop(sets_changed, update_sets, start)
    return jnp.clip(move, down, up), (at_lower, at_upper)
