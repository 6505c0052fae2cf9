"""Hill-type muscle in series with a rigid tendon."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.muscle.curves import AbstractCurves


class FiberState(eqx.Module):
    """Normalised fiber length and velocity, and active and passive force along the tendon (N)."""

    normalized_length: Float[Array, "*shape"]
    normalized_velocity: Float[Array, "*shape"]
    active_force: Float[Array, "*shape"]
    passive_force: Float[Array, "*shape"]

    @property
    def tendon_force(self) -> Float[Array | np.ndarray, "*shape"]:
        """Tendon force, N: the sum of active and passive force along the tendon."""
        return self.active_force + self.passive_force


def rigid_tendon_fiber(
    curves: AbstractCurves,
    activation: Float[Array, "*shape"],
    length: Float[Array, "*shape"],
    velocity: Float[Array, "*shape"],
    *,
    max_isometric_force: Float[Array, ""],
    optimal_fiber_length: Float[Array, ""],
    tendon_slack_length: Float[Array, ""],
    pennation_angle: Float[Array, ""],
    max_fiber_velocity: Float[Array, ""],
    length_factor: Float[Array, "*shape"] | None = None,
) -> FiberState:
    """Compute fiber state and force of a muscle with a rigid tendon.

    ``F = F0 cos(alpha) (a fl(l) fv(v) + fp(l))`` with ``l = (L - ls) / (lo cos(alpha))``,
    ``v = V / (vmax lo cos(alpha))`` and a constant pennation angle alpha (Meyer et al. 2017,
    doi:10.1371/journal.pone.0179698).

    Parameters
    ----------
    curves
        Normalised force curves.
    activation
        Muscle activation a, 0 to 1.
    length, velocity
        Muscle-tendon length L, m, and its rate V, m/s (lengthening positive).
    max_isometric_force
        Maximum isometric force F0, N.
    optimal_fiber_length
        Optimal fiber length lo, m.
    tendon_slack_length
        Tendon slack length ls, m.
    pennation_angle
        Pennation angle alpha at optimal fiber length, rad.
    max_fiber_velocity
        Maximum shortening velocity vmax, optimal fiber lengths per second.
    length_factor
        Factor on the optimal fiber length in each frame; 1 if not given.

    Returns
    -------
    FiberState
        Fiber lengths and velocities in normalised units, forces in N.
    """
    projection = jnp.cos(pennation_angle)
    reach = optimal_fiber_length * projection
    normalized_length = (length - tendon_slack_length) / reach
    normalized_velocity = velocity / (max_fiber_velocity * reach)
    if length_factor is not None:
        normalized_length = normalized_length / length_factor
        normalized_velocity = normalized_velocity / length_factor
    strength = max_isometric_force * projection
    return FiberState(
        normalized_length=normalized_length,
        normalized_velocity=normalized_velocity,
        active_force=strength
        * activation
        * curves.active_force(normalized_length)
        * curves.force_velocity(normalized_velocity),
        passive_force=strength * curves.passive_force(normalized_length),
    )
