"""Derivatives of one muscle's outputs by its own variables.

A muscle has a few parameters that act through time (delay, activation) and, where its path may change,
many modes that do not: of the path, what a muscle does at a frame depends on that frame alone. So the
few are differentiated in forward mode, and the many by the chain rule through length, rate and moment
arms, frame by frame: three directions instead of a hundred.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry import PathState

#: From single parameters and the path to any tree of outputs: numbers, or arrays ``trial frame`` or
#: ``trial coordinate frame``.
Outputs = Callable[[Float[Array, " single"], PathState], Any]


def slopes(
    outputs: Outputs, single: Float[Array, " single"], path: PathState, modes: PathState
) -> tuple[Any, Any]:
    """Compute outputs and their derivatives.

    Parameters
    ----------
    outputs
        What to differentiate.
    single
        Parameters of which each is one number.
    path, modes
        Where to differentiate, and what a unit of each mode adds.

    Returns
    -------
    tuple
        Outputs, and derivatives with one more axis at the front: parameters, then modes.
    """

    def along(direction: Float[Array, " single"]) -> tuple[Any, Any]:
        return jax.jvp(lambda at: outputs(at, path), (single,), (direction,))

    # By hand and not by `jax.jacfwd`, whose last axis counts the directions: with it first, gathering
    # the Jacobian copies whole rows, and that is a third of all the time.
    values, by_single = jax.vmap(along, out_axes=(None, 0))(jnp.eye(single.size))
    if not modes.length.shape[0]:
        return values, by_single
    by_path = [jax.jvp(lambda at: outputs(single, at), (path,), (unit,))[1] for unit in _units(path)]
    by_modes = jax.tree.map(lambda *by: _chain(by, modes), *by_path)
    return values, jax.tree.map(lambda *both: jnp.concatenate(both), by_single, by_modes)


def curvature(
    total: Callable[[Float[Array, " single"], PathState], Float[Array, ""]],
    single: Float[Array, " single"],
    path: PathState,
    modes: PathState,
) -> Float[Array, "local local"]:
    """Compute the Hessian of one number by parameters, then modes.

    Parameters
    ----------
    total
        A sum of outputs; linear in the moment arms.
    single, path, modes
        As for `slopes`.
    """
    by_single = jax.hessian(total)(single, path)
    if not modes.length.shape[0]:
        return by_single

    def path_slope(single: Float[Array, " single"], path: PathState) -> PathState:
        return jax.grad(total, argnums=1)(single, path)

    def along(direction: Float[Array, " single"]) -> PathState:
        return jax.jvp(lambda at: path_slope(at, path), (single,), (direction,))[1]

    mixed = jax.vmap(along)(jnp.eye(single.size))
    products = jax.tree.map(lambda one, mode: jnp.einsum("s...,m...->sm", one, mode), mixed, modes)
    cross = jax.tree.reduce(jnp.add, products)
    length, rate, *_ = _units(path)
    by_length = jax.jvp(lambda at: path_slope(single, at), (path,), (length,))[1]
    by_rate = jax.jvp(lambda at: path_slope(single, at), (path,), (rate,))[1]
    # One half of a symmetric sum; what two moment arms have in common is zero.
    beside_length = (
        0.5 * by_length.length[None] * modes.length
        + by_rate.length[None] * modes.velocity
        + jnp.einsum("tcf,mtcf->mtf", by_length.moment_arm, modes.moment_arm)
    )
    beside_rate = 0.5 * by_rate.velocity[None] * modes.velocity + jnp.einsum(
        "tcf,mtcf->mtf", by_rate.moment_arm, modes.moment_arm
    )
    half = jnp.einsum("mtf,ntf->mn", modes.length, beside_length) + jnp.einsum(
        "mtf,ntf->mn", modes.velocity, beside_rate
    )
    return jnp.block([[by_single, cross], [cross.T, half + half.T]])


def _units(path: PathState) -> list[PathState]:
    """Directions that move length, rate, all moment arms or closeness alone, at all frames at once."""
    leaves, form = jax.tree.flatten(path)
    nothing = [jnp.zeros_like(leaf) for leaf in leaves]
    return [
        jax.tree.unflatten(form, [*nothing[:place], jnp.ones_like(leaf), *nothing[place + 1 :]])
        for place, leaf in enumerate(leaves)
    ]


def _chain(by: tuple[Array, ...], modes: PathState) -> Array:
    """Multiply derivatives of one output by each part of the path with those of that part by modes."""
    by_length, by_rate, by_arm, *by_closeness = by
    if by_length.ndim == 0:
        return jnp.zeros(modes.length.shape[0])
    if by_length.ndim == 3:
        length, rate = modes.length[:, :, None], modes.velocity[:, :, None]
        return by_length[None] * length + by_rate[None] * rate + by_arm[None] * modes.moment_arm
    total = by_length[None] * modes.length + by_rate[None] * modes.velocity
    if modes.closeness is None:
        return total
    return total + by_closeness[0][None] * modes.closeness
