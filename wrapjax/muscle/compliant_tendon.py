"""Hill-type muscle in equilibrium with a compliant tendon, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.hill import FiberState, rigid_tendon_fiber

#: Damping coefficient for the part of the fiber velocity that is due to tendon stretch: force in maximum
#: isometric forces at maximum fiber velocity (the value of Millard et al. 2013, doi:10.1115/1.4023390). The
#: damping makes the equilibrium unique on the descending limb of the force-length curve too.
FIBER_DAMPING = 0.1

# Shape factor of the tendon's strain curve: how fast the tendon stiffens with force.
_STIFFENING = 8.0
# Tolerance of the equilibrium force in maximum isometric forces, and the largest number of Newton steps.
_TOLERANCE, _STEPS = 1e-14, 60
# Bracket of the equilibrium force, in maximum isometric forces; the passive force is added to its upper end.
_LOWEST_FORCE, _HIGHEST_FORCE = -4.0, 6.0

Frames = Float[Array, "trial frame"]


def tendon_strain_curve(force: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Compute tendon strain from tendon force, relative to the strain at maximum isometric force.

    ``g(F) = ln(1 + 8 F) / ln 9``: 0 at 0 and 1 at 1, with a toe region; linear below zero.

    Parameters
    ----------
    force
        Tendon force in maximum isometric forces.

    Returns
    -------
    Array
        Strain divided by the strain at maximum isometric force.
    """
    pulled = jnp.log1p(_STIFFENING * jnp.maximum(force, 0.0)) + _STIFFENING * jnp.minimum(force, 0.0)
    return pulled / np.log1p(_STIFFENING)


def compliant_tendon_fiber(
    curves: AbstractCurves,
    activation: Frames,
    length: Frames,
    velocity: Frames,
    step: Float[Array, " trial"],
    strain_at_max_force: Float[Array, ""],
    *,
    max_isometric_force: Float[Array, ""],
    optimal_fiber_length: Float[Array, ""],
    tendon_slack_length: Float[Array, ""],
    pennation_angle: Float[Array, ""],
    max_fiber_velocity: Float[Array, ""],
    length_factor: Frames | None = None,
) -> FiberState:
    """Compute fiber state and force of a muscle with a compliant tendon.

    The tendon length is ``l_s (1 + e0 g(F / F0))`` with g from `tendon_strain_curve`. Fiber length and
    velocity are those of the muscle-tendon unit less those of the tendon stretch, and the force follows as
    with a rigid tendon. Because fiber velocity contains the rate of the stretch, the equations are a
    differential equation in time: every frame is solved for the force at which fibers and tendon are in
    equilibrium, with the rate of the stretch as the second-order backward difference over frames. In the
    first frame that rate is zero.

    Zero strain gives the rigid tendon to the last bit, with the derivatives of that limit. Derivatives of any
    order are exact, by the implicit function theorem.

    Parameters
    ----------
    curves, activation, length, velocity
        See `rigid_tendon_fiber`.
    step
        Time between frames of each cycle, s.
    strain_at_max_force
        Tendon strain e0 at maximum isometric force; about 0.04 (Zajac 1989, Crit Rev Biomed Eng 17:359).
    max_isometric_force, optimal_fiber_length, tendon_slack_length, pennation_angle, max_fiber_velocity
        See `rigid_tendon_fiber`.
    length_factor
        See `rigid_tendon_fiber`.

    Returns
    -------
    FiberState
        Fiber state; the damping force is part of the passive force.
    """
    reach = optimal_fiber_length * jnp.cos(pennation_angle)
    strength = max_isometric_force * jnp.cos(pennation_angle)
    per_strain = strain_at_max_force * tendon_slack_length
    law = {
        "max_isometric_force": max_isometric_force,
        "optimal_fiber_length": optimal_fiber_length,
        "tendon_slack_length": tendon_slack_length,
        "pennation_angle": pennation_angle,
        "max_fiber_velocity": max_fiber_velocity,
    }

    def fibers(muscle, strain, strain_rate) -> FiberState:
        activation, length, velocity, factor = muscle
        stretch, rate = per_strain * strain, per_strain * strain_rate
        state = rigid_tendon_fiber(
            curves, activation, length - stretch, velocity - rate, **law, length_factor=factor
        )
        fastest = max_fiber_velocity * reach if factor is None else max_fiber_velocity * reach * factor
        return replace(state, passive_force=state.passive_force - FIBER_DAMPING * strength * (rate / fastest))

    muscle = activation, length, velocity, length_factor
    unstretched = curves.passive_force((length - tendon_slack_length) / reach)
    frames = jax.tree.map(jnp.transpose, (muscle, _HIGHEST_FORCE + unstretched))
    weights = jnp.asarray(_backward_difference(activation.shape[-1]))

    def advance(past, inputs):
        (muscle, highest), weight = inputs
        before, before_last, guess = past

        def rate_of(strain: Float[Array, " trial"]) -> Float[Array, " trial"]:
            return (weight[0] * strain + weight[1] * before + weight[2] * before_last) / step

        def excess(force: Float[Array, " trial"]) -> Float[Array, " trial"]:
            strain = tendon_strain_curve(force)
            return force - fibers(muscle, strain, rate_of(strain)).tendon_force / max_isometric_force

        force = increasing_root(excess, guess, jnp.full_like(highest, _LOWEST_FORCE), highest)
        strain = tendon_strain_curve(force)
        return (strain, before, jax.lax.stop_gradient(force)), (strain, rate_of(strain))

    zeros = jnp.zeros_like(step)
    _, (strain, strain_rate) = jax.lax.scan(advance, (zeros, zeros, zeros), (frames, weights))
    return fibers(muscle, strain.T, strain_rate.T)


