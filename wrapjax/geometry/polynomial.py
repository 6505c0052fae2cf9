"""Monomials of several variables, all muscles in one padded kernel."""

from __future__ import annotations

import itertools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def monomial_exponents(variables: int, degree: int) -> Int[np.ndarray, "term variable"]:
    """List every monomial of total degree up to ``degree``, the constant first.

    Four variables and degree five give 126 terms, three give 56, two 21, one 6.
    """
    rows = [row for row in itertools.product(range(degree + 1), repeat=variables) if sum(row) <= degree]
    rows.sort(key=lambda row: (sum(row), tuple(-power for power in row)))
    return np.array(rows, dtype=np.int64).reshape(len(rows), variables)


def monomials(
    exponents: Int[Array, "term variable"], points: Float[Array, "pose variable"]
) -> Float[Array, "pose term"]:
    """Evaluate every monomial at every point."""
    return jnp.prod(_powers(exponents, points), axis=-1)


def monomial_gradients(
    exponents: Int[Array, "term variable"], points: Float[Array, "pose variable"]
) -> Float[Array, "variable pose term"]:
    """Differentiate every monomial by every variable at every point."""
    variables = exponents.shape[-1]
    powers = _powers(exponents, points)
    lowered = _powers(jnp.maximum(exponents - 1, 0), points) * exponents.astype(points.dtype)[None]
    own = jnp.eye(variables, dtype=bool)[:, None, None, :]
    return jnp.prod(jnp.where(own, lowered[None], powers[None]), axis=-1)


def _powers(
    exponents: Int[Array, "term variable"], points: Float[Array, "pose variable"]
) -> Float[Array, "pose term variable"]:
    # Integer powers by repeated multiplication: exact derivatives at zero, where x**0 has none.
    highest = 5
    columns = [jnp.ones_like(points)]
    for _ in range(highest):
        columns.append(columns[-1] * points)
    table = jnp.stack(columns, axis=-1)  # (pose, variable, power)
    variable = jnp.arange(exponents.shape[-1])[None, :]
    return table[:, jnp.broadcast_to(variable, exponents.shape), exponents]
