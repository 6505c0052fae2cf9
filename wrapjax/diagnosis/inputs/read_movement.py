"""Recorded movement of a subject, from its motion, ground reaction forces and external loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.diagnosis.inputs.recorded_movement import RecordedMovement
from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.osim.mechanics import analyse_mechanics
from wrapjax.osim.model import describe_model
from wrapjax.osim.motion import Motion
from wrapjax.subject.external_loads import GroundLoads, read_ground_loads
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

#: Latency in the central difference that gives its derivative, s: half a prior standard deviation.
_LATENCY = 0.005


def read_recorded_movement(
    subject: Subject, gait: RecordedMovement | None = None
) -> tuple[RecordedMovement | None, str]:
    """Read the recorded movement of all cycles, or of all windows of another movement.

    Parameters
    ----------
    subject
        Subject whose trials name ground reaction forces and external loads, and whose angles hold every
        coordinate from ground to the foot.
    gait
        Recorded gait of the same leg, if the trials are another movement.

    Returns
    -------
    movement
        Recorded movement; None where the recording lacks something.
    reason
        What is missing; empty where nothing is.

    Raises
    ------
    InputError
        If the files of forces are invalid, or name bodies that the model does not have.
    """
    reason = _missing_files(subject)
    if reason:
        return None, reason
    loads = {trial.name: read_ground_loads(trial) for trial in subject.recordings}
    model = _read_structure(subject.model_file)
    _check_bodies(subject, model, loads)
    bodies = dict.fromkeys(body for entry in loads.values() for body in entry.bodies)
    loaded = _bodies_of_leg(subject, model, bodies)
    if not loaded:
        return None, "no ground reaction forces act on this leg in these trials"
    reason = _missing_angles(subject, model, loaded)
    return (None, reason) if reason else (_assemble(subject, model, loads, loaded, gait), "")


@dataclass(frozen=True)
class _Structure:
    """Coordinates of a model: those between each body and ground, the locked ones, the coupled ones."""

    above: dict[str, tuple[str, ...]]
    locked: frozenset[str]
    coupled: frozenset[str]


def _read_structure(model_file: Path) -> _Structure:
    model = describe_model(model_file)
    return _Structure(
        above={joint.child_body: model.coordinates_above(joint.child_body) for joint in model.joints},
        locked=frozenset(entry.name for entry in model.coordinates if entry.locked),
        coupled=frozenset(entry.name for entry in model.coordinates if entry.coupled_to),
    )


def _missing_files(subject: Subject) -> str:
    """Name the kind of file that is missing; empty where none is."""
    if any(trial.ground_forces is None for trial in subject.recordings):
        return "no ground reaction forces are given for these trials"
    if any(trial.external_loads is None for trial in subject.recordings):
        return "no external loads are given, which say on what body the ground reaction forces act"
    return ""


def _check_bodies(subject: Subject, model: _Structure, loads: Mapping[str, GroundLoads]) -> None:
    problems = [
        Problem(
            str(trial.external_loads),
            f"the model {subject.model_file} has no such body",
            f"<applied_to_body> {body}",
            nearest_name(body, tuple(model.above)),
        )
        for trial in subject.recordings
        for body in loads[trial.name].bodies
        if body not in model.above
    ]
    if problems:
        raise InputError(dict.fromkeys(problems))


def _bodies_of_leg(subject: Subject, model: _Structure, bodies: dict[str, None]) -> tuple[str, ...]:
    """Select the bodies that a moment coordinate of this leg moves."""
    coordinates = set(subject.trials.moment_coordinates)
    return tuple(body for body in bodies if coordinates & set(model.above[body]))


def _missing_angles(subject: Subject, model: _Structure, loaded: tuple[str, ...]) -> str:
    """Name the coordinates between ground and the foot that were not recorded; empty where all were."""
    missing = dict.fromkeys(
        name
        for body in loaded
        for name in model.above[body]
        if name not in subject.trials.coordinates and name not in model.coupled and name not in model.locked
    )
    if not missing:
        return ""
    return f"the angles of these trials lack {', '.join(missing)}, which inverse dynamics need"


def _assemble(
    subject: Subject,
    model: _Structure,
    loads: Mapping[str, GroundLoads],
    loaded: tuple[str, ...],
    gait: RecordedMovement | None,
) -> RecordedMovement:
    trials = subject.trials

    def wrenches(latency: float) -> Float[np.ndarray, "load 6 pose"]:
        return np.stack([_total_wrench(trials, loads, (body,), latency) for body in loaded])

    recorded = wrenches(0.0)
    others = tuple({body for entry in loads.values() for body in entry.bodies} - set(loaded))
    analyse = partial(analyse_mechanics, subject.model_file, trials.moment_coordinates)
    motion = _read_motion(subject, model)
    return RecordedMovement(
        side=subject.side,
        time=trials.time,
        motion=motion,
        mechanics=analyse(motion),
        loaded_bodies=loaded,
        wrenches=recorded,
        # Forces recorded later by a latency have, at each frame, the values of that much earlier.
        wrenches_by_latency=(wrenches(_LATENCY) - wrenches(-_LATENCY)) / (2.0 * _LATENCY),
        other_wrench=_total_wrench(trials, loads, others, 0.0) if others else None,
        analyse=analyse,
        gait=gait,
    )


def _total_wrench(
    trials: Trials, loads: Mapping[str, GroundLoads], bodies: tuple[str, ...], latency: float
) -> Float[np.ndarray, "6 pose"]:
    """Sum the wrenches on bodies, at a time (s) before each frame of each cycle."""
    total = np.zeros((6, *trials.time.shape))
    recordings = np.array(trials.recordings)
    for name, entry in loads.items():
        rows = recordings == name
        acting = [row for row, body in enumerate(entry.bodies) if body in bodies]
        total[:, rows] = entry.at(trials.time[rows] - latency)[acting].sum(axis=0)
    return total.reshape(6, -1)


def _read_motion(subject: Subject, model: _Structure) -> Motion:
    """Assemble the recorded motion of the coordinates that are not coupled to others."""
    trials = subject.trials
    chosen = [row for row, name in enumerate(trials.coordinates) if name not in model.coupled]
    values, speeds = trials.angles[:, chosen], trials.angular_velocities[:, chosen]
    accelerations = np.zeros_like(values)
    for number, time in enumerate(trials.time):
        accelerations[number] = CubicSpline(time, speeds[number], axis=1)(time, 1)

    def by_pose(
        signals: Float[np.ndarray, "trial coordinate frame"],
    ) -> Float[np.ndarray, "coordinate pose"]:
        return np.moveaxis(signals, 1, 0).reshape(len(chosen), -1)

    names = tuple(trials.coordinates[row] for row in chosen)
    return Motion(names, by_pose(values), by_pose(speeds), by_pose(accelerations))
