"""First and second derivatives of the outputs of one muscle by its local variables.

The local variables are a few scalar parameters and, where the path may change, many path modes. The scalar
parameters (delay, activation, ...) affect all frames and are differentiated in forward mode. With a rigid
tendon the outputs in a frame depend on the path in that frame alone. The ``framewise_...`` functions then
differentiate by the modes with the chain rule through length, velocity and moment arms, frame by frame, which
takes three directional derivatives instead of one per mode. Where frames are coupled, as by a compliant
tendon, the ``coupled_...`` functions differentiate along every mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.paths import PathState

#: Function from scalar parameters and the path to a tree of outputs: numbers, or arrays ``trial frame``,
#: ``trial coordinate frame`` or (for the infeasibility of the path alone) ``wrap``.
Outputs = Callable[[Float[Array, " single"], PathState], Any]


def framewise_jacobian(
    outputs: Outputs, single: Float[Array, " single"], path: PathState, modes: PathState
) -> tuple[Any, Any]:
    """Compute outputs and their Jacobian where frames are independent given the path.

    Parameters
    ----------
    outputs
        Function to differentiate.
    single
        Scalar parameters at which to differentiate.
    path
        Path at which to differentiate.
    modes
        Change of the path per unit of each mode; the leading axis of the leaves is ``mode``.

    Returns
    -------
    values, jacobian
        Outputs, and their derivatives with a leading axis for scalar parameters followed by modes.
    """
    values, by_single = _scalar_jacobian(outputs, single, path)
    if not modes.length.shape[0]:
        return values, by_single
    units = _units(path)
    by_path = [jax.jvp(lambda at: outputs(single, at), (path,), (unit,))[1] for unit in units.values()]
    by_modes = jax.tree.map(lambda *by: _chain(dict(zip(units, by, strict=True)), modes), *by_path)
    return values, jax.tree.map(lambda *both: jnp.concatenate(both), by_single, by_modes)


def framewise_hessian(
    total: Callable[[Float[Array, " single"], PathState], Float[Array, ""]],
    single: Float[Array, " single"],
    path: PathState,
    modes: PathState,
) -> Float[Array, "local local"]:
    """Compute the Hessian of a sum of outputs where frames are independent given the path.

    Parameters
    ----------
    total
        Sum of outputs, linear in the moment arms.
    single, path, modes
        See `framewise_jacobian`.

    Returns
    -------
    Array
        Hessian by scalar parameters followed by modes.
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
    # Half of a symmetric sum; second derivatives by two moment arms are zero.
    with_length = (
        0.5 * by_length.length[None] * modes.length
        + by_rate.length[None] * modes.velocity
        + jnp.einsum("tcf,mtcf->mtf", by_length.moment_arm, modes.moment_arm)
    )
    with_rate = 0.5 * by_rate.velocity[None] * modes.velocity + jnp.einsum(
        "tcf,mtcf->mtf", by_rate.moment_arm, modes.moment_arm
    )
    half = jnp.einsum("mtf,ntf->mn", modes.length, with_length) + jnp.einsum(
        "mtf,ntf->mn", modes.velocity, with_rate
    )
    return jnp.block([[by_single, cross], [cross.T, half + half.T]])


def coupled_jacobian(
    outputs: Outputs, single: Float[Array, " single"], path: PathState, modes: PathState
) -> tuple[Any, Any]:
    """Compute outputs and their Jacobian where an output in a frame may depend on the path in all frames.

    Parameters and returns are those of `framewise_jacobian`.
    """
    values, by_single = _scalar_jacobian(outputs, single, path)
    if not modes.length.shape[0]:
        return values, by_single

    def along(mode: PathState) -> Any:
        return jax.jvp(lambda at: outputs(single, at), (path,), (mode,))[1]

    by_modes = jax.vmap(along)(modes)
    return values, jax.tree.map(lambda *both: jnp.concatenate(both), by_single, by_modes)


def coupled_hessian(
    total: Callable[[Float[Array, " single"], PathState], Float[Array, ""]],
    single: Float[Array, " single"],
    path: PathState,
    modes: PathState,
) -> Float[Array, "local local"]:
    """Compute the Hessian where an output in a frame may depend on the path in all frames.

    Parameters and returns are those of `framewise_hessian`.
    """
    count = modes.length.shape[0]
    if not count:
        return jax.hessian(total)(single, path)

    def total_of_local(local: Float[Array, " local"]) -> Float[Array, ""]:
        changes = local[single.size :]
        moved = jax.tree.map(lambda leaf, mode: leaf + jnp.tensordot(changes, mode, axes=1), path, modes)
        return total(local[: single.size], moved)

    return jax.hessian(total_of_local)(jnp.concatenate([single, jnp.zeros(count)]))


def _scalar_jacobian(outputs: Outputs, single: Float[Array, " single"], path: PathState) -> tuple[Any, Any]:
    """Compute outputs and their derivatives by the scalar parameters, with a leading axis for these."""

    def along(direction: Float[Array, " single"]) -> tuple[Any, Any]:
        return jax.jvp(lambda at: outputs(at, path), (single,), (direction,))

    # Not `jax.jacfwd`, which has the axis of directions last: with this axis first, `Variables.gather` copies
    # contiguous rows, which saves a third of the time.
    values, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(single.size))
    return values, slopes


def _units(path: PathState) -> dict[str, PathState]:
    """Build unit changes of each part of the path (length, velocity, ...) in all frames, by name."""
    zero = jax.tree.map(jnp.zeros_like, path)
    parts = {name: part for name, part in vars(path).items() if part is not None}
    return {name: replace(zero, **{name: jnp.ones_like(part)}) for name, part in parts.items()}


def _chain(by: dict[str, Array], modes: PathState) -> Array:
    """Apply the chain rule to the derivatives of one output by the parts of the path."""
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
