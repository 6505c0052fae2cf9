"""Exact path engine: lengths and moment arms of muscle paths that wrap round surfaces, without OpenSim.

Surfaces are cylinders, spheres, ellipsoids and tori. Paths are computed in one of two ways. `GEODESIC` gives
shortest paths, whose moment arms are exactly -dL/dq. Calibrations that change wraps use it, directly or
through surrogates. `PARITY` reproduces OpenSim 4.6, defects included: to round-off, except round ellipsoids,
for which OpenSim's own tolerance is of the order of micrometers. It predicts the behavior of a model in
OpenSim and validates the engine.

Both can be differentiated by poses and wrap parameters in forward mode. Reverse mode works too, except for
`PARITY` round several surfaces or round an ellipsoid, which contains a loop of unknown length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.exact_paths.path_on_cylinders import PointsAndBodies, surfaces_in_ground
from wrapjax.geometry.exact_paths.several_wraps import (
    Numbers,
    point_clearances,
    wrap_in_parity,
    wrap_shortest,
)
from wrapjax.geometry.exact_paths.wrapping import (
    NOMINAL_PARAMETERS,
    WRAP_PARAMETERS,
    StraightPath,
    Surface,
    WrappedPath,
    parameter_names,
    unwrapped,
    wrap_once,
)
from wrapjax.geometry.skeleton.kinematics import (
    BodyMotion,
    CoordinateValues,
    PathPoints,
    body_motion,
    path_points,
)
from wrapjax.geometry.skeleton.model_description import ModelDescription, Muscle, PathWrap, WrapObject
from wrapjax.geometry.surfaces.placed_surface import FREE, PlacedSurface, WrapMethod
from wrapjax.geometry.surfaces.wrap_methods import (
    CYLINDER,
    OPENSIM_SINGLE,
    SHORTEST,
    SUPPORTED_CLASSES,
    Kinds,
    clearance,
    kind_of,
)
from wrapjax.geometry.vectors import vector

#: Most evaluations (samples times poses) in one batch; larger batches use more memory and are no faster.
_BATCH = 20_000


class Wrapping(NamedTuple):
    """Way in which paths are wrapped: methods for one surface of each kind, and a function for several."""

    name: str
    once: Callable[[str], WrapMethod]
    wrap_several: Callable[[PointsAndBodies, PlacedSurface, Kinds, Numbers], WrappedPath]


GEODESIC = Wrapping("geodesic", SHORTEST.__getitem__, wrap_shortest)
PARITY = Wrapping("parity", OPENSIM_SINGLE.__getitem__, wrap_in_parity)


class PosedPath(eqx.Module):
    """Path points of one muscle in many poses, from which its path is computed for any wrap parameters."""

    #: The first axis of all leaves is ``pose``.
    path: StraightPath | PointsAndBodies
    #: Nominal surfaces in the order of the path; the first axis of all leaves is ``wrap``.
    surfaces: Surface
    #: Kinds of the surfaces (see `wrap_methods`).
    kinds: Kinds = eqx.field(static=True, default=())
    #: Number of the kind of each surface; None if ``kinds`` is in the order of the path.
    numbers: Int[Array, " wrap"] | None = None

    def wrapped(
        self, parameters: Float[Array, "wrap wrap_parameter"], wrapping: Wrapping = GEODESIC
    ) -> WrappedPath:
        """Compute the path in every pose.

        Parameters
        ----------
        parameters
            Wrap parameters (`WRAP_PARAMETERS`) of the muscle's surfaces, in the order of its path. Those of
            surfaces other than cylinders may be followed by `FURTHER_WRAP_PARAMETERS`.
        wrapping
            `GEODESIC` or `PARITY`.

        Returns
        -------
        WrappedPath
            The first axis of all leaves is ``pose``.
        """
        if isinstance(self.path, PointsAndBodies):
            surfaces = jax.vmap(Surface.placed)(self.surfaces, parameters)
            return jax.vmap(lambda path: wrapping.wrap_several(path, surfaces, self.kinds, self.numbers))(
                self.path
            )
        if not parameters.shape[0]:
            return unwrapped(self.path)
        surface = jax.tree.map(lambda leaf: leaf[0], self.surfaces)
        placed = surface.placed(parameters[0])
        method = wrapping.once(self.kinds[0] if self.kinds else CYLINDER)
        return jax.vmap(lambda path: wrap_once(path, placed, method))(self.path)

    def nearest_points(self) -> Float[Array, "pose wrap"]:
        """Compute the distance of the nearest path point from each nominal surface (m), negative inside."""
        nominal = jnp.asarray(nominal_parameters(self.surfaces.radius.shape[0]))
        placed = jax.vmap(Surface.placed)(self.surfaces, nominal)
        path = self.path
        if isinstance(path, PointsAndBodies):

            def of_pose(path: PointsAndBodies) -> Float[Array, " wrap"]:
                in_ground = surfaces_in_ground(path, placed)
                return point_clearances(path, in_ground, self.kinds, self.numbers).min(axis=1)

            return jax.vmap(of_pose)(path)
        if not nominal.shape[0]:
            return jnp.zeros((*path.length.shape, 0))
        surface, kind = jax.tree.map(lambda leaf: leaf[0], placed), (self.kinds or (CYLINDER,))[0]
        ends = jnp.stack(
            [clearance(surface.to_surface_frame(end), surface, kind) for end in (path.start, path.end)]
        )
        return jnp.where(path.eligible, ends.min(axis=0), FREE).min(axis=1, keepdims=True)


class ExactPaths:
    """Muscle paths of a model, computed by the exact engine.

    Parameters
    ----------
    model
        Description of the model, from `wrapjax.osim.model.describe_model`.
    muscles
        Names of the muscles.
    coordinates
        Names of the coordinates of poses and moment arms. The model's other coordinates follow their couplers
        or stay at their defaults.

    Raises
    ------
    InputError
        If a path has a part that the engine does not support: a wrap object of another class, one without
        extent, or a path that is not made of points. All such parts are named.
    """

    def __init__(self, model: ModelDescription, muscles: Sequence[str], coordinates: Sequence[str]):
        self.model = model
        self.muscles = tuple(muscles)
        self.coordinates = tuple(coordinates)
        problems = [problem for name in muscles for problem in _unsupported_parts(model, model.muscle(name))]
        if problems:
            raise InputError(list(dict.fromkeys(problems)))

    def wraps_of(self, muscle: str) -> tuple[str, ...]:
        """Names of the active wraps of a muscle, in the order of its path."""
        return tuple(
            entry.wrap for entry in self.model.muscle(muscle).wraps if self.model.wrap(entry.wrap).active
        )

    @property
    def wrap_classes(self) -> dict[str, str]:
        """OpenSim's class of each active wrap of the muscles, by name."""
        return {wrap: self.model.wrap(wrap).kind for name in self.muscles for wrap in self.wraps_of(name)}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the wrap parameters of the model's surfaces, whichever of them the muscles have."""
        return parameter_names(wrap.kind for wrap in self.model.wraps if wrap.active)

    def posed(self, poses: Float[np.ndarray, "pose coordinate"]) -> dict[str, PosedPath]:
        """Compute the path points of each muscle in poses.

        Parameters
        ----------
        poses
            Values of ``coordinates``, rad or m.

        Returns
        -------
        dict
            Posed path by muscle name. Those with one surface are padded to the same number of segments.

        Raises
        ------
        InputError
            If a coordinate, joint or point moves by a function of an unsupported kind.
        """
        values = CoordinateValues(self.model, self.coordinates, poses)
        muscles = {name: self.model.muscle(name) for name in self.muscles}
        bodies = {point.body for muscle in muscles.values() for point in muscle.points}
        bodies |= {self.model.wrap(wrap).body for name in muscles for wrap in self.wraps_of(name)}
        motion = body_motion(values, bodies)
        posed = {}
        for name, muscle in muscles.items():
            points = path_points(muscle.points, motion, values)
            wraps = [self.model.wrap(wrap) for wrap in self.wraps_of(name)]
            entries = [entry for entry in muscle.wraps if entry.wrap in self.wraps_of(name)]
            carriers = [(wrap.body, motion[wrap.body]) for wrap in wraps]
            path: StraightPath | PointsAndBodies
            if len(wraps) > 1:
                path = points_and_bodies(muscle, points, carriers, entries)
            elif wraps:
                path = straight_path(muscle, points, carriers[0][1], entries[0])
            else:
                path = straight_path(muscle, points, motion["ground"], None)
            posed[name] = PosedPath(path, surfaces_of(wraps), kinds_of(wraps, entries))
        return _padded(posed)


