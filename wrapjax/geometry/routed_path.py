"""Course of a muscle's shortest path in given poses, as a line through space for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.engine import (
    ExactPaths,
    kinds_of,
    nominal_parameters,
    points_and_bodies,
    surfaces_of,
)
from wrapjax.geometry.kinematics import CoordinateValues, body_motion, path_points
from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.path_on_cylinders import PointsAndBodies
from wrapjax.geometry.several_wraps import Route, shortest_route
from wrapjax.geometry.surface_arc import geodesic_arc
from wrapjax.geometry.wrap_methods import CYLINDER, Kinds
from wrapjax.geometry.wrapping import NOMINAL_PARAMETERS, Surface

# Largest step on an arc (rad), for which the line is shorter than the arc by a few parts per million.
_STEP = np.deg2rad(0.5)
# Paths are padded to this number of points, so that all with as many surfaces share a compiled program.
_POINTS = 8
# Poses of one batch: all batches share a compiled program, so that it is compiled once.
_BATCH = 101

Points = Float[np.ndarray, "vertex 3"]


@dataclass(frozen=True)
class PlacedWrap:
    """A wrap surface in ground's frame.

    Parameters
    ----------
    name
        Name of the wrap.
    axes
        Columns are the axes of the surface's frame; the third is the axis of a cylinder or a torus.
    center
        Center of the surface, m.
    radius, half_length
        Radius of a cylinder, a sphere or a torus' tube, mean semi-axis of an ellipsoid; half the length of a
        cylinder, m.
    kind
        ``cylinder``, ``sphere``, ``ellipsoid`` or ``torus``.
    sizes
        Semi-axes of an ellipsoid; radii of a torus' ring and tube, m. A sphere has its radius three times.
    """

    name: str
    axes: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, " 3"]
    radius: float
    half_length: float
    kind: str = CYLINDER
    sizes: tuple[float, ...] = ()

    def to_surface_frame(self, points: Points) -> Points:
        """Transform points from ground's frame to the surface's frame (m)."""
        return (points - self.center) @ self.axes

    def to_ground_frame(self, points: Points) -> Points:
        """Transform points from the surface's frame to ground's frame (m)."""
        return self.center + points @ self.axes.T


@dataclass(frozen=True)
class RoutedPath:
    """A muscle's path in one pose, in ground's frame (m).

    Parameters
    ----------
    line
        Vertices from origin to insertion; arcs on surfaces are sampled every 0.5 degrees.
    points
        Active path points of the model.
    contacts
        First and last point of the contact with each surface that the path touches, by the wrap's name.
    wraps
        All surfaces that the path may wrap round, in its order, touched or not.
    """

    line: Points
    points: Float[np.ndarray, "point 3"]
    contacts: dict[str, Float[np.ndarray, "2 3"]]
    wraps: tuple[PlacedWrap, ...]

    @property
    def length(self) -> float:
        """Length of the line, m."""
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())


def route_path(
    model: ModelDescription,
    muscle: str,
    coordinates: Sequence[str],
    pose: Float[np.ndarray, " coordinate"],
    parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
) -> RoutedPath:
    """Compute the course of a muscle's shortest path in one pose.

    Parameters
    ----------
    model
        Description of the model, from `wrapjax.osim.model.describe_model`.
    muscle
        Name of the muscle.
    coordinates, pose
        Names and values (rad or m) of coordinates. The model's other coordinates follow their couplers or
        stay at their defaults.
    parameters
        Wrap parameters (`PARAMETERS`, at least the first six) of the muscle's surfaces in the order of its
        path; by default nominal.

    Raises
    ------
    InputError
        If the path has a part that the exact engine does not support.

    Notes
    -----
    From a path point inside a surface there is no shortest path. The engine then treats the point as on the
    surface, and the line has a gap there.
    """
    return route_paths(model, muscle, coordinates, np.asarray(pose)[None], parameters)[0]


def route_paths(
    model: ModelDescription,
    muscle: str,
    coordinates: Sequence[str],
    poses: Float[np.ndarray, "pose coordinate"],
    parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
) -> list[RoutedPath]:
    """Compute the course of a muscle's shortest path in many poses; see `route_path`."""
    wraps = ExactPaths(model, (muscle,), coordinates).wraps_of(muscle)
    path = model.muscle(muscle)
    objects = [model.wrap(name) for name in wraps]
    values = CoordinateValues(model, coordinates, np.asarray(poses))
    motion = body_motion(values, {point.body for point in path.points} | {wrap.body for wrap in objects})
    points = path_points(path.points, motion, values)
    if not wraps:
        lines = [position[active] for position, active in zip(points.position, points.active, strict=True)]
        return [RoutedPath(line, line, {}, ()) for line in lines]
    carriers = [(wrap.body, motion[wrap.body]) for wrap in objects]
    entries = [entry for entry in path.wraps if entry.wrap in wraps]
    if parameters is None:
        parameters = nominal_parameters(len(wraps))
    kinds = kinds_of(objects, entries)
    routes = _routes(
        _padded(points_and_bodies(path, points, carriers, entries)),
        surfaces_of(objects),
        parameters,
        kinds,
    )
    routed = []
    for pose, active in enumerate(points.active):
        route = jax.tree.map(lambda leaf: leaf[pose], routes)  # noqa: B023
        named = zip(wraps, kinds, strict=True)
        placed = tuple(_placed_wrap(route, number, *one) for number, one in enumerate(named))
        routed.append(_routed(route, active, placed))
    return routed


