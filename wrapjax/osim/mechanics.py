"""Terms of inverse dynamics of a recorded motion, from which effects of changed inputs are computed.

The joint moment about a coordinate is the power, per unit speed of the coordinate, of the wrenches that the
bodies it moves require. The arrays hold the screw of each coordinate, the wrenches required by mass and by
rotational inertia of each body, and which bodies a coordinate moves. The effect of other loads, masses or
axes on the joint moments then follows by algebra, exactly and without OpenSim. The result equals that of
``InverseDynamicsSolver``: constraints are ignored, and coupled coordinates follow their couplers.
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

# Index of each entry of an inertia tensor among OpenSim's six numbers xx, yy, zz, xy, xz, yz.
_TENSOR = ((0, 3, 4), (3, 1, 5), (4, 5, 2))


@dataclass(frozen=True)
class Mechanics:
    """Terms of inverse dynamics along a motion, in ground's frame.

    Wrenches consist of a moment about ground's origin (N m) and a force (N), in this order.

    Parameters
    ----------
    bodies, parents
        Names of all bodies in the model's order, and of each body's parent.
    coordinates
        Names of the coordinates of the joint moments.
    moves
        Whether a coordinate moves a body.
    screw
        Motion per unit speed of a coordinate: angular velocity (rad/rad), then the velocity of the body-fixed
        point at ground's origin (m/rad).
    joint_center
        Origin of the child frame of each coordinate's joint, m.
    rotation, origin
        Rotation matrix of each body, whose columns are its axes, and its origin (m).
    mass_wrench
        Wrench required by a body's mass, against gravity and for the acceleration of its center of mass.
    inertia_wrench
        Wrench required by a body's rotational inertia about its center of mass.
    """

    bodies: tuple[str, ...]
    parents: tuple[str, ...]
    coordinates: tuple[str, ...]
    moves: Bool[np.ndarray, "coordinate body"]
    screw: Float[np.ndarray, "coordinate 6 pose"]
    joint_center: Float[np.ndarray, "coordinate 3 pose"]
    rotation: Float[np.ndarray, "body 3 3 pose"]
    origin: Float[np.ndarray, "body 3 pose"]
    mass_wrench: Float[np.ndarray, "body 6 pose"]
    inertia_wrench: Float[np.ndarray, "body 6 pose"]

    def transmitted(
        self, loaded: Sequence[str], wrench: Float[np.ndarray, "load 6 pose"]
    ) -> Float[np.ndarray, "coordinate 6 pose"]:
        """Compute the wrench that each coordinate's joint transmits to the bodies that it moves.

        Parameters
        ----------
        loaded
            Names of bodies with external loads.
        wrench
            External load on each of them.

        Returns
        -------
        Array
            Wrenches required by the bodies less the external loads on them.
        """
        required = np.einsum("kb,bwp->kwp", self.moves, self.mass_wrench + self.inertia_wrench)
        return required - np.einsum("kl,lwp->kwp", self.moves_bodies(loaded), wrench)

    def moves_bodies(self, bodies: Sequence[str]) -> Bool[np.ndarray, "coordinate load"]:
        """Select the columns of ``moves`` of the given bodies."""
        return self.moves[:, [self.bodies.index(name) for name in bodies]]

    def moments(self, wrench: Float[np.ndarray, "coordinate 6 pose"]) -> Float[np.ndarray, "coordinate pose"]:
        """Compute the moment (N m; N along a translation) of each joint's wrench about its coordinate."""
        return np.einsum("kwp,kwp->kp", self.screw, wrench)


