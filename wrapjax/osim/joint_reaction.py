"""OpenSim's joint reactions of a recorded motion, with given muscle forces along OpenSim's own paths.

Bodies are made to move as recorded: whatever muscles lack of the moments that this needs is added at the
coordinates themselves. Such a moment turns bodies and presses nothing, so that the force in a joint depends
on motion, loads and muscle forces alone.
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


class JointReactions(NamedTuple):
    """What holds joints together.

    Parameters
    ----------
    on_parent
        Force of the child body on the parent, N, along x, y and z of the parent (of ground, where that is
        the parent).
    on_child
        Moment (N m) about the joint's center, then force (N), of the parent on the child, along x, y and z of
        the child.
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
    """Compute what each joint's two bodies put on one another.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    joints
        Names.
    motion
        Of every coordinate between ground and the bodies below these joints.
    loaded, wrench
        Bodies on which something acts from outside, and what: moment about ground's origin (N m), then force
        (N), in ground's frame.
    muscles, forces
        Forces along the tendon, N. All other forces of the model but gravity are left out.

    Raises
    ------
    InputError
        If the model cannot be loaded, does not know a name, or has a muscle without points: OpenSim knows
        what such a muscle's moments are, not where it pulls.
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    _check_names(model, model_file, joints, motion.coordinates, loaded, muscles)
    pulling = _keep_muscles(model, muscles)
    _add_loads(opensim, model, loaded, wrench)
    closing = _add_closing_actuators(opensim, model)
    state = model.initSystem()
    for coordinate in elements(model.getCoordinateSet()):
        # While it assembled the model, OpenSim may have moved coordinates a little.
        coordinate.setValue(state, coordinate.getDefaultValue(), False)
    for actuator in (*pulling, *closing):
        actuator.overrideActuation(state, True)

    entries = {entry.getName(): entry for entry in elements(model.getCoordinateSet())}
    mover = Mover(opensim, model, state, [entries[name] for name in motion.coordinates])
    columns = [mover.column(actuator.getCoordinate()) for actuator in closing]
    solver = opensim.InverseDynamicsSolver(model)
    measured = [model.getJointSet().get(name) for name in joints]
    poses = motion.values.shape[1]
    found = JointReactions(np.zeros((len(joints), 3, poses)), np.zeros((len(joints), 6, poses)))
    for pose in range(poses):
        # Loads are functions of the pose's number in place of time.
        state.setTime(float(pose))
        rates = mover.move(motion.values[:, pose], motion.speeds[:, pose], motion.accelerations[:, pose])
        for actuator, force in zip(pulling, forces[:, pose], strict=True):
            actuator.setOverrideActuation(state, float(force))
        for actuator in closing:
            actuator.setOverrideActuation(state, 0.0)
        lacking = solver.solve(state, rates)
        for actuator, column in zip(closing, columns, strict=True):
            actuator.setOverrideActuation(state, lacking.get(column))
        model.realizeAcceleration(state)
        for place, joint in enumerate(measured):
            on_parent = joint.calcReactionOnParentExpressedInGround(state).get(1).to_numpy()
            found.on_parent[place, :, pose] = _axes(joint.getParentFrame(), state).T @ on_parent
            on_child = joint.calcReactionOnChildExpressedInGround(state)
            axes = _axes(joint.getChildFrame(), state)
            found.on_child[place, :, pose] = np.concatenate(
                [axes.T @ on_child.get(part).to_numpy() for part in (0, 1)]
            )
    return found


def _axes(frame: Any, state: Any) -> Float[np.ndarray, "3 3"]:
    """Give the axes of the body that a frame is on, in ground, as columns."""
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
            message = f"has a {kind}, where a path of points was expected: joint reactions need to know"
            problems.append(Problem(str(model_file), f"{message} where it pulls", place=muscle.getName()))
    if problems:
        raise InputError(problems)


def _keep_muscles(model: Any, muscles: Sequence[str]) -> list[Any]:
    """Switch off all forces but these muscles, and take from these what states they have."""
    for force in elements(model.getForceSet()):
        force.set_appliesForce(force.getName() in muscles)
    kept = [model.getMuscles().get(name) for name in muscles]
    for muscle in kept:
        muscle.set_ignore_activation_dynamics(True)
        muscle.set_ignore_tendon_compliance(True)
    return kept


def _add_loads(
    opensim: Any, model: Any, loaded: Sequence[str], wrench: Float[np.ndarray, "load 6 pose"]
) -> None:
    for number, (name, load) in enumerate(zip(loaded, wrench, strict=True)):
        force = opensim.PrescribedForce(f"load_{number}", model.getBodySet().get(name))
        force.set_forceIsGlobal(True)
        force.set_pointIsGlobal(True)
        functions = [_through(opensim, row) for row in load]
        force.setTorqueFunctions(*functions[:3])
        force.setForceFunctions(*functions[3:])
        force.setPointFunctions(*(opensim.Constant(0.0) for _ in range(3)))
        model.addForce(force)


def _through(opensim: Any, values: Float[np.ndarray, " pose"]) -> Any:
    """Make a function that has these values at 0, 1, 2 ..."""
    function = opensim.PiecewiseLinearFunction()
    for place, value in enumerate(values):
        function.addPoint(float(place), float(value))
    return function


def _add_closing_actuators(opensim: Any, model: Any) -> list[Any]:
    """Add to each coordinate what can give it any moment or force."""
    added = []
    for coordinate in elements(model.getCoordinateSet()):
        actuator = opensim.CoordinateActuator(coordinate.getName())
        actuator.setName(f"closing_{coordinate.getName()}")
        actuator.setOptimalForce(1.0)
        model.addForce(actuator)
        added.append(actuator)
    return added