def _routes(
    path: PointsAndBodies,
    surfaces: Surface,
    parameters: Float[np.ndarray, "wrap wrap_parameter"],
    kinds: Kinds,
) -> Route:
    """Compute the course in every pose, in batches; arrays of NumPy whose first axis is ``pose``."""
    poses = path.position.shape[0]
    # Other sizes of batches and other numbers of parameters would need other programs.
    complete = jnp.asarray(_all_parameters(parameters))
    parts = []
    for first in range(0, poses, _BATCH):
        rows = np.minimum(np.arange(first, first + _BATCH), poses - 1)
        batch = jax.tree.map(lambda leaf: leaf[rows], path)  # noqa: B023
        parts.append(jax.tree.map(np.asarray, _route_batch(batch, surfaces, complete, kinds)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:poses], *parts)


def _all_parameters(
    parameters: Float[np.ndarray, "wrap wrap_parameter"],
) -> Float[np.ndarray, "wrap all_parameters"]:
    """Append nominal values of the wrap parameters that are missing at the end."""
    missing = NOMINAL_PARAMETERS[parameters.shape[1] :]
    return np.concatenate([parameters, np.tile(missing, (len(parameters), 1))], axis=1)


@eqx.filter_jit
def _route_batch(
    path: PointsAndBodies, surfaces: Surface, parameters: Float[Array, "wrap wrap_parameter"], kinds: Kinds
) -> Route:
    placed = jax.vmap(Surface.placed)(surfaces, parameters)
    return jax.vmap(lambda pose: shortest_route(pose, placed, kinds))(path)


def _padded(path: PointsAndBodies) -> PointsAndBodies:
    """Pad the points to `_POINTS` by copies of the last point."""
    missing = max(0, _POINTS - path.position.shape[1])

    def padded(leaf: Array, axis: int) -> Array:
        last = jnp.take(leaf, jnp.array([-1]), axis=axis)
        return jnp.concatenate([leaf, jnp.repeat(last, missing, axis=axis)], axis=axis)

    return eqx.tree_at(
        lambda own: (own.position, own.velocity, own.point_body),
        path,
        (padded(path.position, 1), padded(path.velocity, 2), padded(path.point_body, 1)),
    )


def _placed_wrap(route: Route, number: int, name: str, kind: str) -> PlacedWrap:
    one = jax.tree.map(lambda leaf: leaf[number], route.surfaces)
    axes = [np.array([axis.x, axis.y, axis.z]) for axis in (one.x_axis, one.y_axis, one.z_axis)]
    center = np.array([one.center.x, one.center.y, one.center.z])
    sizes = () if one.sizes is None else (float(one.sizes.x), float(one.sizes.y), float(one.sizes.z))
    # The kind of an ellipsoid includes OpenSim's method.
    shape = kind.partition("_")[0]
    axes_of = np.stack(axes, axis=1)
    return PlacedWrap(name, axes_of, center, float(one.radius), float(one.half_length), shape, sizes)


def _routed(route: Route, active: Bool[np.ndarray, " point"], wraps: tuple[PlacedWrap, ...]) -> RoutedPath:
    """Join the knots to a line, with an arc between the two knots of one contact."""
    position = np.asarray(route.position)
    first_contact = len(position) - 2 * len(wraps)
    pieces, contacts = [], {}
    for knot in route.knots[route.knots >= 0].tolist():
        wrap, leaving = divmod(knot - first_contact, 2)
        if knot < first_contact:
            if knot < active.size and active[knot]:
                pieces.append(position[knot : knot + 1])
        elif not leaving:
            surface = wraps[wrap]
            ends = position[knot : knot + 2]
            contacts[surface.name] = ends
            length = float(route.on_surface[wrap])
            if surface.kind == CYLINDER:
                pieces.append(_arc(surface, ends, length))
            else:
                pieces.append(_geodesic(surface, ends, length, pieces[-1][-1]))
    points = position[: active.size][active]
    return RoutedPath(np.concatenate(pieces), points, contacts, wraps)


def _arc(cylinder: PlacedWrap, ends: Float[np.ndarray, "2 3"], length: float) -> Points:
    """Sample the helix of given length (m) between the first and the last point of a contact."""
    first, last = cylinder.to_surface_frame(ends)
    rise = last[2] - first[2]
    turn = np.sqrt(max(length**2 - rise**2, 0.0)) / cylinder.radius
    begin, end = (np.arctan2(point[1], point[0]) for point in (first, last))
    # Of the two directions round the cylinder, take the one that ends at the contact's last point.
    misses = [np.abs(np.exp(1j * (begin + sign * turn - end)) - 1.0) for sign in (1.0, -1.0)]
    turn = turn if misses[0] <= misses[1] else -turn
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(np.abs(turn) / _STEP)) + 1))
    angle = begin + share * turn
    on_surface = [cylinder.radius * np.cos(angle), cylinder.radius * np.sin(angle), first[2] + share * rise]
    return cylinder.to_ground_frame(np.stack(on_surface, axis=1))


def _geodesic(
    surface: PlacedWrap, ends: Float[np.ndarray, "2 3"], length: float, before: Float[np.ndarray, " 3"]
) -> Points:
    """Sample the arc of a contact with another surface, which continues the straight line from ``before``."""
    first, last, start = surface.to_surface_frame(np.stack([*ends, before]))
    steps = max(1, int(np.ceil(length / (surface.radius * _STEP))))
    arc = geodesic_arc(surface.kind, surface.sizes, np.stack([first, last]), first - start, length, steps)
    return surface.to_ground_frame(arc)
