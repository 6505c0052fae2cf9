"""Three-dimensional vectors as three separate arrays, which lets XLA fuse whole formulas into one loop."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


class Vector(eqx.Module):
    """Array of three-dimensional vectors, stored by component."""

    x: Float[Array, "*vectors"]
    y: Float[Array, "*vectors"]
    z: Float[Array, "*vectors"]

    def __add__(self, other: Vector) -> Vector:
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vector) -> Vector:
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, factor: Float[Array, "*vectors"] | float) -> Vector:
        return Vector(self.x * factor, self.y * factor, self.z * factor)

    def dot(self, other: Vector) -> Float[Array, "*vectors"]:
        """Scalar product."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: Vector) -> Vector:
        """Vector product."""
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def norm(self) -> Float[Array, "*vectors"]:
        """Euclidean norm, with a derivative of zero at zero."""
        return safe_sqrt(self.dot(self))

    def unit(self) -> Vector:
        """Scale the vectors to length one; zero vectors stay zero."""
        return self * safe_inverse(self.norm())

    def at(self, place: object) -> Vector:
        """Index all three components."""
        return Vector(self.x[place], self.y[place], self.z[place])


def vector(values: Float[Array, "*vectors 3"] | Float[np.ndarray, "*vectors 3"]) -> Vector:
    """Convert an array whose last axis holds x, y and z."""
    # NumPy arrays are sliced before their conversion to JAX, which is much faster for many small arrays.
    return Vector(*(jnp.asarray(values[..., axis]) for axis in range(3)))


def stack_components(vectors: Vector) -> Float[Array, "*vectors 3"]:
    """Array of the vectors, with their components along a last axis."""
    return jnp.stack([vectors.x, vectors.y, vectors.z], axis=-1)


def where(condition: Bool[Array, "*vectors"], one: Vector, other: Vector) -> Vector:
    """Select from two vectors by a condition, as ``jnp.where``."""
    return Vector(
        jnp.where(condition, one.x, other.x),
        jnp.where(condition, one.y, other.y),
        jnp.where(condition, one.z, other.z),
    )


def safe_sqrt(value: Float[Array, "*values"]) -> Float[Array, "*values"]:
    """Square root of positive values; zero, with a derivative of zero, for others."""
    positive = value > 0.0
    # The inner ``where`` keeps the derivative of the branch that is not selected finite.
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)


def safe_inverse(value: Float[Array, "*values"]) -> Float[Array, "*values"]:
    """Reciprocal of a value; zero for zero."""
    nonzero = value != 0.0
    return jnp.where(nonzero, 1.0 / jnp.where(nonzero, value, 1.0), 0.0)
