"""Forward kinematics of all bodies at once, by NumPy or by JAX, whichever the given coordinates belong to.

A skeleton is a tree of bodies with ground at its root. Its names and indices are a `SkeletonStructure`; its
numbers (frames, axes, functions) a `Skeleton`, a tree of arrays that JAX may differentiate. Joints are sorted
by their number of joints to ground, so that all joints at one distance are computed in one step.

A joint displaces its child frame by rotations, each about an axis of the frame that those before have
rotated, and by translations along axes of its parent frame:
``X(child body) = X(parent body) parent_frame (rotations, translations) inverse(child_frame)``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.skeleton.functions import CONSTANT_ZERO, IDENTITY, FunctionTable, evaluate, tabulate
from wrapjax.geometry.skeleton.model_description import Axis, Coordinate, Joint, ModelDescription

Indices = tuple[int, ...]


@dataclass(frozen=True)
class SkeletonStructure:
    """Names and indices of a skeleton, hashable.

    Parameters
    ----------
    bodies
        Names of the bodies: ground, then the child of each joint.
    joints
        Names of the joints, those nearest to ground first.
    parents
        Index of each joint's parent body.
    levels
        First joint, and joint after the last one, of each distance from ground.
    coordinates
        Names of the given coordinates, of which the others are functions or constants.
    all_coordinates
        Names of all coordinates of the joints, and of those that they follow.
    follows
        Index of the coordinate that each of all coordinates follows; its own if it follows none.
    given
        Column of each of all coordinates among the given ones; -1 if it is not given.
    depth
        Largest number of couplers in a row.
    rotations
        Number of rotations of every joint, unused ones included; translations come after them.
    moved_by
        Coordinate, among all coordinates, that drives each rotation and translation of each joint; -1 if
        none.
    movers
        Joint and given coordinate of each pair in which the coordinate moves the joint.
    """

    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    parents: Indices
    levels: tuple[tuple[int, int], ...]
    coordinates: tuple[str, ...]
    all_coordinates: tuple[str, ...]
    follows: Indices
    given: Indices
    depth: int
    rotations: int
    moved_by: tuple[Indices, ...]
    movers: tuple[tuple[int, int], ...]

    def root_coordinate(self, index: int) -> int:
        """Column of the given coordinate that determines one of all coordinates; -1 if none does."""
        while self.follows[index] != index:
            index = self.follows[index]
        return self.given[index]

    @property
    def ancestors(self) -> np.ndarray:
        """Whether each joint moves each body, ``body joint``."""
        moves = np.zeros((len(self.bodies), len(self.joints)), dtype=bool)
        for joint, parent in enumerate(self.parents):
            moves[joint + 1] = moves[parent]
            moves[joint + 1, joint] = True
        return moves

    @property
    def mover_slots(self) -> np.ndarray:
        """Which rotations and translations of its joint belong to each mover, ``mover slot``, as numbers."""
        slots = np.zeros((len(self.movers), len(self.moved_by[0]) if self.moved_by else 0))
        for row, (joint, column) in enumerate(self.movers):
            for slot, coordinate in enumerate(self.moved_by[joint]):
                slots[row, slot] = coordinate >= 0 and self.root_coordinate(coordinate) == column
        return slots


class Skeleton(NamedTuple):
    """Numbers of a skeleton, in arrays of NumPy or JAX.

    Parameters
    ----------
    parent_rotation, parent_origin
        Pose of each joint's parent frame in the parent body: ``joint 3 3``, and ``joint 3`` (m).
    child_rotation, child_origin
        Pose of each joint's child frame in the child body.
    axes
        Unit directions of rotations and translations, ``joint slot 3``; zero where a slot is unused.
    displacements
        Functions from coordinates to angles (rad) and displacements (m), for ``joint slot`` in a row.
    translation_factors
        Factors on the displacements along translation axes, 1 in a model that is not scaled,
        ``joint translation``.
    couplers
        Functions of coupled coordinates; the identity for others.
    defaults
        Values of coordinates that are not given.
    """

    parent_rotation: Any
    parent_origin: Any
    child_rotation: Any
    child_origin: Any
    axes: Any
    displacements: FunctionTable
    translation_factors: Any
    couplers: FunctionTable
    defaults: Any


class BodyPoses(NamedTuple):
    """Poses of all bodies in ground's frame, with leading axes such as ``pose``.

    Parameters
    ----------
    rotation, origin
        Rotation matrices, whose columns are the bodies' axes, ``... body 3 3``; and origins, ``... body 3``.
    angular, linear
        Motion that each mover gives to all bodies below its joint, per unit speed of its coordinate: angular
        velocity, and velocity of the body-fixed point at ground's origin, ``... mover 3``.
    """

    rotation: Any
    origin: Any
    angular: Any
    linear: Any


def build_skeleton(
    model: ModelDescription, coordinates: Sequence[str], bodies: Iterable[str] | None = None
) -> tuple[SkeletonStructure, Skeleton]:
    """Build the skeleton of a model.

    Parameters
    ----------
    model
        Description of the model.
    coordinates
        Names of the coordinates that will be given. Coupled coordinates follow them; others stay at the
        model's defaults.
    bodies
        Names of the bodies that are needed; those between them and ground are added. By default all.

    Returns
    -------
    structure, skeleton
        Names and indices, and numbers.

    Raises
    ------
    InputError
        If a joint between the bodies and ground is of an unsupported kind and a given coordinate moves it, or
        a coordinate follows another by a function of an unsupported kind.
    """
    joints, levels = _sorted_joints(model, bodies)
    names = ("ground", *(joint.child_body for joint in joints))
    known = _needed_coordinates(model, joints, coordinates)
    place = {name: index for index, name in enumerate(known)}
    entries = [model.coordinate(name) for name in known]
    follows = tuple(
        place[entry.coupled_to[0] if entry.coupled_to and entry.name not in coordinates else entry.name]
        for entry in entries
    )
    axes = [_axes_of(joint, model, coordinates) for joint in joints]
    rotations = max((sum(axis.kind == "rotation" for axis in row) for row in axes), default=0)
    translations = max((sum(axis.kind == "translation" for axis in row) for row in axes), default=0)
    slots = [_in_slots(row, rotations, translations) for row in axes]
    given = tuple(coordinates.index(name) if name in coordinates else -1 for name in known)
    structure = SkeletonStructure(
        bodies=names,
        joints=tuple(joint.name for joint in joints),
        parents=tuple(names.index(joint.parent_body) for joint in joints),
        levels=levels,
        coordinates=tuple(coordinates),
        all_coordinates=known,
        follows=follows,
        given=given,
        depth=_longest_chain(follows),
        rotations=rotations,
        moved_by=tuple(
            tuple(-1 if axis is None or axis.coordinate is None else place[axis.coordinate] for axis in row)
            for row in slots
        ),
        movers=(),
    )
    movers = {
        (joint, structure.root_coordinate(coordinate)): None
        for joint, row in enumerate(structure.moved_by)
        for coordinate in row
        if coordinate >= 0 and structure.root_coordinate(coordinate) >= 0
    }
    structure = SkeletonStructure(**(vars(structure) | {"movers": tuple(movers)}))
    frames = [_frames(joint) for joint in joints]
    functions = [CONSTANT_ZERO if axis is None else axis.function for row in slots for axis in row]
    directions = [(0.0, 0.0, 0.0) if axis is None else axis.direction for row in slots for axis in row]
    parent_rotation, parent_origin, child_rotation, child_origin = (
        np.array([frame[part] for frame in frames]).reshape(len(joints), *((3, 3) if part % 2 == 0 else (3,)))
        for part in range(4)
    )
    skeleton = Skeleton(
        parent_rotation=parent_rotation,
        parent_origin=parent_origin,
        child_rotation=child_rotation,
        child_origin=child_origin,
        axes=np.array(directions).reshape(len(joints), rotations + translations, 3),
        displacements=tabulate(functions),
        translation_factors=np.ones((len(joints), translations)),
        couplers=tabulate([_coupler(model, entry, coordinates) for entry in entries]),
        defaults=np.array([entry.default_value for entry in entries]),
    )
    return structure, skeleton


def body_poses(structure: SkeletonStructure, skeleton: Skeleton, given: Any) -> BodyPoses:
    """Compute the poses of all bodies, and how each coordinate moves them.

    Parameters
    ----------
    structure, skeleton
        Names and indices, and numbers, of the skeleton.
    given
        Values of the given coordinates, an array of NumPy or JAX, ``... coordinate``; rad or m.
    """
    xp = given.__array_namespace__()
    lead = given.shape[:-1]
    angles, shifts, rates = _displacements(structure, skeleton, given)
    turned, directions = _successive_rotations(xp, skeleton.axes[:, : structure.rotations], angles)
    translation_axes = xp.broadcast_to(
        xp.asarray(skeleton.axes[:, structure.rotations :]), (*shifts.shape, 3)
    )
    shift = xp.sum(shifts[..., None] * translation_axes, axis=-2)
    parent_rotation = xp.asarray(skeleton.parent_rotation)
    local_rotation = _product(_product(parent_rotation, turned), xp.swapaxes(skeleton.child_rotation, -1, -2))
    local_origin = (
        skeleton.parent_origin
        + _rotated(parent_rotation, shift)
        - _rotated(local_rotation, xp.asarray(skeleton.child_origin))
    )
    rotation = xp.broadcast_to(xp.eye(3)[None], (*lead, 1, 3, 3))
    origin = xp.zeros((*lead, 1, 3))
    for start, stop in structure.levels:
        parents = np.array(structure.parents[start:stop])
        above, base = rotation[..., parents, :, :], origin[..., parents, :]
        new_rotation = _product(above, local_rotation[..., start:stop, :, :])
        new_origin = base + _rotated(above, local_origin[..., start:stop, :])
        rotation = xp.concatenate([rotation, new_rotation], axis=-3)
        origin = xp.concatenate([origin, new_origin], axis=-2)
    if not structure.movers:
        return BodyPoses(rotation, origin, xp.zeros((*lead, 0, 3)), xp.zeros((*lead, 0, 3)))
    base = _product(rotation[..., np.array(structure.parents), :, :], parent_rotation)
    in_ground = _rotated(base[..., None, :, :], xp.concatenate([directions, translation_axes], axis=-2))
    moved = rates[..., None] * in_ground
    center = origin[..., 1:, :] + _rotated(rotation[..., 1:, :, :], xp.asarray(skeleton.child_origin))
    rows = np.array([joint for joint, _ in structure.movers])
    selected = structure.mover_slots[:, :, None] * moved[..., rows, :, :]
    angular = xp.sum(selected[..., : structure.rotations, :], axis=-2)
    linear = xp.sum(selected[..., structure.rotations :, :], axis=-2)
    return BodyPoses(rotation, origin, angular, linear + xp.linalg.cross(center[..., rows, :], angular))


def stations(poses: BodyPoses, bodies: Any, locations: Any) -> Any:
    """Compute positions in ground of points fixed to bodies.

    Parameters
    ----------
    poses
        Poses of the bodies.
    bodies
        Index of the body of each point.
    locations
        Locations in the bodies' frames, m, ``... point 3``.

    Returns
    -------
    Array
        Positions, m, ``... point 3``.
    """
    return poses.origin[..., bodies, :] + _rotated(poses.rotation[..., bodies, :, :], locations)


def all_coordinate_values(structure: SkeletonStructure, skeleton: Skeleton, given: Any) -> tuple[Any, Any]:
    """Compute the values of all coordinates, and their derivatives by the given ones that determine them.

    Returns
    -------
    values, slopes
        Values (rad or m), and derivative by the column `SkeletonStructure.root_coordinate`; zero if constant.
    """
    xp = given.__array_namespace__()
    lead = given.shape[:-1]
    extended = xp.concatenate(
        [given, xp.broadcast_to(xp.asarray(skeleton.defaults), (*lead, len(structure.given)))], axis=-1
    )
    count = given.shape[-1]
    source = np.array([column if column >= 0 else count + at for at, column in enumerate(structure.given)])
    values = extended[..., source.astype(int)]
    slopes = xp.broadcast_to(xp.asarray((np.array(structure.given) >= 0) * 1.0), values.shape)
    follows = np.array(structure.follows, dtype=int)
    for _ in range(structure.depth):
        values, rates = evaluate(skeleton.couplers, values[..., follows])
        slopes = rates * slopes[..., follows]
    return values, slopes


def _displacements(structure: SkeletonStructure, skeleton: Skeleton, given: Any) -> tuple[Any, Any, Any]:
    """Compute angles (rad), translations (m) and the rates of both by the coordinates that cause them."""
    xp = given.__array_namespace__()
    values, slopes = all_coordinate_values(structure, skeleton, given)
    # A last entry, zero, stands for displacements that no coordinate drives.
    nothing = xp.zeros((*given.shape[:-1], 1))
    # Without bodies to move, in a model of paths on the ground alone, the list of joints is empty.
    translations = skeleton.translation_factors.shape[1]
    slots = (len(structure.moved_by), structure.rotations + translations)
    moved_by = np.array(structure.moved_by, dtype=int).reshape(slots)
    flat = moved_by.reshape(-1)
    at = xp.concatenate([values, nothing], axis=-1)[..., flat]
    displaced, rates = evaluate(skeleton.displacements, at)
    rates = rates * xp.concatenate([slopes, nothing], axis=-1)[..., flat]
    shape = (*given.shape[:-1], *moved_by.shape)
    displaced, rates = xp.reshape(displaced, shape), xp.reshape(rates, shape)
    factors = xp.concatenate(
        [xp.ones((moved_by.shape[0], structure.rotations)), xp.asarray(skeleton.translation_factors)], axis=-1
    )
    displaced, rates = displaced * factors, rates * factors
    return displaced[..., : structure.rotations], displaced[..., structure.rotations :], rates


def _successive_rotations(xp: Any, axes: Any, angles: Any) -> tuple[Any, Any]:
    """Compose rotations about axes of the frame that those before have rotated.

    Returns
    -------
    rotation, directions
        Rotation of the frame, ``... joint 3 3``, and each axis as it stands, in the frame before all
        rotations, ``... joint rotation 3``.
    """
    identity = xp.eye(3)
    rotation = xp.broadcast_to(identity[None], (*angles.shape[:-1], 3, 3))
    directions = []
    for slot in range(angles.shape[-1]):
        axis = xp.asarray(axes[:, slot])
        directions.append(_rotated(rotation, axis)[..., None, :])
        sine, cosine = xp.sin(angles[..., slot]), xp.cos(angles[..., slot])
        outer = axis[:, :, None] * axis[:, None, :]
        x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
        zero = xp.zeros_like(x)
        cross = xp.stack(
            [xp.stack([zero, -z, y], -1), xp.stack([z, zero, -x], -1), xp.stack([-y, x, zero], -1)], -2
        )
        # Rodrigues' formula; an unused slot has axis and angle zero and gives the identity.
        turn = (
            cosine[..., None, None] * identity[None]
            + sine[..., None, None] * cross
            + (1.0 - cosine)[..., None, None] * outer
        )
        rotation = _product(rotation, turn)
    if not directions:
        return rotation, xp.zeros((*angles.shape, 3))
    return rotation, xp.concatenate(directions, axis=-2)


def _product(left: Any, right: Any) -> Any:
    """Multiply 3 x 3 matrices. Written as sums, since XLA compiles small matrix products to slow loops."""
    xp = right.__array_namespace__()
    if xp is np:
        return np.matmul(left, right)
    return sum(left[..., :, inner, None] * right[..., None, inner, :] for inner in range(3))


def _rotated(rotation: Any, vector: Any) -> Any:
    """Multiply 3 x 3 matrices and vectors."""
    return sum(rotation[..., :, inner] * vector[..., inner, None] for inner in range(3))


def _sorted_joints(
    model: ModelDescription, bodies: Iterable[str] | None
) -> tuple[list[Joint], tuple[tuple[int, int], ...]]:
    """Sort the joints between the bodies and ground by their distance from ground."""
    above = {joint.child_body: joint for joint in model.joints}
    depths: dict[str, int] = {}

    def depth(body: str) -> int:
        if body not in above:
            return 0
        if body not in depths:
            depths[body] = 1 + depth(above[body].parent_body)
        return depths[body]

    for body in above if bodies is None else bodies:
        depth(body)
    joints = sorted((above[body] for body in depths), key=lambda joint: depths[joint.child_body])
    counts = [sum(value == level for value in depths.values()) for level in sorted(set(depths.values()))]
    ends = np.cumsum([0, *counts]).tolist()
    return joints, tuple(pairwise(ends))


def _needed_coordinates(
    model: ModelDescription, joints: Sequence[Joint], coordinates: Sequence[str]
) -> tuple[str, ...]:
    """Names of the joints' coordinates, and of those that they follow, unless they are given."""
    needed: dict[str, None] = {}
    waiting = [name for joint in joints if joint.axes is not None for name in joint.coordinates]
    while waiting:
        name = waiting.pop(0)
        if name not in needed:
            needed[name] = None
            waiting += [] if name in coordinates else model.coordinate(name).coupled_to
    return tuple(needed)


