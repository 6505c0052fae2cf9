"""Inverse dynamics taken apart: what OpenSim says of bodies that move as recorded, as arrays.

The moment about a coordinate is the power, at unit speed of it, of what all bodies that it moves must be
given. Kept apart are the coordinate's motion (a screw), what the mass and the inertia of each body need, and
which bodies the coordinate moves. So what another load, another mass or another axis would do to the moments
is algebra on arrays, exact and without OpenSim. The sum is that of ``InverseDynamicsSolver``: constraints
are left out of account, coupled coordinates move as their couplers say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from wrapjax.errors import InputError
from wrapjax.osim.loading import import_opensim, initial_state, load_model
from wrapjax.osim.model import elements, unknown_names
from wrapjax.osim.motion import Motion, Mover

#: Where the entries of a tensor stand among OpenSim's six numbers, xx yy zz xy xz yz.
_TENSOR = ((0, 3, 4), (3, 1, 5), (4, 5, 2))


@dataclass(frozen=True)
class Mechanics:
    """Bodies of a model along a motion, in ground's frame.

    Wrenches are a moment about ground's origin (N m), then a force (N).

    Parameters
    ----------
    bodies, parents
        Names of all bodies, in the model's order, and of the body that carries each.
    coordinates
        Those whose moments are asked for.
    moves
        Whether a coordinate moves a body.
    screw
        Motion by unit speed of a coordinate: angular velocity (rad/rad), then the velocity of the point
        at ground's origin were it fixed to the bodies that move (m/rad).
    joint_center
        Where the joint of each coordinate is: the origin of its frame in the child body, m.
    rotation, origin
        Of each body; columns are its axes; m.
    of_mass
        Wrench that carries a body's mass and accelerates it.
    of_inertia
        Wrench that turns a body about its center of mass.
    """

    bodies: tuple[str, ...]
    parents: tuple[str, ...]
    coordinates: tuple[str, ...]
    moves: Bool[np.ndarray, "coordinate body"]
    screw: Float[np.ndarray, "coordinate 6 pose"]
    joint_center: Float[np.ndarray, "coordinate 3 pose"]
    rotation: Float[np.ndarray, "body 3 3 pose"]
    origin: Float[np.ndarray, "body 3 pose"]
    of_mass: Float[np.ndarray, "body 6 pose"]
    of_inertia: Float[np.ndarray, "body 6 pose"]

    def transmitted(
        self, loaded: Sequence[str], wrench: Float[np.ndarray, "load 6 pose"]
    ) -> Float[np.ndarray, "coordinate 6 pose"]:
        """Sum up what a joint hands on to all that it moves: what bodies need less what acts on them."""
        needed = np.einsum("kb,bwp->kwp", self.moves, self.of_mass + self.of_inertia)
        return needed - np.einsum("kl,lwp->kwp", self.moved(loaded), wrench)

    def moved(self, bodies: Sequence[str]) -> Bool[np.ndarray, "coordinate load"]:
        """Say whether a coordinate moves each of these bodies."""
        return self.moves[:, [self.bodies.index(name) for name in bodies]]

    def moments(self, wrench: Float[np.ndarray, "coordinate 6 pose"]) -> Float[np.ndarray, "coordinate pose"]:
        """Give the moment (N m; N about a translation) that a joint's wrench is about its coordinate."""
        return np.einsum("kwp,kwp->kp", self.screw, wrench)


@dataclass(frozen=True)
class JointShift:
    """A joint that is elsewhere than a model has it; at its coordinates' zero nothing has moved but that.

    A joint without frames of its own, which OpenSim writes for every joint, stays where it is.

    Parameters
    ----------
    coordinate
        One of the joint's.
    displacement
        Of both bodies' frames of the joint, with all that hangs on it, m.
    turn
        Of its axes, rad, small; about its center, which stays. Both in axes of the body that carries it.
    """

    coordinate: str
    displacement: Float[np.ndarray, " 3"]
    turn: Float[np.ndarray, " 3"]


