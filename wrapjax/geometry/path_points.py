"""Where a muscle runs in a pose: its path as a line through space, for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.engine import ExactPaths
from wrapjax.geometry.kinematics import CoordinateValues, body_motion, path_points
from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.path_on_cylinders import PointsAndCarriers
from wrapjax.geometry.placement import points_and_carriers, surfaces_of
from wrapjax.geometry.shortest_path import Way, shortest_way
from wrapjax.geometry.wrapping import NOMINAL, Surface

#: Longest step on an arc (rad): the line is then shorter than the arc by a few millionths of it.
_STEP = np.deg2rad(0.5)
# Paths are filled up to so many points: then one program serves all that have as many cylinders.
_POINTS = 8

Points = Float[np.ndarray, "vertex 3"]


@dataclass(frozen=True)
class PlacedCylinder:
    """A wrap cylinder in ground's frame: axes (columns; its own is the last), center, sizes (m)."""

    name: str
    axes: Float[np.ndarray, "3 3"]
    center: Float[np.ndarray, " 3"]
    radius: float
    half_length: float

    def inward(self, points: Points) -> Points:
        """Bring points from ground's frame into the cylinder's."""
        return (points - self.center) @ self.axes

    def outward(self, points: Points) -> Points:
        """Bring points from the cylinder's frame into ground's."""
        return self.center + points @ self.axes.T


@dataclass(frozen=True)
class RoutedPath:
    """A muscle's path in one pose, in ground's frame (m).

    Parameters
    ----------
    line
        From origin to insertion, arcs on cylinders in fine steps.
    points
        The model's path points on it.
    contacts
        By cylinder that the path touches: where it comes to lie on it and where it leaves.
    cylinders
        All that the path may wrap round, in its order, touched or not.
    """

    line: Points
    points: Float[np.ndarray, "point 3"]
    contacts: dict[str, Float[np.ndarray, "2 3"]]
    cylinders: tuple[PlacedCylinder, ...]

    @property
    def length(self) -> float:
        """Of the line, m."""
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())


def route_path(
    model: ModelDescription,
    muscle: str,
    coordinates: Sequence[str],
    pose: Float[np.ndarray, " coordinate"],
    parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
) -> RoutedPath:
    """Say where a muscle runs in a pose, laid the shortest way.

    Parameters
    ----------
    model
        From `wrapjax.osim.describe_model`.
    muscle
        Whose path.
    coordinates, pose
        Their values, rad or m. Others follow their couplers or stay at the model's defaults.
    parameters
        Of the muscle's cylinders in the order of its path, as in `WRAP_PARAMETERS`; nominal if not given.

    Raises
    ------
    InputError
        If the path has something that the exact engine does not know.

    Notes
    -----
    Where a path point is inside a cylinder there is no such path. The engine then takes the point for
    lying on the surface, and the line jumps there.
    """
    wraps = ExactPaths(model, (muscle,), coordinates).wraps_of(muscle)
    path = model.muscle(muscle)
    objects = [model.wrap(name) for name in wraps]
    values = CoordinateValues(model, coordinates, np.asarray(pose)[None])
    motion = body_motion(values, {point.body for point in path.points} | {one.body for one in objects})
    points = path_points(path.points, motion, values)
    active = points.active[0]
    if not wraps:
        line = points.position[0][active]
        return RoutedPath(line, line, {}, ())
    carriers = [(one.body, motion[one.body]) for one in objects]
    entries = [entry for entry in path.wraps if entry.wrap in wraps]
    surfaces = surfaces_of(objects)
    placed = np.tile(NOMINAL, (len(wraps), 1)) if parameters is None else parameters
    found = _way(
        _first_pose(points_and_carriers(path, points, carriers, entries)), surfaces, jnp.asarray(placed)
    )
    way = jax.tree.map(np.asarray, found)
    cylinders = tuple(_placed(way, number, name) for number, name in enumerate(wraps))
    return _routed(way, active, cylinders)


@eqx.filter_jit
def _way(path: PointsAndCarriers, surfaces: Surface, parameters: Float[Array, "wrap wrap_parameter"]) -> Way:
    return shortest_way(path, jax.vmap(Surface.placed)(surfaces, parameters))


def _first_pose(path: PointsAndCarriers) -> PointsAndCarriers:
    """Take the only pose; repeat the last point up to a number that most paths stay below."""
    one = jax.tree.map(lambda leaf: leaf[0], path)
    missing = max(0, _POINTS - one.position.shape[0])

    def filled(leaf: Array, axis: int) -> Array:
        last = jnp.take(leaf, jnp.array([-1]), axis=axis)
        return jnp.concatenate([leaf, jnp.repeat(last, missing, axis=axis)], axis=axis)

    return eqx.tree_at(
        lambda own: (own.position, own.velocity, own.point_body),
        one,
        (filled(one.position, 0), filled(one.velocity, 1), filled(one.point_body, 0)),
    )


def _placed(way: Way, number: int, name: str) -> PlacedCylinder:
    one = jax.tree.map(lambda leaf: leaf[number], way.cylinders)
    axes = [np.array([axis.x, axis.y, axis.z]) for axis in (one.x_axis, one.y_axis, one.z_axis)]
    center = np.array([one.center.x, one.center.y, one.center.z])
    return PlacedCylinder(name, np.stack(axes, axis=1), center, float(one.radius), float(one.half_length))


def _routed(
    way: Way, active: Bool[np.ndarray, " point"], cylinders: tuple[PlacedCylinder, ...]
) -> RoutedPath:
    """String knots together, with an arc between the two of one contact."""
    position = np.asarray(way.position)
    first_contact = len(position) - 2 * len(cylinders)
    pieces, contacts = [], {}
    for knot in way.knots[way.knots >= 0].tolist():
        wrap, leaving = divmod(knot - first_contact, 2)
        if knot < first_contact:
            if knot < active.size and active[knot]:
                pieces.append(position[knot : knot + 1])
        elif not leaving:
            cylinder = cylinders[wrap]
            ends = position[knot : knot + 2]
            contacts[cylinder.name] = ends
            pieces.append(_arc(cylinder, ends, float(way.on_surface[wrap])))
    points = position[: active.size][active]
    return RoutedPath(np.concatenate(pieces), points, contacts, cylinders)


def _arc(cylinder: PlacedCylinder, ends: Float[np.ndarray, "2 3"], length: float) -> Points:
    """Sample the helix of a length that leads from the first to the last point of a contact."""
    first, last = cylinder.inward(ends)
    rise = last[2] - first[2]
    turn = np.sqrt(max(length**2 - rise**2, 0.0)) / cylinder.radius
    begin, end = (np.arctan2(point[1], point[0]) for point in (first, last))
    # Of the two ways round, the one that ends where the contact does.
    misses = [np.abs(np.exp(1j * (begin + way * turn - end)) - 1.0) for way in (1.0, -1.0)]
    turn = turn if misses[0] <= misses[1] else -turn
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(np.abs(turn) / _STEP)) + 1))
    angle = begin + share * turn
    on_surface = [cylinder.radius * np.cos(angle), cylinder.radius * np.sin(angle), first[2] + share * rise]
    return cylinder.outward(np.stack(on_surface, axis=1))
