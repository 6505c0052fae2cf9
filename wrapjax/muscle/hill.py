"""A Hill-type muscle in series with a rigid tendon."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.muscle.curves import AbstractCurves


class FiberState(eqx.Module):
    """What a muscle's fibers do, in normalised units; forces along the tendon in N."""

    normalized_length: Float[Array, "*shape"]
    normalized_velocity: Float[Array, "*shape"]
    active_force: Float[Array, "*shape"]
    passive_force: Float[Array, "*shape"]

    @property
    def tendon_force(self) -> Float[Array | np.ndarray, "*shape"]:
        """Force that the tendon passes on to the bones, in N."""
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
    """Compute fiber state and force of a muscle whose tendon does not stretch.

    ``F = F0 cos(alpha) (a fl(l) fv(v) + fp(l))`` with the pennation angle constant (the equations of
    Meyer et al. 2017, doi:10.1371/journal.pone.0179698).

    Parameters
    ----------
    curves
        Normalised force curves.
    activation
        Muscle activation, 0 to 1.
    length, velocity
        Muscle-tendon length in m and its rate in m/s, lengthening positive.
    max_isometric_force
        F0 in N.
    optimal_fiber_length, tendon_slack_length
        In m.
    pennation_angle
        In rad, at optimal fiber length.
    max_fiber_velocity
        In optimal fiber lengths a second.
    length_factor
        What multiplies the optimal fiber length, frame by frame; nothing if not given.
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
