"""Joint reactions of a recorded motion by OpenSim, with given muscle forces along OpenSim's own paths.

Bodies move as recorded: actuators at the coordinates add the difference between the joint moments of the
motion and those of the muscles. Such an actuator exerts a moment about its coordinate only, so that the
contact force in a joint depends on motion, external loads and muscle forces alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import elements, unknown_names
from wrapjax.osim.motion import Motion, Mover

# Classes of OpenSim whose activation and tendon dynamics can be left out; Thelen's refuses it.
_MAY_IGNORE_DYNAMICS = ("DeGrooteFregly2016Muscle", "Millard2012EquilibriumMuscle")


class JointReactions(NamedTuple):
    """Forces and moments that the two bodies of joints exert on each other.

    Parameters
    ----------
    on_parent
        Force of the child body on the parent body, N, along x, y and z of the parent body.
    on_child
        Moment (N m) about the joint's center, then force (N), of the parent body on the child body, along x,
        y and z of the child body.
    """

    on_parent: Float[np.ndarray, "joint 3 pose"]
    on_child: Float[np.ndarray, "joint 6 pose"]


def analyse_joint_reactions(
    model_file: Path | str,
    joints: Sequence[str],
    motion: Motion,
    loaded: Sequence[str],
    wrench: Float[np.ndarray, "load 6 pose"],
    muscles: Sequence[str],
    forces: Float[np.ndarray, "muscle pose"],
) -> JointReactions:
    """Compute the forces and moments that the two bodies of each joint exert on each other.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    joints
        Names of the joints.
    motion
        Motion of every coordinate between ground and the bodies below these joints.
    loaded, wrench
        Names of bodies with external loads, and the loads: moment about ground's origin (N m), then force
        (N), in ground's frame.
    muscles, forces
        Names of muscles, and their tendon forces (N). Of all other forces only gravity is included.

    Raises
    ------
    InputError
        If the model cannot be loaded, has no part of a given name, or a muscle's path is not made of points.
        Such a path has moment arms, but no line of action.
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    _check_names(model, model_file, joints, motion.coordinates, loaded, muscles)
    actuated = _keep_muscles(model, muscles)
    _add_loads(opensim, model, loaded, wrench)
    closing = _add_closing_actuators(opensim, model)
    state = model.initSystem()
    for coordinate in elements(model.getCoordinateSet()):
        # Assembly by OpenSim may have changed coordinates slightly.
        coordinate.setValue(state, coordinate.getDefaultValue(), False)
    for actuator in (*actuated, *closing):
        actuator.overrideActuation(state, True)

    entries = {entry.getName(): entry for entry in elements(model.getCoordinateSet())}
    mover = Mover(opensim, model, state, [entries[name] for name in motion.coordinates])
    columns = [mover.column(actuator.getCoordinate()) for actuator in closing]
    solver = opensim.InverseDynamicsSolver(model)
    selected = [model.getJointSet().get(name) for name in joints]
    poses = motion.values.shape[1]
    found = JointReactions(np.zeros((len(joints), 3, poses)), np.zeros((len(joints), 6, poses)))
    for pose in range(poses):
        # Loads are functions of time, for which the number of the pose is used.
        state.setTime(float(pose))
        rates = mover.move(motion.values[:, pose], motion.speeds[:, pose], motion.accelerations[:, pose])
        for actuator, force in zip(actuated, forces[:, pose], strict=True):
            actuator.setOverrideActuation(state, float(force))
        for actuator in closing:
            actuator.setOverrideActuation(state, 0.0)
        missing = solver.solve(state, opensim.Vector.createFromMat(rates))
        for actuator, column in zip(closing, columns, strict=True):
            actuator.setOverrideActuation(state, missing.get(column))
        model.realizeAcceleration(state)
        for place, joint in enumerate(selected):
            on_parent = joint.calcReactionOnParentExpressedInGround(state).get(1).to_numpy()
            found.on_parent[place, :, pose] = _axes(joint.getParentFrame(), state).T @ on_parent
            on_child = joint.calcReactionOnChildExpressedInGround(state)
            axes = _axes(joint.getChildFrame(), state)
            found.on_child[place, :, pose] = np.concatenate(
                [axes.T @ on_child.get(part).to_numpy() for part in (0, 1)]
            )
    return found