@dataclass(frozen=True)
class JointShift:
    """Change of a joint's center and axes relative to the model.

    The rotation of the axes moves no body at zero of the joint's coordinates. A joint without offset frames
    is left unchanged; OpenSim writes them for every joint.

    Parameters
    ----------
    coordinate
        Name of a coordinate of the joint.
    displacement
        Displacement of the joint and of all bodies below it, in axes of the parent body, m.
    turn
        Small rotation vector of the joint's axes about its center, in axes of the parent body, rad.
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
    """Compute the terms of inverse dynamics of a model along a recorded motion.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    coordinates
        Names of the coordinates of the joint moments.
    motion
        Recorded motion.
    shift
        Change of a joint; None for the model as it is.

    Raises
    ------
    InputError
        If the model cannot be loaded or has no such coordinate.

    Notes
    -----
    Takes about 0.3 ms a pose.
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
    children = [names.index(child[name]) for name in coordinates]

    count, rows_of = motion.values.shape[1], 6 * np.array(index)[:, None] + np.arange(6)
    of_all_bodies, bias_of_all_bodies = opensim.Matrix(), opensim.Vector()
    jacobian = np.zeros((count, len(coordinates), 6))
    center = np.zeros((count, len(coordinates), 3))
    quaternion, origin = np.zeros((count, len(bodies), 4)), np.zeros((count, len(bodies), 3))
    spin, accelerations = np.zeros((count, len(bodies), 3)), np.zeros((count, len(bodies), 6))
    matter, frames = model.getMatterSubsystem(), [joint.getChildFrame() for joint in joints.values()]
    # Calls of OpenSim take most of the time: what one matrix of all bodies gives is not asked body by body.
    for pose in range(count):
        rates = mover.move(motion.values[:, pose], motion.speeds[:, pose], motion.accelerations[:, pose])
        matter.calcSystemJacobian(state, of_all_bodies)
        matter.calcBiasForSystemJacobian(state, bias_of_all_bodies)
        all_rows, bias = of_all_bodies.to_numpy(), bias_of_all_bodies.to_numpy()
        jacobian[pose] = all_rows[rows_of[children], np.array(columns)[:, None]]
        spin[pose] = (all_rows @ state.getU().to_numpy())[rows_of[:, :3]]
        accelerations[pose] = (all_rows @ rates + bias)[rows_of]
        for place, frame in enumerate(frames):
            center[pose, place] = frame.getPositionInGround(state).to_numpy()
        for place, body in enumerate(bodies):
            transform = body.getTransformInGround(state)
            parts = transform.R().convertRotationToQuaternion()
            quaternion[pose, place] = [parts.get(part) for part in (1, 2, 3, 0)]
            origin[pose, place] = transform.p().to_numpy()
    rotation = Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix().reshape(count, len(bodies), 3, 3)

    at = origin[:, children]
    turning = jacobian[..., :3]
    screw = np.concatenate([turning, jacobian[..., 3:] - np.cross(turning, at)], axis=-1)
    gravity = model.getGravity().to_numpy()
    mass_wrench, inertia_wrench = _required_wrenches(bodies, rotation, origin, spin, accelerations, gravity)
    moves = [[child[name] in _chain(body, parents) for body in names] for name in coordinates]
    return Mechanics(
        bodies=names,
        parents=tuple(parents[name] for name in names),
        coordinates=tuple(coordinates),
        moves=np.array(moves),
        screw=np.moveaxis(screw, 0, -1),
        joint_center=np.moveaxis(center, 0, -1),
        rotation=np.moveaxis(rotation, 0, -1),
        origin=np.moveaxis(origin, 0, -1),
        mass_wrench=np.moveaxis(mass_wrench, 0, -1),
        inertia_wrench=np.moveaxis(inertia_wrench, 0, -1),
    )


def _with_shifted_joint(opensim: Any, model: Any, state: Any, shift: JointShift) -> Any:
    """Change a joint of a model and rebuild its system; return the new state."""
    joint = model.getCoordinateSet().get(shift.coordinate).getJoint()
    paths = [frame.getAbsolutePathString() for frame in (joint.getParentFrame(), joint.getChildFrame())]
    in_parent, in_child = (
        opensim.PhysicalOffsetFrame.safeDownCast(model.updComponent(path)) for path in paths
    )
    if in_parent is None or in_child is None:
        return state
    parent, child = (
        Rotation.from_euler("XYZ", frame.get_orientation().to_numpy()) for frame in (in_parent, in_child)
    )
    turn = Rotation.from_rotvec(shift.turn)
    # Axes of the child body at zero of the coordinates, in those of the parent body.
    at_zero = parent * child.inv()
    for frame, rotated in ((in_parent, turn * parent), (in_child, at_zero.inv() * turn * at_zero * child)):
        frame.set_orientation(opensim.Vec3(*rotated.as_euler("XYZ").tolist()))
    translation = in_parent.get_translation().to_numpy() + shift.displacement
    in_parent.set_translation(opensim.Vec3(*translation.tolist()))
    return initial_state(model)


def _parents(model: Any) -> dict[str, str]:
    """Find the name of each body's parent."""
    return {
        joint.getChildFrame().findBaseFrame().getName(): joint.getParentFrame().findBaseFrame().getName()
        for joint in elements(model.getJointSet())
    }


def _chain(body: str, parents: dict[str, str]) -> set[str]:
    """Find the names of a body and of all bodies between it and ground."""
    chain = set()
    while body in parents:
        chain.add(body)
        body = parents[body]
    return chain


def _required_wrenches(
    bodies: Sequence[Any],
    rotation: Float[np.ndarray, "pose body 3 3"],
    origin: Float[np.ndarray, "pose body 3"],
    spin: Float[np.ndarray, "pose body 3"],
    accelerations: Float[np.ndarray, "pose body 6"],
    gravity: Float[np.ndarray, " 3"],
) -> tuple[Float[np.ndarray, "pose body 6"], Float[np.ndarray, "pose body 6"]]:
    """Compute the wrenches about ground's origin that each body requires by the Newton-Euler equations."""
    mass = np.array([body.getMass() for body in bodies])
    center = np.array([body.getMassCenter().to_numpy() for body in bodies])
    vectors = [[body.get_inertia().get(row) for row in range(6)] for body in bodies]
    inertia = np.array([np.array(vector)[np.array(_TENSOR)] for vector in vectors])

    arm = np.einsum("pbij,bj->pbi", rotation, center)
    turning = accelerations[..., :3]
    of_center = accelerations[..., 3:] + np.cross(turning, arm) + np.cross(spin, np.cross(spin, arm))
    force = mass[:, None] * (of_center - gravity)
    mass_wrench = np.concatenate([np.cross(origin + arm, force), force], axis=-1)

    tensor = np.einsum("pbij,bjk,pblk->pbil", rotation, inertia, rotation)
    momentum = np.einsum("pbij,pbj->pbi", tensor, spin)
    moment = np.einsum("pbij,pbj->pbi", tensor, turning) + np.cross(spin, momentum)
    return mass_wrench, np.concatenate([moment, np.zeros_like(moment)], axis=-1)
