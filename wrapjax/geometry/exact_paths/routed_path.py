"""Course of a muscle's shortest path in given poses, as a line through space for drawing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.exact_paths.engine import (
    ExactPaths,
    PosedPath,
    kinds_of,
    nominal_parameters,
    points_and_bodies,
    straight_path,
    surfaces_of,
)
from wrapjax.geometry.exact_paths.muscle_batches import padded_alike
from wrapjax.geometry.exact_paths.several_wraps import Route, shortest_route
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, StraightPath, Surface
from wrapjax.geometry.skeleton.kinematics import CoordinateValues, PathPoints, body_motion, path_points
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.geometry.surfaces.surface_arc import geodesic_arc
from wrapjax.geometry.surfaces.wrap_methods import CYLINDER

# Largest step on an arc (rad), for which the line is shorter than the arc by a few parts per million.
_STEP = np.deg2rad(0.5)
# Paths are padded to this number of points at least, so that separate calls share a compiled program, too.
_POINTS = 8
# Poses of one batch: all batches share a compiled program, so that it is compiled once.
_BATCH = 101

Points = Float[np.ndarray, "vertex 3"]
WrapParameters = Float[np.ndarray, "wrap wrap_parameter"]


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
    length
        Length of the path, m; that of the line is less by a few parts per million of the arcs.
    moment_arm
        -dL/dq by the coordinates of the pose, m (m/m).
    """

    line: Points
    points: Float[np.ndarray, "point 3"]
    contacts: dict[str, Float[np.ndarray, "2 3"]]
    wraps: tuple[PlacedWrap, ...]
    length: float
    moment_arm: Float[np.ndarray, " coordinate"]


def route_path(
    model: ModelDescription,
    muscle: str,
    coordinates: Sequence[str],
    pose: Float[np.ndarray, " coordinate"],
    parameters: WrapParameters | None = None,
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
    own = {} if parameters is None else {muscle: parameters}
    return route_paths(model, (muscle,), coordinates, np.asarray(pose)[None], own)[muscle][0]


def route_paths(
    model: ModelDescription,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    poses: Float[np.ndarray, "pose coordinate"],
    parameters: Mapping[str, WrapParameters] = MappingProxyType({}),
) -> dict[str, list[RoutedPath]]:
    """Compute the course of muscles' shortest paths in many poses.

    All paths with surfaces are padded to the same numbers of points and surfaces, so that they share a
    compiled program.

    Parameters
    ----------
    muscles
        Names of the muscles.
    poses
        Values of ``coordinates`` (rad or m).
    parameters
        Wrap parameters by muscle, as for `route_path`; by default nominal.

    Other parameters, and errors, are those of `route_path`.

    Returns
    -------
    dict
        Paths in all poses, by muscle.
    """
    engine = ExactPaths(model, muscles, coordinates)
    wraps = {name: [model.wrap(wrap) for wrap in engine.wraps_of(name)] for name in muscles}
    values = CoordinateValues(model, coordinates, np.asarray(poses))
    bodies = {point.body for name in muscles for point in model.muscle(name).points}
    motion = body_motion(values, bodies | {wrap.body for own in wraps.values() for wrap in own})
    points = {name: path_points(model.muscle(name).points, motion, values) for name in muscles}
    wrapping, kinds = [name for name in muscles if wraps[name]], {}
    posed = []
    for name in wrapping:
        path = model.muscle(name)
        entries = [entry for entry in path.wraps if entry.wrap in engine.wraps_of(name)]
        kinds[name] = kinds_of(wraps[name], entries)
        carriers = [(wrap.body, motion[wrap.body]) for wrap in wraps[name]]
        bodies_and_points = points_and_bodies(path, points[name], carriers, entries)
        posed.append(PosedPath(bodies_and_points, surfaces_of(wraps[name]), kinds[name]))
    routed = {}
    for name in muscles:
        if not wraps[name]:
            straight = straight_path(model.muscle(name), points[name], motion["ground"], None)
            routed[name] = _straight(points[name], straight)
    for name, padded in zip(wrapping, padded_alike(posed, _POINTS) if posed else (), strict=True):
        own = parameters.get(name, nominal_parameters(len(wraps[name])))
        routes = _routes(padded, own)
        named = list(zip(engine.wraps_of(name), kinds[name], strict=True))
        routed[name] = [
            _routed(jax.tree.map(lambda leaf: leaf[pose], routes), active, named)  # noqa: B023
            for pose, active in enumerate(points[name].active)
        ]
    return {name: routed[name] for name in muscles}


def _straight(points: PathPoints, path: StraightPath) -> list[RoutedPath]:
    """Join the active points of a path without surfaces, in every pose."""
    lines = [position[active] for position, active in zip(points.position, points.active, strict=True)]
    values = zip(lines, np.asarray(path.length), np.asarray(path.moment_arm), strict=True)
    return [RoutedPath(line, line, {}, (), float(length), arm) for line, length, arm in values]


def _routes(posed: PosedPath, parameters: WrapParameters) -> Route:
    """Compute the course in every pose, in batches; arrays of NumPy whose first axis is ``pose``."""
    poses = jax.tree.leaves(posed.path)[0].shape[0]
    # Other sizes of batches and other numbers of parameters would need other programs.
    complete = _all_parameters(parameters, posed.surfaces.radius.shape[0])
    parts = []
    for first in range(0, poses, _BATCH):
        rows = np.minimum(np.arange(first, first + _BATCH), poses - 1)
        path = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], posed.path)  # noqa: B023
        batch = replace(posed, path=path)
        parts.append(jax.tree.map(np.asarray, _route_batch(batch, jnp.asarray(complete))))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:poses], *parts)