def _longest_chain(follows: Indices) -> int:
    def length(index: int) -> int:
        return 0 if follows[index] == index else 1 + length(follows[index])

    return max((length(index) for index in range(len(follows))), default=0)


def _coupler(model: ModelDescription, entry: Coordinate, coordinates: Sequence[str]) -> Any:
    if not entry.coupled_to or entry.name in coordinates:
        return IDENTITY
    if entry.coupler is None:
        followed = ", ".join(entry.coupled_to)
        message = f"follows {followed} by a function of an unknown kind"
        raise InputError(Problem(model.name, message, place=entry.name))
    return entry.coupler


def _axes_of(joint: Joint, model: ModelDescription, coordinates: Sequence[str]) -> Sequence[Axis]:
    """Axes of a joint; none of a joint of an unsupported kind, which has to stay in its default pose."""
    if joint.axes is not None:
        return joint.axes
    if any(name in coordinates for name in _roots(model, joint.coordinates, coordinates)):
        raise InputError(
            Problem(
                model.name,
                f"joint '{joint.name}' is a {joint.kind} that the skeleton cannot move",
                hint="supported are pin, slider, universal, gimbal, ball, planar and free joints, and custom "
                "joints with constants, polynomials and splines of one coordinate",
            )
        )
    return ()


def _roots(model: ModelDescription, names: Iterable[str], coordinates: Sequence[str]) -> set[str]:
    """Replace coupled coordinates by those that they follow, unless they are given."""
    roots: set[str] = set()
    for name in names:
        follows = () if name in coordinates else model.coordinate(name).coupled_to
        roots |= _roots(model, follows, coordinates) if follows else {name}
    return roots


def _in_slots(axes: Sequence[Axis], rotations: int, translations: int) -> list[Axis | None]:
    """Put a joint's axes into slots, rotations first, with None in unused slots."""
    by_kind: Mapping[str, list[Axis]] = {
        kind: [axis for axis in axes if axis.kind == kind] for kind in ("rotation", "translation")
    }
    slots: list[Axis | None] = []
    for kind, count in (("rotation", rotations), ("translation", translations)):
        slots += by_kind[kind] + [None] * (count - len(by_kind[kind]))
    return slots


def _frames(joint: Joint) -> tuple[Any, Any, Any, Any]:
    """Rotation and origin of a joint's parent and child frame; of a joint that rests, in its default pose."""
    rotation, origin = np.asarray(joint.in_parent.rotation), np.asarray(joint.in_parent.translation)
    if joint.axes is None:
        origin = origin + rotation @ np.asarray(joint.default.translation)
        rotation = rotation @ np.asarray(joint.default.rotation)
    return rotation, origin, np.asarray(joint.in_child.rotation), np.asarray(joint.in_child.translation)
