"""Nearest point of an ellipsoid, or of its section by a plane of symmetry, by OpenSim's iteration.

OpenSim solves a polynomial equation for one number by at most 64 steps of Newton's method, and accepts a
value of the polynomial of 1e-9. Near the ellipsoid's center this determines the point only roughly. The same
iteration is therefore made here, from the same start. Lengths are scaled so that the mean semi-axis is one.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from wrapjax.geometry.vectors import safe_inverse, safe_sqrt

_ACCEPTED, _MOST_STEPS = 1e-9, 64
# Coordinates that OpenSim considers as zero.
_ROUND_OFF = 2e-13


def nearest_on_ellipsoid(point: Float[Array, " 3"], axes: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Compute the point of an ellipsoid that is nearest to a point.

    Parameters
    ----------
    point
        The point, in the ellipsoid's frame.
    axes
        Semi-axes.
    """
    squares = axes**2

    def polynomial(root: Float[Array, ""], point: Float[Array, " 3"]) -> tuple[Array, Array]:
        p, q, r = root + squares
        u, v, w = squares * point**2
        value = (p * q * r) ** 2 - u * (q * r) ** 2 - v * (p * r) ** 2 - w * (p * q) ** 2
        products = q * r + p * r + p * q
        slope = p * q * r * products - u * q * r * (q + r) - v * p * r * (p + r) - w * p * q * (p + q)
        return value, 2.0 * slope

    inside = jnp.sum((point / axes) ** 2) < 1.0
    beyond = jnp.max(axes) * safe_sqrt(jnp.sum(point**2))
    general = squares * point / (_root(polynomial, point, jnp.where(inside, 0.0, beyond)) + squares)
    # On planes of symmetry OpenSim uses the section by the plane, the smallest one if there are several.
    zero = jnp.abs(point) <= _ROUND_OFF
    section = jnp.argmin(jnp.where(zero, jnp.sum(axes) - axes, jnp.inf))
    return jnp.where(jnp.any(zero), nearest_in_section(point, axes, section), general)


def nearest_in_section(
    point: Float[Array, " 3"], axes: Float[Array, " 3"], normal: Int[Array, ""]
) -> Float[Array, " 3"]:
    """Compute the nearest point of an ellipsoid's section by a plane of symmetry to a point of the plane.

    Parameters
    ----------
    point
        The point, in the ellipsoid's frame; its coordinate ``normal`` is kept.
    axes
        Semi-axes.
    normal
        Number of the coordinate that is zero on the plane.
    """
    one, other = (normal + 1) % 3, (normal + 2) % 3
    nearest = _nearest_on_ellipse(point[one], point[other], axes[one], axes[other])
    return point.at[one].set(nearest[0]).at[other].set(nearest[1])


def _nearest_on_ellipse(
    x: Float[Array, ""], y: Float[Array, ""], a: Float[Array, ""], b: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    squares = jnp.stack([a, b]) ** 2

    def polynomial(root: Float[Array, ""], point: Float[Array, " 2"]) -> tuple[Array, Array]:
        p, q = root + squares
        u, v = squares * point**2
        value = (p * q) ** 2 - u * q**2 - v * p**2
        return value, 2.0 * (p * q * (p + q) - u * q - v * p)

    point = jnp.stack([x, y])
    inside = jnp.sum(point**2 / squares) < 1.0
    beyond = jnp.maximum(a, b) * safe_sqrt(jnp.sum(point**2))
    general = squares * point / (_root(polynomial, point, jnp.where(inside, 0.0, beyond)) + squares)
    near_x, near_y = jnp.abs(x) <= _ROUND_OFF, jnp.abs(y) <= _ROUND_OFF

    def on_axis(along: Array, own: Array, across: Array) -> tuple[Array, Array]:
        """Nearest point to a point on the semi-axis ``own``: along it, and across it."""
        at_vertex = (across >= own) | (jnp.abs(along) >= own - across**2 / own)
        inner = own**2 * along * safe_inverse(own**2 - across**2)
        aside = across * safe_sqrt(jnp.abs(1.0 - (inner / own) ** 2))
        sign = jnp.where(along >= 0.0, 1.0, -1.0)
        return jnp.where(at_vertex, sign * own, inner), jnp.where(at_vertex, 0.0, aside)

    y_on_y, x_on_y = on_axis(y, b, a)
    x_on_x, y_on_x = on_axis(x, a, b)
    center_x = jnp.where(a < b, jnp.where(x < 0.0, -a, a), x)
    center_y = jnp.where(a < b, y, jnp.where(y < 0.0, -b, b))
    found_x = jnp.where(
        near_x & near_y, center_x, jnp.where(near_x, x_on_y, jnp.where(near_y, x_on_x, general[0]))
    )
    found_y = jnp.where(
        near_x & near_y, center_y, jnp.where(near_x, y_on_y, jnp.where(near_y, y_on_x, general[1]))
    )
    return found_x, found_y


def _root(
    polynomial: Callable[[Array, Array], tuple[Array, Array]], point: Array, start: Float[Array, ""]
) -> Float[Array, ""]:
    """Root that OpenSim finds, with the derivative of a root."""
    fixed = jax.lax.stop_gradient(point)

    def unfinished(state: tuple[Array, Array, Array]) -> Array:
        _, value, count = state
        return (jnp.abs(value) >= _ACCEPTED) & (count < _MOST_STEPS)

    def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        root, value, count = state
        _, slope = polynomial(root, fixed)
        moved = root - value * safe_inverse(slope)
        return moved, polynomial(moved, fixed)[0], count + 1

    start = jax.lax.stop_gradient(start)
    root, _, _ = jax.lax.while_loop(unfinished, step, (start, polynomial(start, fixed)[0], jnp.asarray(0)))
    root = jax.lax.stop_gradient(root)
    value, slope = polynomial(root, point)
    # The value's change, not the value: the root stays as it was found.
    return root - (value - jax.lax.stop_gradient(value)) * jax.lax.stop_gradient(safe_inverse(slope))