def _all_parameters(
    parameters: WrapParameters, wraps: int
) -> Float[np.ndarray, "padded_wrap all_parameters"]:
    """Append nominal values of the wrap parameters that are missing, and of padding surfaces."""
    complete = np.tile(NOMINAL_PARAMETERS, (wraps, 1))
    complete[: len(parameters), : parameters.shape[1]] = parameters
    return complete


@eqx.filter_jit
def _route_batch(posed: PosedPath, parameters: Float[Array, "wrap wrap_parameter"]) -> Route:
    placed = jax.vmap(Surface.placed)(posed.surfaces, parameters)
    return jax.vmap(lambda pose: shortest_route(pose, placed, posed.kinds, posed.numbers))(posed.path)


def _placed_wrap(route: Route, number: int, name: str, kind: str) -> PlacedWrap:
    one = jax.tree.map(lambda leaf: leaf[number], route.surfaces)
    axes = [np.array([axis.x, axis.y, axis.z]) for axis in (one.x_axis, one.y_axis, one.z_axis)]
    center = np.array([one.center.x, one.center.y, one.center.z])
    sizes = () if one.sizes is None else (float(one.sizes.x), float(one.sizes.y), float(one.sizes.z))
    # The kind of an ellipsoid includes OpenSim's method.
    shape = kind.partition("_")[0]
    axes_of = np.stack(axes, axis=1)
    return PlacedWrap(name, axes_of, center, float(one.radius), float(one.half_length), shape, sizes)


def _routed(route: Route, active: Bool[np.ndarray, " point"], named: Sequence[tuple[str, str]]) -> RoutedPath:
    """Join the knots to a line, with an arc between the two knots of one contact.

    ``named`` are names and kinds of the surfaces.
    """
    wraps = tuple(_placed_wrap(route, number, *one) for number, one in enumerate(named))
    position = np.asarray(route.position)
    first_contact = len(position) - 2 * len(route.on_surface)
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
    length, arm = float(route.path.length), np.asarray(route.path.moment_arm)
    return RoutedPath(np.concatenate(pieces), points, contacts, wraps, length, arm)


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
    vertices = max(1, int(np.ceil(length / (surface.radius * _STEP))))
    arc = geodesic_arc(surface.kind, surface.sizes, np.stack([first, last]), first - start, length, vertices)
    return surface.to_ground_frame(arc)