def increasing_root(
    function: Callable[[Float[Array, "*shape"]], Float[Array, "*shape"]],
    guess: Float[Array, "*shape"],
    lowest: Float[Array, "*shape"],
    highest: Float[Array, "*shape"],
) -> Float[Array, "*shape"]:
    """Find the root of an elementwise increasing function; differentiable to any order.

    Newton's method, with bisection wherever a Newton step would leave the bracket.

    Parameters
    ----------
    function
        Increasing function; each element of the result depends on the same element of the argument alone.
        Variables that it closes over are differentiated by the implicit function theorem.
    guess
        Starting point; it does not enter derivatives.
    lowest, highest
        Bracket of the root.

    Returns
    -------
    Array
        Root of each element; the nearer end of the bracket where that contains no root.
    """

    def slope(function, at):
        return jax.jvp(function, (at,), (jnp.ones_like(at),))

    def solve(function, guess):
        def unconverged(state):
            at, _, _, change, count = state
            return (count < _STEPS) & jnp.any(jnp.abs(change) > _TOLERANCE * (1.0 + jnp.abs(at)))

        def improve(state):
            at, lower, upper, _, count = state
            value, rise = slope(function, at)
            lower, upper = jnp.where(value <= 0.0, at, lower), jnp.where(value >= 0.0, at, upper)
            newton = at - value / jnp.where(rise > 0.0, rise, 1.0)
            inside = (rise > 0.0) & (newton >= lower) & (newton <= upper)
            then = jnp.where(inside, newton, 0.5 * (lower + upper))
            return then, lower, upper, then - at, count + 1

        start = jnp.clip(guess, lowest, highest)
        state = start, lowest, highest, jnp.full_like(start, jnp.inf), 0
        return jax.lax.while_loop(unconverged, improve, state)[0]

    lowest, highest, guess = jax.lax.stop_gradient((lowest, highest, guess))
    return jax.lax.custom_root(
        function, guess, solve, lambda linear, value: value / linear(jnp.ones_like(value))
    )


def _backward_difference(frames: int) -> Float[np.ndarray, "frame 3"]:
    """Weights of each frame and the two before it: zero at the first frame, first order at the second."""
    weights = np.tile([1.5, -2.0, 0.5], (frames, 1))
    weights[0] = 0.0
    weights[1:2] = [1.0, -1.0, 0.0]
    return weights