def analyse_mechanics(
    model_file: Path | str,
    coordinates: Sequence[str],
    motion: Motion,
    shift: JointShift | None = None,
) -> Mechanics:
    """Move a model as recorded and read what inverse dynamics need.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    coordinates
        Whose moments are wanted.
    motion
        How it moved.
    shift
        A joint that is elsewhere.

    Raises
    ------
    InputError
        If the model cannot be loaded or does not know a coordinate.

    Notes
    -----
    About 0.3 ms a pose.
    """
    opensim = import_opensim()
    model, state = load_model(model_file)
    if shift is not None:
        state = _with_shifted_joint(opensim, model, state, shift)
    entries = {entry.getName(): entry for entry in elements(model.getCoordinateSet())}
    problems = unknown_names(model_file, "coordinate", (*coordinates, *motion.coordinates), list(entries))
    if problems:
        raise InputError(problems)
    mover = Mover(opensim, model, state, [entries[name] for name in motion.coordinates])
    bodies = tuple(elements(model.getBodySet()))
    index = [int(body.getMobilizedBodyIndex()) for body in bodies]
    joints = {name: entries[name].getJoint() for name in coordinates}
    names = tuple(body.getName() for body in bodies)
    parents = _parents(model)
    child = {name: joint.getChildFrame().findBaseFrame().getName() for name, joint in joints.items()}
    columns = [mover.column(entries[name]) for name in coordinates]
    rows = [index[names.index(child[name])] for name in coordinates]

    count = motion.values.shape[1]
    jacobian = np.zeros((count, len(coordinates), 6))
    center = np.zeros((count, len(coordinates), 3))
    rotation, origin = np.zeros((count, len(bodies), 3, 3)), np.zeros((count, len(bodies), 3))
    spin, accelerations = np.zeros((count, len(bodies), 3)), np.zeros((count, len(bodies), 6))
    found, accelerated = opensim.Matrix(), opensim.VectorOfSpatialVec()
    matter = model.getMatterSubsystem()
    for pose in range(count):
        rates = mover.move(motion.values[:, pose], motion.speeds[:, pose], motion.accelerations[:, pose])
        matter.calcSystemJacobian(state, found)
        whole = found.to_numpy()
        matter.calcBodyAccelerationFromUDot(state, rates, accelerated)
        for place, (row, column) in enumerate(zip(rows, columns, strict=True)):
            jacobian[pose, place] = whole[6 * row : 6 * row + 6, column]
        for place, name in enumerate(coordinates):
            center[pose, place] = joints[name].getChildFrame().getPositionInGround(state).to_numpy()
        for place, body in enumerate(bodies):
            transform, acceleration = body.getTransformInGround(state), accelerated.get(index[place])
            axes = transform.R().asMat33()
            rotation[pose, place] = [[axes.get(i, j) for j in range(3)] for i in range(3)]
            origin[pose, place] = transform.p().to_numpy()
            spin[pose, place] = body.getAngularVelocityInGround(state).to_numpy()
            accelerations[pose, place, :3] = acceleration.get(0).to_numpy()
            accelerations[pose, place, 3:] = acceleration.get(1).to_numpy()

    at = origin[:, [names.index(child[name]) for name in coordinates]]
    turning = jacobian[..., :3]
    screw = np.concatenate([turning, jacobian[..., 3:] - np.cross(turning, at)], axis=-1)
    gravity = model.getGravity().to_numpy()
    of_mass, of_inertia = _needed(bodies, rotation, origin, spin, accelerations, gravity)
    moves = [[child[name] in _carriers(body, parents) for body in names] for name in coordinates]
    return Mechanics(
        bodies=names,
        parents=tuple(parents[name] for name in names),
        coordinates=tuple(coordinates),
        moves=np.array(moves),
        screw=np.moveaxis(screw, 0, -1),
        joint_center=np.moveaxis(center, 0, -1),
        rotation=np.moveaxis(rotation, 0, -1),
        origin=np.moveaxis(origin, 0, -1),
        of_mass=np.moveaxis(of_mass, 0, -1),
        of_inertia=np.moveaxis(of_inertia, 0, -1),
    )


def _with_shifted_joint(opensim: Any, model: Any, state: Any, shift: JointShift) -> Any:
    """Put a joint elsewhere in a model and build its system anew; give its state."""
    joint = model.getCoordinateSet().get(shift.coordinate).getJoint()
    paths = [frame.getAbsolutePathString() for frame in (joint.getParentFrame(), joint.getChildFrame())]
    near, far = (opensim.PhysicalOffsetFrame.safeDownCast(model.updComponent(path)) for path in paths)
    if near is None or far is None:
        return state
    before, own = (Rotation.from_euler("XYZ", frame.get_orientation().to_numpy()) for frame in (near, far))
    turn = Rotation.from_rotvec(shift.turn)
    # The far body's axes at zero, in those of the near one.
    at_zero = before * own.inv()
    for frame, turned in ((near, turn * before), (far, at_zero.inv() * turn * at_zero * own)):
        frame.set_orientation(opensim.Vec3(*turned.as_euler("XYZ").tolist()))
    near.set_translation(opensim.Vec3(*(near.get_translation().to_numpy() + shift.displacement).tolist()))
    return initial_state(model)


def _parents(model: Any) -> dict[str, str]:
    """Name the body that carries each body."""
    return {
        joint.getChildFrame().findBaseFrame().getName(): joint.getParentFrame().findBaseFrame().getName()
        for joint in elements(model.getJointSet())
    }


def _carriers(body: str, parents: dict[str, str]) -> set[str]:
    """Name the body and all between it and ground."""
    found = set()
    while body in parents:
        found.add(body)
        body = parents[body]
    return found


def _needed(
    bodies: Sequence[Any],
    rotation: Float[np.ndarray, "pose body 3 3"],
    origin: Float[np.ndarray, "pose body 3"],
    spin: Float[np.ndarray, "pose body 3"],
    accelerations: Float[np.ndarray, "pose body 6"],
    gravity: Float[np.ndarray, " 3"],
) -> tuple[Float[np.ndarray, "pose body 6"], Float[np.ndarray, "pose body 6"]]:
    """Newton's and Euler's equations of each body, as wrenches about ground's origin."""
    mass = np.array([body.getMass() for body in bodies])
    center = np.array([body.getMassCenter().to_numpy() for body in bodies])
    vectors = [[body.get_inertia().get(row) for row in range(6)] for body in bodies]
    inertia = np.array([np.array(vector)[np.array(_TENSOR)] for vector in vectors])

    arm = np.einsum("pbij,bj->pbi", rotation, center)
    turning = accelerations[..., :3]
    of_center = accelerations[..., 3:] + np.cross(turning, arm) + np.cross(spin, np.cross(spin, arm))
    force = mass[:, None] * (of_center - gravity)
    of_mass = np.concatenate([np.cross(origin + arm, force), force], axis=-1)

    tensor = np.einsum("pbij,bjk,pblk->pbil", rotation, inertia, rotation)
    momentum = np.einsum("pbij,pbj->pbi", tensor, spin)
    moment = np.einsum("pbij,pbj->pbi", tensor, turning) + np.cross(spin, momentum)
    return of_mass, np.concatenate([moment, np.zeros_like(moment)], axis=-1)
