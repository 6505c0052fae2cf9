"""Walls that a path must not get over: jumps to the other side of a cylinder, and losing touch with it.

How close a path comes to them is the root of a sum of squares, zero far from all of them and infinite beyond
one: a penalty on it keeps a solver where paths are smooth.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.wrapping import WrappedPath

# Clearance (m) that makes closeness one, where nominal paths have so much. Where they have less than
# the second figure in any frame of a cycle, they are taken to cross in that cycle anyway.
_ROOM, _CROSSED = 1e-3, 1e-4
# Walls stand so far (m) before a jump, or half as far as nominal paths are from it if that is less: other
# walking comes a little nearer.
_KEPT = 1e-3
# Longest stretch on a cylinder (m) that makes closeness one, where nominal paths have so much.
_GRIP = 2e-3
# Keeps the root's slope finite for paths that no wall is near to.
_TINY = 1e-24


class Walls(eqx.Module):
    """What a path must not get over: clearances to keep, and cylinders to stay in touch with (m)."""

    #: The same in all poses of a cycle.
    limit: Float[Array, "*muscle pose wall"]
    #: Clearance beyond the limit at which closeness is one.
    room: Float[Array, "*muscle pose wall"]
    #: Longest stretch on each cylinder, over all poses, at which closeness is one; zero for one that the
    #: nominal path does not touch.
    grip: Float[Array, "*muscle wrap"]

    def closeness(
        self, clearances: Float[Array, "pose wall"], on_surface: Float[Array, "pose wrap"]
    ) -> Float[Array, " pose"]:
        """Root of the sum over walls of ``(room / clearance)**4``; infinite beyond a wall.

        To touch a cylinder in no pose is a wall to all of them.
        """
        longest = jnp.broadcast_to(jnp.max(on_surface, axis=0), on_surface.shape)
        left = jnp.append(clearances - self.limit, longest, axis=-1)
        room = jnp.append(self.room, jnp.broadcast_to(self.grip, on_surface.shape), axis=-1)
        open_to = (left > 0.0) | (room == 0.0)
        inverse = room / jnp.where(left > 0.0, left, 1.0)
        within = jnp.sqrt(jnp.sum(inverse**4, axis=-1))
        return jnp.where(jnp.all(open_to, axis=-1), within, jnp.inf)


def walls_before(nominal: WrappedPath, frames: int) -> Walls:
    """Set up walls where nominal paths leave room; in cycles where they cross one, a little further on."""
    muscles, poses, walls = nominal.clearances.shape
    by_cycle = nominal.clearances.reshape(muscles, poses // frames, frames, walls)
    least = jnp.repeat(jnp.min(by_cycle, axis=2), frames, axis=1)
    free = least > _CROSSED
    limit = jnp.where(free, jnp.minimum(0.5 * least, _KEPT), least - _ROOM)
    longest = jnp.max(nominal.on_surface, axis=1)
    return Walls(
        limit=limit,
        room=jnp.minimum(least - limit, _ROOM),
        grip=jnp.where(longest > _CROSSED, jnp.minimum(longest, _GRIP), 0.0),
    )


def bent_by_walls(
    weights: Float[Array, "muscle trial frame"],
    closeness: Float[Array, "muscle trial frame"],
    slopes: Float[Array, "muscle mode trial frame"],
) -> Float[Array, "muscle mode mode"]:
    """Differentiate closeness twice as if one wall stood in each frame, which its slopes tell all of.

    As ``(room / clearance)**2`` it bends by 1.5 times its squared slope over itself, apart from how the
    clearance bends. Near a wall that is more than slopes alone show a solver of least squares, which would
    step too far and zigzag along it.
    """
    near = closeness > 0.0
    factor = 1.5 * weights * jnp.where(near, 1.0 / jnp.where(near, closeness, 1.0), 0.0)
    return jnp.einsum("mtf,mitf,mjtf->mij", factor, slopes, slopes)


def folded(closeness: Float[Array, "_ frame"], trials: int) -> Float[Array, "trial frame"]:
    """Lay the closeness of cycles beside over that of the first so many: squares add up to the same sum."""
    beside = closeness[trials:]
    if not len(beside):
        return closeness
    layers = jnp.pad(beside, ((0, -len(beside) % trials), (0, 0))).reshape(-1, trials, closeness.shape[1])
    squares = closeness[:trials] ** 2 + jnp.sum(layers**2, axis=0)
    within = jnp.isfinite(squares)
    return jnp.where(within, jnp.sqrt(jnp.where(within, squares, 0.0) + _TINY), jnp.inf)
