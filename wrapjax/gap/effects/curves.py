"""Force curves bent a little: each wraps other curves, and amount zero gives those, bit for bit."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.muscle import AbstractCurves


class _Bent(AbstractCurves):
    """Curves made of others."""

    plain: AbstractCurves

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """See `AbstractCurves`."""
        return self.plain.active_force(length)

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """See `AbstractCurves`."""
        return self.plain.force_velocity(velocity)

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """See `AbstractCurves`."""
        return self.plain.passive_force(length)


class Widths(_Bent):
    """Active force over a wider range of lengths, passive force over a longer strain."""

    #: Logarithms of both factors.
    active: Float[Array, ""]
    passive_strain: Float[Array, ""]

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Active force, its width about optimal length multiplied."""
        return self.plain.active_force(length + (length - 1.0) * jnp.expm1(-self.active))

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Passive force, its strain beyond optimal length multiplied."""
        return self.plain.passive_force(length + (length - 1.0) * jnp.expm1(-self.passive_strain))


class Curvature(_Bent):
    """Force that falls otherwise with shortening, and rises otherwise with lengthening."""

    #: Logarithms of both factors.
    shortening: Float[Array, ""]
    plateau: Float[Array, ""]

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Force factor; at rest and at the fastest shortening it stays what it is.

        While shortening, velocity is stretched as Hill's hyperbola is by another curvature; while
        lengthening, what exceeds the force at rest is multiplied.
        """
        slow = jnp.clip(1.0 + velocity, 0.0, 1.0)
        inside = (velocity > -1.0) & (velocity < 0.0)
        slower = velocity / (1.0 + jnp.expm1(-self.shortening) * slow)
        force = self.plain.force_velocity(jnp.where(inside, slower, velocity))
        at_rest = self.plain.force_velocity(jnp.zeros_like(velocity))
        more = jnp.where(velocity > 0.0, force - at_rest, 0.0)
        return force + more * jnp.expm1(self.plateau)


class PassiveShift(_Bent):
    """Passive force that begins at a shorter length."""

    #: In optimal fiber lengths.
    shift: Float[Array, ""]

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Passive force at the shorter length."""
        return self.plain.passive_force(length + self.shift)
