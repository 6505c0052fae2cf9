"""Signals over gait cycles, which go on as they began."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def with_padding(values: Float[Array, "*any frame"], padding: int) -> Float[Array, "*any padded_frame"]:
    """Go on round the cycle before its start and after its end: its last frame is its first one."""
    frames = values.shape[-1]
    return values[..., np.arange(-padding, frames + padding) % (frames - 1)]


def delayed(
    values: Float[Array, "trial frame"], delay: float, step: Float[Array | np.ndarray, " trial"]
) -> Float[Array, "trial frame"]:
    """Look values up a delay (s) earlier, round the cycle, straight between frames."""
    frames = values.shape[-1]
    position = jnp.arange(float(frames))[None] - (delay / jnp.asarray(step))[:, None]
    before = jnp.floor(position)
    share = position - before
    first = jnp.mod(before, frames - 1).astype(int)
    second = jnp.mod(before + 1.0, frames - 1).astype(int)
    taken = jnp.take_along_axis(values, first, axis=-1), jnp.take_along_axis(values, second, axis=-1)
    return (1.0 - share) * taken[0] + share * taken[1]


def bumps(phase: Float[np.ndarray, " frame"], count: int) -> Float[np.ndarray, "frame bump"]:
    """Uniform cubic B-splines round the cycle; they add up to one.

    Parameters
    ----------
    phase
        0 to 1.
    count
        How many, at least 4; bump k is highest at ``k / count``.
    """
    away = np.mod(phase[:, None] * count - np.arange(count)[None] + 0.5 * count, count) - 0.5 * count
    distance = np.abs(away)
    near = 2.0 / 3.0 - distance**2 + 0.5 * distance**3
    far = np.maximum(2.0 - distance, 0.0) ** 3 / 6.0
    return np.where(distance < 1.0, near, far)


def bell(
    phase: Float[np.ndarray, " frame"], center: float, width: float
) -> tuple[Float[np.ndarray, " frame"], Float[np.ndarray, " frame"]]:
    """Give a smooth bump round the cycle, one at its centre, and its derivative by phase.

    Parameters
    ----------
    phase
        0 to 1.
    center, width
        In cycles; half of the height is left at about ``width`` from the centre.
    """
    sharpness = np.log(2.0) / (1.0 - np.cos(2.0 * np.pi * width))
    angle = 2.0 * np.pi * (phase - center)
    value = np.exp(sharpness * (np.cos(angle) - 1.0))
    return value, -2.0 * np.pi * sharpness * np.sin(angle) * value


def round_the_cycle(advance: Callable[[Any, Any], tuple[Any, Any]], start: Any, frames: Any) -> Any:
    """Run a state through the cycle twice and give what it puts out in the second round.

    Parameters
    ----------
    advance
        As of `jax.lax.scan`.
    start
        State at the start of the first round.
    frames
        What each frame puts in; leaves end with the axis ``frame``.
    """
    once = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), frames)
    # Its last frame is the first of the next round.
    between, _ = jax.lax.scan(advance, start, jax.tree.map(lambda leaf: leaf[:-1], once))
    _, out = jax.lax.scan(advance, between, once)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), out)