def _axes(frame: Any, state: Any) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix in ground of the body that a frame is on; columns are the body's axes."""
    axes = frame.findBaseFrame().getTransformInGround(state).R().asMat33()
    return np.array([[axes.get(i, j) for j in range(3)] for i in range(3)])


def _check_names(
    model: Any,
    model_file: Path | str,
    joints: Sequence[str],
    coordinates: Sequence[str],
    loaded: Sequence[str],
    muscles: Sequence[str],
) -> None:
    known = {
        "joint": (joints, model.getJointSet()),
        "coordinate": (coordinates, model.getCoordinateSet()),
        "body": (loaded, model.getBodySet()),
        "muscle": (muscles, model.getMuscles()),
    }
    problems: list[Problem] = []
    for what, (names, entries) in known.items():
        listed = [entry.getName() for entry in elements(entries)]
        problems += unknown_names(model_file, what, names, listed)
    for muscle in elements(model.getMuscles()):
        kind = muscle.getPath().getConcreteClassName()
        if muscle.getName() in muscles and kind != "GeometryPath":
            message = f"has a {kind}, where a path of points was expected: joint reactions need"
            problems.append(Problem(str(model_file), f"{message} its line of action", place=muscle.getName()))
    if problems:
        raise InputError(problems)


def _keep_muscles(model: Any, muscles: Sequence[str]) -> list[Any]:
    """Disable all forces but the given muscles, and the activation and tendon dynamics of these if possible.

    Their forces are given, so that dynamics have no influence, but would be states of the system.
    """
    for force in elements(model.getForceSet()):
        force.set_appliesForce(force.getName() in muscles)
    selected = [model.getMuscles().get(name) for name in muscles]
    for muscle in selected:
        if muscle.getConcreteClassName() not in _MAY_IGNORE_DYNAMICS:
            continue
        muscle.set_ignore_activation_dynamics(True)
        muscle.set_ignore_tendon_compliance(True)
    return selected


def _add_loads(
    opensim: Any, model: Any, loaded: Sequence[str], wrench: Float[np.ndarray, "load 6 pose"]
) -> None:
    """Add a prescribed force to the model for each external load."""
    for number, (name, load) in enumerate(zip(loaded, wrench, strict=True)):
        force = opensim.PrescribedForce(f"load_{number}", model.getBodySet().get(name))
        force.set_forceIsGlobal(True)
        force.set_pointIsGlobal(True)
        functions = [_interpolating_function(opensim, row) for row in load]
        force.setTorqueFunctions(*functions[:3])
        force.setForceFunctions(*functions[3:])
        force.setPointFunctions(*(opensim.Constant(0.0) for _ in range(3)))
        model.addForce(force)


def _interpolating_function(opensim: Any, values: Float[np.ndarray, " pose"]) -> Any:
    """Create a piecewise linear function with the given values at 0, 1, 2 ..."""
    function = opensim.PiecewiseLinearFunction()
    for place, value in enumerate(values):
        function.addPoint(float(place), float(value))
    return function


def _add_closing_actuators(opensim: Any, model: Any) -> list[Any]:
    """Add an actuator to each coordinate that can exert any moment or force."""
    added = []
    for coordinate in elements(model.getCoordinateSet()):
        actuator = opensim.CoordinateActuator(coordinate.getName())
        actuator.setName(f"closing_{coordinate.getName()}")
        actuator.setOptimalForce(1.0)
        model.addForce(actuator)
        added.append(actuator)
    return added
