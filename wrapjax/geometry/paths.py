"""What the rest of the model needs to know of a muscle's path."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class PathState(eqx.Module):
    """Muscle-tendon length, its rate and moment arms, all muscles at all frames.

    ``moment_arm = -dL/dq`` (OpenSim's sign): positive where the muscle pulls its coordinate up.
    """

    #: m
    length: Float[Array, "*muscle trial frame"]
    #: m/s, lengthening positive
    velocity: Float[Array, "*muscle trial frame"]
    #: m (m/rad)
    moment_arm: Float[Array, "*muscle trial coordinate frame"]


class AdjustablePath(eqx.Module):
    """A path that a calibration may change: the nominal one plus any sum of modes.

    A mode is a change of shape, consistent in length, rate and moment arms. Paths that must stay as
    they are have no modes.
    """

    nominal: PathState
    #: Change by one unit of each mode; leaves lead with ``muscle mode``.
    modes: PathState

    def at(self, changes: Float[Array, " mode"]) -> PathState:
        """Give one muscle's path (the leading axis taken off) with its modes by these amounts."""
        return jax.tree.map(
            lambda nominal, modes: nominal + jnp.tensordot(changes, modes, axes=1), self.nominal, self.modes
        )


def fixed_path(path: PathState) -> AdjustablePath:
    """Wrap paths, of all muscles, that do not change."""
    none = jax.tree.map(lambda leaf: jnp.zeros((leaf.shape[0], 0, *leaf.shape[1:])), path)
    return AdjustablePath(path, none)
