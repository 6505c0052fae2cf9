"""Periodic functions of the gait cycle; the last frame of a cycle is the first frame of the next."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.diagnosis.inputs.context import Context


def with_padding(
    values: Float[Array, "muscle trial frame"], context: Context
) -> Float[Array, "muscle trial padded_frame"]:
    """Extend a signal by the frames of EMG before and after each cycle: periodically in gait, else held."""
    frames = values.shape[-1]
    # One knot of the envelopes more than intervals between them.
    padded = context.envelopes.shape[-1] + 1
    places = np.arange(-context.padding, padded - context.padding)
    periodic, held = values[..., places % (frames - 1)], values[..., np.clip(places, 0, frames - 1)]
    return jnp.where(context.is_gait[:, None], periodic, held)


def delayed(
    values: Float[Array, "trial frame"], delay: float, step: Float[Array | np.ndarray, " trial"]
) -> Float[Array, "trial frame"]:
    """Delay a periodic signal, by linear interpolation between frames.

    Parameters
    ----------
    values
        Signal over each cycle.
    delay
        Delay, s.
    step
        Time between frames of each cycle, s.
    """
    frames = values.shape[-1]
    position = jnp.arange(float(frames))[None] - (delay / jnp.asarray(step))[:, None]
    before = jnp.floor(position)
    share = position - before
    first = jnp.mod(before, frames - 1).astype(int)
    second = jnp.mod(before + 1.0, frames - 1).astype(int)
    taken = jnp.take_along_axis(values, first, axis=-1), jnp.take_along_axis(values, second, axis=-1)
    return (1.0 - share) * taken[0] + share * taken[1]


def periodic_splines(phase: Float[np.ndarray, " frame"], count: int) -> Float[np.ndarray, "frame spline"]:
    """Evaluate uniform periodic cubic B-splines, which add up to one.

    Parameters
    ----------
    phase
        Phase of the gait cycle, 0 to 1.
    count
        Number of splines, at least 4; spline k is largest at ``k / count``.
    """
    away = np.mod(phase[:, None] * count - np.arange(count)[None] + 0.5 * count, count) - 0.5 * count
    distance = np.abs(away)
    near = 2.0 / 3.0 - distance**2 + 0.5 * distance**3
    far = np.maximum(2.0 - distance, 0.0) ** 3 / 6.0
    return np.where(distance < 1.0, near, far)


def periodic_bell(
    phase: Float[np.ndarray, " frame"], center: float, width: float
) -> tuple[Float[np.ndarray, " frame"], Float[np.ndarray, " frame"]]:
    """Evaluate a smooth periodic bell curve (von Mises), one at its center, and its derivative by phase.

    Parameters
    ----------
    phase
        Phase of the gait cycle, 0 to 1.
    center, width
        In gait cycles; the curve is at half of its height at about ``width`` from the center.
    """
    sharpness = np.log(2.0) / (1.0 - np.cos(2.0 * np.pi * width))
    angle = 2.0 * np.pi * (phase - center)
    value = np.exp(sharpness * (np.cos(angle) - 1.0))
    return value, -2.0 * np.pi * sharpness * np.sin(angle) * value


def periodic_scan(advance: Callable[[Any, Any], tuple[Any, Any]], start: Any, frames: Any) -> Any:
    """Run a recurrence over the gait cycle twice and give the outputs of the second pass.

    The first pass brings the state to about that of periodic motion.

    Parameters
    ----------
    advance
        Step of the recurrence, as in `jax.lax.scan`.
    start
        State at the start of the first pass.
    frames
        Inputs of each frame; leaves end with the axis ``frame``.
    """
    inputs = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), frames)
    # The last frame is the first frame of the second pass.
    between, _ = jax.lax.scan(advance, start, jax.tree.map(lambda leaf: leaf[:-1], inputs))
    _, out = jax.lax.scan(advance, between, inputs)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), out)
