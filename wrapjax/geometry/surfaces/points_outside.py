"""Path points inside an ellipsoid or a torus, which count as on its surface, and directions from there.

From a point inside a surface there is no path outside of it. So that the length is continuous as a point
moves into such a surface, and moment arms are -dL/dq, the path begins at the place of the surface above the
point. Round other surfaces the contact allows for such ends.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.exact_paths.path_on_cylinders import PathOnCylinders, PointsAndBodies, path_segments
from wrapjax.geometry.surfaces.placed_surface import PlacedSurface
from wrapjax.geometry.surfaces.wrap_methods import MOVED_OUTSIDE, Kinds, outside
from wrapjax.geometry.vectors import safe_inverse, safe_sqrt, stack_components, vector

# Shorter segments (m) have no direction.
_SHORTEST = 1e-7


def moved_outside(
    path: PointsAndBodies, placed: PlacedSurface, kinds: Kinds, numbers: Int[Array, " wrap"] | None
) -> PointsAndBodies:
    """Move points inside ellipsoids and tori to their surfaces, with their velocities.

    Points are moved that are in the part of the path that may wrap round the surface.

    Parameters
    ----------
    path
        Path points and bodies in one pose.
    placed
        Surfaces in ground's frame.
    kinds, numbers
        As in `wrapjax.geometry.exact_paths.several_wraps.wrap_shortest`.
    """
    if not MOVED_OUTSIDE & set(kinds):
        return path
    in_range = points_in_range(path)
    moving = jnp.zeros(path.position.shape[:1], bool) if path.moving is None else path.moving
    numbers = jnp.arange(len(kinds)) if numbers is None else numbers

    def of_wrap(state: tuple[Array, Array, Array], wrap: Array) -> tuple[tuple[Array, Array, Array], None]:
        position, velocity, moving = state
        surface = jax.tree.map(lambda leaf: leaf[wrap], placed)
        axes = jnp.stack(
            [stack_components(axis) for axis in (surface.x_axis, surface.y_axis, surface.z_axis)]
        )
        center = stack_components(surface.center)[None]

        def carried(points: Array) -> Array:
            """Velocities that points have with the surface's body."""
            arm = (points - path.origin[wrap][None])[None]
            return path.linear[:, wrap, None] + jnp.cross(path.angular[:, wrap, None], arm)

        local, local_velocity = (position - center) @ axes.T, (velocity - carried(position)) @ axes.T

        def projected(kind: str, points: Array) -> Array:
            return stack_components(outside(vector(points), surface, kind))

        def move(points: Array) -> Array:
            branches = [lambda one, kind=kind: projected(kind, one) for kind in kinds]
            return jax.lax.switch(numbers[wrap], branches, points)

        found = move(local)
        rate = jax.vmap(lambda along: jax.jvp(move, (local,), (along,))[1])(local_velocity)
        inside = in_range[wrap] & jnp.any(found != local, axis=1)
        ground = found @ axes + center
        position = jnp.where(inside[:, None], ground, position)
        velocity = jnp.where(inside[None, :, None], carried(ground) + rate @ axes, velocity)
        return (position, velocity, moving | inside), None

    state = (path.position, path.velocity, moving)
    (position, velocity, moving), _ = jax.lax.scan(of_wrap, state, jnp.arange(placed.radius.shape[0]))
    return replace(path, position=position, velocity=velocity, moving=moving)


def points_in_range(path: PointsAndBodies) -> Bool[Array, "wrap point"]:
    """Whether each point is in the part of the path that may wrap round each surface, if it has segments."""
    place = jnp.arange(path.position.shape[0])[None]
    first, last = path.first_point[:, None], path.last_point[:, None]
    return (place >= first) & (place <= last) & (last > first)


def segment_directions(
    route: PathOnCylinders, points: int, directions: Float[Array, "wrap 2 3"] | None
) -> Float[Array, "segment 3"]:
    """Compute unit vectors along the path's segments.

    Parameters
    ----------
    route
        The path.
    points
        Number of path points.
    directions
        Unit vectors along the path where it comes to each surface and leaves it, for segments without length;
        None: such segments have no direction.
    """
    before, after, _, _ = path_segments(route, points)
    way = route.straight_ends[after] - route.straight_ends[before]
    length = safe_sqrt(jnp.sum(way**2, axis=-1))
    along = way * safe_inverse(length)[:, None]
    if directions is None:
        return along

    def contact(knot: Int[Array, " segment"], leaving: int) -> tuple[Bool[Array, " segment"], Array]:
        wrap = jnp.maximum(knot - points, 0) // 2
        return (knot >= points) & ((knot - points) % 2 == leaving), directions[wrap, leaving]

    arrives, first_way = contact(after, 0)
    leaves, last_way = contact(before, 1)
    instead = jnp.where(arrives[:, None], first_way, jnp.where(leaves[:, None], last_way, along))
    return jnp.where((length > _SHORTEST)[:, None], along, instead)
