"""What the rest of the model needs to know of a muscle's path."""

from __future__ import annotations

import equinox as eqx
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
