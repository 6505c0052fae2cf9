"""Derivatives of one muscle's outputs by its own variables.

A muscle has a few parameters that act through time (delay, activation) and, where its path may change,
many modes that do not: with a rigid tendon, what a muscle does at a frame depends on the path at that
frame alone. So the few are differentiated in forward mode, and the many by the chain rule through length,
rate and moment arms, frame by frame: three directions instead of a hundred. What remembers, as a tendon
that stretches does, is differentiated along every mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.paths import PathState

#: From single parameters and the path to any tree of outputs: numbers, or arrays ``trial frame``,
#: ``trial coordinate frame`` or, of the path's infeasibility alone, ``wrap``.
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

    values, by_single = _along_each(outputs, single, path)
    if not modes.length.shape[0]:
        return values, by_single
    units = _units(path)
    by_path = [jax.jvp(lambda at: outputs(single, at), (path,), (unit,))[1] for unit in units.values()]
    by_modes = jax.tree.map(lambda *by: _chain(dict(zip(units, by, strict=True)), modes), *by_path)
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
    units = _units(path)
    by_length = jax.jvp(lambda at: path_slope(single, at), (path,), (units["length"],))[1]
    by_rate = jax.jvp(lambda at: path_slope(single, at), (path,), (units["velocity"],))[1]
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


def slopes_through_time(
    outputs: Outputs, single: Float[Array, " single"], path: PathState, modes: PathState
) -> tuple[Any, Any]:
    """Compute what `slopes` does of outputs that depend, at a frame, on the path at any other one too."""
    values, by_single = _along_each(outputs, single, path)
    if not modes.length.shape[0]:
        return values, by_single

    def along(mode: PathState) -> Any:
        return jax.jvp(lambda at: outputs(single, at), (path,), (mode,))[1]

    by_modes = jax.vmap(along)(modes)
    return values, jax.tree.map(lambda *both: jnp.concatenate(both), by_single, by_modes)


def curvature_through_time(
    total: Callable[[Float[Array, " single"], PathState], Float[Array, ""]],
    single: Float[Array, " single"],
    path: PathState,
    modes: PathState,
) -> Float[Array, "local local"]:
    """Compute what `curvature` does of outputs that depend, at a frame, on the path at any other one too."""
    count = modes.length.shape[0]
    if not count:
        return jax.hessian(total)(single, path)

    def of_all(local: Float[Array, " local"]) -> Float[Array, ""]:
        changes = local[single.size :]
        moved = jax.tree.map(lambda leaf, mode: leaf + jnp.tensordot(changes, mode, axes=1), path, modes)
        return total(local[: single.size], moved)

    return jax.hessian(of_all)(jnp.concatenate([single, jnp.zeros(count)]))


def _along_each(outputs: Outputs, single: Float[Array, " single"], path: PathState) -> tuple[Any, Any]:
    def along(direction: Float[Array, " single"]) -> tuple[Any, Any]:
        return jax.jvp(lambda at: outputs(at, path), (single,), (direction,))

    # By hand and not by `jax.jacfwd`, whose last axis counts the directions: with it first, gathering
    # the Jacobian copies whole rows, and that is a third of all the time.
    values, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(single.size))
    return values, slopes


def _units(path: PathState) -> dict[str, PathState]:
    """Directions that move one part of the path alone, by its name, at all frames at once."""
    nothing = jax.tree.map(jnp.zeros_like, path)
    parts = {name: part for name, part in vars(path).items() if part is not None}
    return {name: replace(nothing, **{name: jnp.ones_like(part)}) for name, part in parts.items()}


def _chain(by: dict[str, Array], modes: PathState) -> Array:
    """Multiply derivatives of one output by each part of the path with those of that part by modes."""
    dimensions = by["length"].ndim
    if dimensions == 0:
        return jnp.zeros(modes.length.shape[0])
    if dimensions == 1:
        assert modes.infeasibility is not None, "nothing else is an array of one dimension"
        return by["infeasibility"][None] * modes.infeasibility
    if dimensions == 3:
        length, rate = modes.length[:, :, None], modes.velocity[:, :, None]
        by_frame = by["length"][None] * length + by["velocity"][None] * rate
        return by_frame + by["moment_arm"][None] * modes.moment_arm
    total = by["length"][None] * modes.length + by["velocity"][None] * modes.velocity
    if modes.proximity is None:
        return total
    return total + by["proximity"][None] * modes.proximity
