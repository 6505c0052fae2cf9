"""First and second derivatives of the outputs of one muscle by its local variables.

The local variables are a few scalar parameters and, where the path may change, many path modes. The scalar
parameters (delay, activation, ...) affect all frames and are differentiated in forward mode. With a rigid
tendon the outputs in a frame depend on the path in that frame alone. They are then differentiated by length,
velocity and moment arms, frame by frame, which takes three directional derivatives instead of one per mode,
and the chain rule gives those by the modes. The two steps are separate functions: the first is the same for
all muscles, the second depends on how many modes a muscle has. Where frames are coupled, as by a compliant
tendon, the ``coupled_...`` functions differentiate along every mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.paths import PathState

#: Function from scalar parameters and the path to a tree of outputs: numbers, or arrays ``trial frame``,
#: ``trial coordinate frame`` or (for the infeasibility of the path alone) ``wrap``.
Outputs = Callable[[Float[Array, " single"], PathState], Any]


class SecondDerivatives(eqx.Module):
    """Second derivatives of a sum of outputs where frames are independent given the path."""

    #: Hessian by the scalar parameters.
    by_single: Float[Array, "*muscle single single"]
    #: By each scalar parameter and each part of the path; the leading axis is that of the parameters.
    mixed: PathState
    #: By length and each part of the path, and by velocity and each part of the path, in the same frame.
    by_length: PathState
    by_rate: PathState


def scalar_jacobian(outputs: Outputs, single: Float[Array, " single"], path: PathState) -> tuple[Any, Any]:
    """Compute outputs and their derivatives by the scalar parameters, with a leading axis for these."""

    def along(direction: Float[Array, " single"]) -> tuple[Any, Any]:
        return jax.jvp(lambda at: outputs(at, path), (single,), (direction,))

    # Not `jax.jacfwd`, which has the axis of directions last: with this axis first, `Variables.gather` copies
    # contiguous rows, which saves a third of the time.
    values, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(single.size))
    return values, slopes


def path_jacobian(outputs: Outputs, single: Float[Array, " single"], path: PathState) -> dict[str, Any]:
    """Differentiate outputs by each part of the path (length, velocity, ...) in the same frame, by name."""
    return {
        name: jax.jvp(lambda at: outputs(single, at), (path,), (unit,))[1]
        for name, unit in _units(path).items()
    }


def framewise_jacobian(by_path: dict[str, Any], modes: PathState) -> Any:
    """Compute the derivatives of outputs by modes from those by the path, where frames are independent.

    Parameters
    ----------
    by_path
        Result of `path_jacobian`.
    modes
        Change of the path per unit of each mode; the leading axis of the leaves is ``mode``.

    Returns
    -------
    tree of Array
        Derivatives with a leading axis for modes.
    """
    return jax.tree.map(lambda *by: _chain(dict(zip(by_path, by, strict=True)), modes), *by_path.values())


def second_derivatives(
    total: Callable[[Float[Array, " single"], PathState], Float[Array, ""]],
    single: Float[Array, " single"],
    path: PathState,
) -> SecondDerivatives:
    """Differentiate a sum of outputs twice where frames are independent given the path.

    Parameters
    ----------
    total
        Sum of outputs, linear in the moment arms.
    single, path
        Scalar parameters and path at which to differentiate.
    """
    slope = jax.grad(total, argnums=(0, 1))

    def along_single(direction: Float[Array, " single"]) -> tuple[Array, PathState]:
        return jax.jvp(lambda at: slope(at, path), (single,), (direction,))[1]

    def along_path(direction: PathState) -> PathState:
        return jax.jvp(lambda at: slope(single, at)[1], (path,), (direction,))[1]

    by_single, mixed = jax.vmap(along_single)(jnp.eye(single.size))
    units = _units(path)
    return SecondDerivatives(by_single, mixed, along_path(units["length"]), along_path(units["velocity"]))


def framewise_hessian(second: SecondDerivatives, modes: PathState) -> Float[Array, "local local"]:
    """Compute the Hessian of a sum of outputs by scalar parameters followed by modes.

    Parameters
    ----------
    second
        Result of `second_derivatives`.
    modes
        See `framewise_jacobian`.
    """
    products = jax.tree.map(lambda one, mode: jnp.einsum("s...,m...->sm", one, mode), second.mixed, modes)
    cross = jax.tree.reduce(jnp.add, products)
    by_length, by_rate = second.by_length, second.by_rate
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
    return jnp.block([[second.by_single, cross], [cross.T, half + half.T]])


def coupled_jacobian(
    outputs: Outputs, single: Float[Array, " single"], path: PathState, modes: PathState
) -> Any:
    """Differentiate outputs by modes where an output in a frame may depend on the path in all frames.

    Returns
    -------
    tree of Array
        Derivatives with a leading axis for modes.
    """

    def along(mode: PathState) -> Any:
        return jax.jvp(lambda at: outputs(single, at), (path,), (mode,))[1]

    return jax.vmap(along)(modes)


def coupled_hessian(
    total: Callable[[Float[Array, " single"], PathState], Float[Array, ""]],
    single: Float[Array, " single"],
    path: PathState,
    modes: PathState,
) -> Float[Array, "local local"]:
    """Compute the Hessian where an output in a frame may depend on the path in all frames.

    Parameters
    ----------
    total, single, path
        See `second_derivatives`.
    modes
        See `framewise_jacobian`.

    Returns
    -------
    Array
        Hessian by scalar parameters followed by modes.
    """
    count = modes.length.shape[0]

    def total_of_local(local: Float[Array, " local"]) -> Float[Array, ""]:
        changes = local[single.size :]
        moved = jax.tree.map(lambda leaf, mode: leaf + jnp.tensordot(changes, mode, axes=1), path, modes)
        return total(local[: single.size], moved)

    return jax.hessian(total_of_local)(jnp.concatenate([single, jnp.zeros(count)]))


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