def _padded(posed: dict[str, PosedPath]) -> dict[str, PosedPath]:
    """Pad paths with one surface to the same number of segments, so that they share a compiled program."""
    single = {
        name: one.path
        for name, one in posed.items()
        if isinstance(one.path, StraightPath) and one.surfaces.radius.size
    }
    most = max((path.eligible.shape[1] for path in single.values()), default=0)
    return posed | {name: replace(posed[name], path=path.padded(most)) for name, path in single.items()}


def wrap_at_samples(
    posed: PosedPath,
    parameters: Float[np.ndarray, "sample wrap wrap_parameter"],
    wrapping: Wrapping = GEODESIC,
) -> WrappedPath:
    """Compute one muscle's path at every sample of its wrap parameters, in every pose.

    Parameters
    ----------
    posed
        Path points in the poses.
    parameters
        Wrap parameters (`WRAP_PARAMETERS`) of the muscle's surfaces.
    wrapping
        `GEODESIC` or `PARITY`.

    Returns
    -------
    WrappedPath
        NumPy arrays, whose first axes are ``sample pose``.
    """
    poses = jax.tree.leaves(posed.path)[0].shape[0]
    chunk = max(1, min(len(parameters), _BATCH // poses))
    parts = []
    for first in range(0, len(parameters), chunk):
        part = parameters[first : first + chunk]
        # The last chunk is padded, because another length would need another compiled program.
        padded = np.concatenate([part, np.repeat(part[-1:], chunk - len(part), axis=0)])
        parts.append(jax.tree.map(np.asarray, _at_samples(posed, jnp.asarray(padded), wrapping)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(parameters)], *parts)


@eqx.filter_jit
def _at_samples(
    posed: PosedPath, parameters: Float[Array, "sample wrap wrap_parameter"], wrapping: Wrapping
) -> WrappedPath:
    return jax.vmap(lambda one: posed.wrapped(one, wrapping))(parameters)


def nominal_parameters(
    wraps: int, count: int = len(WRAP_PARAMETERS)
) -> Float[np.ndarray, "wrap wrap_parameter"]:
    """First ``count`` wrap parameters (`PARAMETERS`) of a number of surfaces as the model has them."""
    return np.tile(NOMINAL_PARAMETERS[:count], (wraps, 1))


def _unsupported_parts(model: ModelDescription, muscle: Muscle) -> list[Problem]:
    if muscle.path_kind != "GeometryPath":
        return [_unsupported(model, f"muscle '{muscle.name}' has a {muscle.path_kind}, no path of points")]
    problems = []
    for entry in muscle.wraps:
        wrap = model.wrap(entry.wrap)
        if not wrap.active:
            continue
        if wrap.kind not in SUPPORTED_CLASSES:
            problems.append(_unsupported(model, f"wrap object '{wrap.name}' is a {wrap.kind}"))
        elif min(extents_of(wrap)) <= 0.0:
            problems.append(
                Problem(
                    model.name,
                    f"wrap object '{wrap.name}' of muscle '{muscle.name}' has no extent: sizes above 0 m "
                    f"were expected, and {', '.join(f'{size:g}' for size in extents_of(wrap))} found",
                )
            )
    return problems


def _unsupported(model: ModelDescription, what: str) -> Problem:
    return Problem(
        model.name,
        f"{what}: the exact engine does not support it",
        hint="run 'calibrate' with --method NGA, SGA or LSGA, without --geometry: OpenSim's own paths",
    )


def straight_path(
    muscle: Muscle, points: PathPoints, carrier: BodyMotion, wrap: PathWrap | None
) -> StraightPath:
    """Compute a path straight from point to point, and its segments that may wrap round one surface.

    Parameters
    ----------
    muscle
        Muscle of the path.
    points
        Path points in every pose, in ground's frame.
    carrier
        Motion of the body that carries the surface; segments are given in its frame.
    wrap
        Entry of the surface in the muscle's path; None for a path without a surface.
    """
    position, velocity = _in_frame_of(_with_inactive_merged(points), carrier)
    segment, rate = np.diff(position, axis=1), np.diff(velocity, axis=2)
    length = np.linalg.norm(segment, axis=-1)
    along = np.einsum("psk,pcsk->pcs", segment / np.maximum(length, 1e-300)[..., None], rate)
    first, last = (0, 0) if wrap is None else _wrapping_range(muscle, wrap)
    return StraightPath(
        length=jnp.asarray(length.sum(axis=-1)),
        moment_arm=jnp.asarray(-along.sum(axis=-1)),
        start=vector(position[:, first:last]),
        end=vector(position[:, first + 1 : last + 1]),
        start_velocity=vector(velocity[:, :, first:last]),
        end_velocity=vector(velocity[:, :, first + 1 : last + 1]),
        eligible=jnp.asarray(_eligible(points.active, first, last)),
    )


def points_and_bodies(
    muscle: Muscle,
    points: PathPoints,
    carriers: Sequence[tuple[str, BodyMotion]],
    wraps: Sequence[PathWrap],
) -> PointsAndBodies:
    """Collect a path's points and the bodies that carry its surfaces, in ground's frame.

    Parameters
    ----------
    muscle
        Muscle of the path.
    points
        Path points in every pose, in ground's frame.
    carriers
        Name and motion of the body that carries each surface.
    wraps
        Entries of the surfaces in the muscle's path.
    """
    poses = len(points.position)
    names = dict.fromkeys([*points.bodies, *(name for name, _ in carriers)])
    numbers = {name: number for number, name in enumerate(names)}
    ranges = [_wrapping_range(muscle, wrap) for wrap in wraps]
    merged, source = _with_inactive_merged(points), _active_source(points)
    # An inactive point belongs to the body of the active point that it coincides with.
    owner = np.array([numbers[name] for name in points.bodies])[source]
    moving = np.array([point.motion is not None for point in muscle.points])

    def active_ends(end: str) -> Int[Array, "pose wrap"]:
        place = np.arange(len(points.bodies))
        columns = []
        for first, last in ranges:
            inside = points.active & (place >= first) & (place <= last)
            backwards = end == "last"
            found = np.argmax(inside[:, ::-1] if backwards else inside, axis=1)
            columns.append(len(place) - 1 - found if backwards else found)
        return jnp.asarray(np.stack(columns, axis=1))

    return PointsAndBodies(
        position=jnp.asarray(merged.position),
        velocity=jnp.asarray(merged.velocity),
        point_body=jnp.asarray(owner),
        rotation=jnp.asarray(np.stack([motion.rotation for _, motion in carriers], axis=1)),
        origin=jnp.asarray(np.stack([motion.origin for _, motion in carriers], axis=1)),
        angular=jnp.asarray(np.stack([motion.angular for _, motion in carriers], axis=2)),
        linear=jnp.asarray(np.stack([motion.linear for _, motion in carriers], axis=2)),
        wrap_body=jnp.asarray(np.tile([numbers[name] for name, _ in carriers], (poses, 1))),
        first_point=active_ends("first"),
        last_point=active_ends("last"),
        moving=jnp.asarray(moving[source]) if moving.any() else None,
    )


def surfaces_of(wraps: Sequence[WrapObject]) -> Surface:
    """Convert wrap objects of a model's description; the first axis of all leaves is ``wrap``."""
    axes = [wrap.quadrant.lstrip("+-") for wrap in wraps]
    cylinders_only = all(wrap.kind == "WrapCylinder" for wrap in wraps)
    unrestricted = [axis == "all" for axis in axes]
    negative = [wrap.quadrant.startswith("-") for wrap in wraps]
    lengths = [1.0 if wrap.length is None else wrap.length for wrap in wraps]

    # Lists become NumPy arrays first: JAX converts them number by number.
    def array(values: Sequence[Any], *shape: int) -> Float[Array, "wrap ..."]:
        return jnp.asarray(np.array(values, dtype=float).reshape(-1, *shape))

    return Surface(
        rotation=array([_rotation(wrap.xyz_body_rotation) for wrap in wraps], 3, 3),
        center=array([wrap.translation for wrap in wraps], 3),
        radius=array([_radius(wrap) for wrap in wraps]),
        length=array(lengths),
        side_axis=jnp.asarray(np.array([0 if axis == "all" else "xyz".index(axis) for axis in axes], int)),
        side=jnp.asarray(np.where(unrestricted, 0, np.where(negative, -1, 1)), dtype=int),
        sizes=None if cylinders_only else array([_sizes(wrap) for wrap in wraps], 3),
    )


def kinds_of(wraps: Sequence[WrapObject], entries: Sequence[PathWrap]) -> Kinds:
    """Kinds of wrap objects of a model's description, from the entries of the path."""
    return tuple(kind_of(wrap.kind, entry.method) for wrap, entry in zip(wraps, entries, strict=True))


def extents_of(wrap: WrapObject) -> tuple[float, ...]:
    """Sizes of a wrap object that a path depends on, m."""
    return (wrap.radius,) if wrap.radius is not None else wrap.sizes


def _radius(wrap: WrapObject) -> float:
    if wrap.radius is not None:
        return wrap.radius
    return wrap.sizes[1] if wrap.kind == "WrapTorus" else sum(wrap.sizes) / 3.0


def _sizes(wrap: WrapObject) -> tuple[float, float, float]:
    if wrap.radius is not None:
        return (wrap.radius,) * 3
    first, second, *third = wrap.sizes
    return first, second, third[0] if third else second


def _in_frame_of(
    points: PathPoints, carrier: BodyMotion
) -> tuple[Float[np.ndarray, "pose point 3"], Float[np.ndarray, "pose coordinate point 3"]]:
    """Transform positions, and velocities relative to the body, to the body's frame."""
    arm = points.position - carrier.origin[:, None]
    carried = carrier.linear[:, :, None] + np.cross(carrier.angular[:, :, None], arm[:, None])
    position = arm @ carrier.rotation
    relative = points.velocity - carried
    # One matrix product a pose: an einsum takes several times as long.
    velocity = (relative.reshape(len(arm), -1, 3) @ carrier.rotation).reshape(relative.shape)
    return position, velocity


def _rotation(angles: tuple[float, float, float]) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix of OpenSim's body-fixed x-y-z angles (rad)."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_x @ about_y @ about_z


def _wrapping_range(muscle: Muscle, wrap: PathWrap) -> tuple[int, int]:
    """First and last point, 0-based, of the part of the path that may wrap."""
    last = len(muscle.points) if wrap.last_point < 1 else wrap.last_point
    return max(wrap.first_point, 1) - 1, last - 1


def _with_inactive_merged(points: PathPoints) -> PathPoints:
    """Move inactive points to the active point before them or, at the path's beginning, after them."""
    if points.active.all():
        return points
    source = _active_source(points)
    position = np.take_along_axis(points.position, source[:, :, None], axis=1)
    velocity = np.take_along_axis(points.velocity, source[:, None, :, None], axis=2)
    return replace(points, position=position, velocity=velocity)


def _active_source(points: PathPoints) -> Int[np.ndarray, "pose point"]:
    """Return the number of the active point to which each point is moved, its own if it is active."""
    place = np.arange(points.active.shape[1])
    before = np.maximum.accumulate(np.where(points.active, place, -1), axis=1)
    return np.where(before < 0, np.argmax(points.active, axis=1)[:, None], before)


def _eligible(
    active: Bool[np.ndarray, "pose point"], first: int, last: int
) -> Bool[np.ndarray, "pose segment"]:
    """Whether a segment of the range lies between two active points of the range."""
    inside = active[:, first : last + 1]
    # The segment's end is active, and an active point comes before it.
    after_active = np.cumsum(inside, axis=1)[:, :-1] > 0
    return inside[:, 1:] & after_active
