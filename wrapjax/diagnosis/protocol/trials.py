"""Trials that a laboratory could record next: motion, posture and effort of each, from the model alone.

Each trial is a few smooth movements of one joint after the other: passive rotations through the range of a
joint, isometric ramps at several angles, a squat. Ranges are those of the model, within limits chosen here
that healthy adults reach (Soucie et al. 2011, Haemophilia 17, 500-507).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.subject.trials import MOVEMENT

#: Effort of isometric ramps: share of a maximum voluntary contraction.
RAMP_EFFORT = 0.6
#: Angles of isometric ramps, as shares of the range of the joint.
RAMP_ANGLES = (0.15, 0.5, 0.85)
#: Duration of a ramp up and down, and of a squat, s.
RAMP_SECONDS, SQUAT_SECONDS = 6.0, 4.0
#: Mean angular velocities of slow and fast passive rotations, rad/s.
SLOW, FAST = np.radians(15.0), np.radians(120.0)

# Passive range by the start of a coordinate's name, degrees; of the knee, flexion is positive here.
_RANGES = {
    "hip_flexion": (-10.0, 110.0),
    "hip_adduction": (-30.0, 20.0),
    "hip_rotation": (-30.0, 30.0),
    "knee_angle": (0.0, 120.0),
    "ankle_angle": (-40.0, 20.0),
    "subtalar_angle": (-20.0, 20.0),
}
# Coordinates without a range above stay within these limits, degrees.
_OTHER_RANGE = (-45.0, 45.0)
_JOINTS = {
    "hip_flexion": "hip, in flexion and extension",
    "hip_adduction": "hip, in abduction and adduction",
    "hip_rotation": "hip, in rotation",
    "knee_angle": "knee",
    "ankle_angle": "ankle",
    "subtalar_angle": "subtalar joint",
}
# Posture of the other joints while this one is examined, degrees.
_POSTURES = {"hip_flexion": {"knee_angle": 45.0}, "knee_angle": {"hip_flexion": 80.0}}
# Joints with ramps and slow and fast rotations; where a model has none of them, all of its coordinates.
_STRONG = ("hip_flexion", "knee_angle", "ankle_angle")
# Largest angle of a squat (degrees), and the effort of the muscles that extend each joint.
_SQUAT = {"hip_flexion": (80.0, 0.4), "knee_angle": (100.0, 0.5), "ankle_angle": (20.0, 0.35)}


@dataclass(frozen=True)
class Movement:
    """One movement of a trial.

    Parameters
    ----------
    angles
        Amplitude of each coordinate that moves, rad, from its start: it goes there and back as
        ``(1 - cos) / 2``.
    start
        Values of coordinates at the start, rad; those not given have the model's default values.
    seconds
        Duration, s.
    efforts
        Coordinates whose muscles contract, with the direction of their moment (1 or -1) and the excitation
        that they reach in the middle, 0 to 1.
    """

    angles: Mapping[str, float]
    start: Mapping[str, float]
    seconds: float
    efforts: tuple[tuple[str, int, float], ...] = ()


@dataclass(frozen=True)
class CandidateTrial:
    """Trial that could be recorded next.

    Parameters
    ----------
    id
        Identifier, from the task and the coordinate.
    task
        One of `wrapjax.subject.trials.TASKS`.
    what
        What is done, in words.
    posture
        Values of the coordinates that are held, degrees.
    effort
        Effort, in words.
    minutes
        Duration in the laboratory.
    movements
        Movements, each recorded once.
    measured
        Coordinates whose moments are measured.
    """

    id: str
    task: str
    what: str
    posture: dict[str, float]
    effort: str
    minutes: int
    movements: tuple[Movement, ...]
    measured: tuple[str, ...]


def candidate_trials(
    coordinates: Sequence[str], ranges: Mapping[str, tuple[float, float]]
) -> tuple[CandidateTrial, ...]:
    """List the trials that a laboratory could record next with a leg.

    Parameters
    ----------
    coordinates
        Coordinates whose moments are matched.
    ranges
        Range of each in the model, rad.
    """
    joints = {_stem(name): name for name in coordinates}
    limits = {name: _range(_stem(name), ranges[name]) for name in coordinates}
    strong = [stem for stem in _STRONG if stem in joints] or list(joints)
    trials = []
    for stem in joints:
        for label, held in _passive_postures(stem, joints):
            trials.append(_passive(stem, joints, limits, held, label))
    for stem in strong:
        trials.append(_passive(stem, joints, limits, _held(stem), ", slowly and fast", fast=True))
        trials.append(_isometric(stem, joints, limits))
    if set(_SQUAT) <= set(joints):
        trials.append(_squat(joints, limits))
    return tuple(trials)


def _stem(name: str) -> str:
    """Remove the suffix of the side; the start of a known coordinate's name where it has one."""
    return next((stem for stem in _RANGES if name.startswith(stem)), name)


def _range(stem: str, of_model: tuple[float, float]) -> tuple[float, float]:
    """Return the range from extension to flexion of a joint, rad, with the signs of the model."""
    low, high = _RANGES.get(stem, _OTHER_RANGE)
    if stem == "knee_angle" and abs(of_model[0]) > abs(of_model[1]):
        low, high = -high, -low
    low, high = max(np.radians(low), of_model[0]), min(np.radians(high), of_model[1])
    if not low < high:
        low, high = of_model
    return float(low), float(high)


def _flexed(stem: str, degrees: float, limits: tuple[float, float]) -> float:
    """Return an angle of flexion in rad, with the sign of the model and within its range."""
    sign = -1.0 if stem == "knee_angle" and abs(limits[0]) > abs(limits[1]) else 1.0
    return float(np.clip(sign * np.radians(degrees), *limits))


def _held(stem: str) -> dict[str, float]:
    return _POSTURES.get(stem, {})


def _passive_postures(stem: str, joints: Mapping[str, str]) -> list[tuple[str, dict[str, float]]]:
    """List postures of passive rotations: of the ankle with the knee extended and flexed."""
    if stem == "ankle_angle" and "knee_angle" in joints:
        return [
            (", with the knee extended", {"knee_angle": 0.0}),
            (", with the knee at 90 degrees", {"knee_angle": 90.0}),
        ]
    return [("", _held(stem))]


def _start(
    joints: Mapping[str, str], limits: Mapping[str, tuple[float, float]], held: Mapping[str, float]
) -> dict[str, float]:
    return {
        joints[stem]: _flexed(stem, degrees, limits[joints[stem]])
        for stem, degrees in held.items()
        if stem in joints
    }


def _in_degrees(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(float(np.degrees(value)), 1) for name, value in values.items()}


def _named(stem: str) -> str:
    return _JOINTS.get(stem, stem)


def _passive(
    stem: str,
    joints: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]],
    held: Mapping[str, float],
    label: str,
    *,
    fast: bool = False,
) -> CandidateTrial:
    """Rotate a joint of the relaxed leg through its range and back, slowly, or slowly and fast."""
    name = joints[stem]
    low, high = limits[name]
    posture = _start(joints, limits, held)
    speeds = (SLOW, FAST) if fast else (SLOW,)
    movements = tuple(
        Movement({name: high - low}, {**posture, name: low}, 2.0 * (high - low) / speed) for speed in speeds
    )
    ending = "_two_speeds" if fast else "_knee_flexed" if held.get("knee_angle") == 90.0 else ""
    return CandidateTrial(
        id=f"passive_{stem}{ending}",
        task="passive",
        what=f"passive rotation of the {_named(stem)}{label}, on a dynamometer",
        posture=_in_degrees(posture),
        effort="at rest",
        minutes=6 if fast else 5,
        movements=movements,
        measured=(name,),
    )


def _isometric(
    stem: str, joints: Mapping[str, str], limits: Mapping[str, tuple[float, float]]
) -> CandidateTrial:
    """Push in both directions against a dynamometer at several angles of a joint."""
    name = joints[stem]
    low, high = limits[name]
    posture = _start(joints, limits, _held(stem))
    angles = [low + share * (high - low) for share in RAMP_ANGLES]
    shown = ", ".join(f"{np.degrees(angle):.0f}" for angle in angles)
    return CandidateTrial(
        id=f"isometric_{stem}",
        task="isometric",
        what=f"isometric ramps of the {_named(stem)} in both directions, at {shown} degrees",
        posture=_in_degrees(posture),
        effort=f"ramps to {100.0 * RAMP_EFFORT:.0f} % of a maximum contraction",
        minutes=10,
        movements=tuple(
            Movement({}, {**posture, name: angle}, RAMP_SECONDS, ((name, sign, RAMP_EFFORT),))
            for angle in angles
            for sign in (1, -1)
        ),
        measured=(name,),
    )


def _squat(joints: Mapping[str, str], limits: Mapping[str, tuple[float, float]]) -> CandidateTrial:
    """Squat slowly, twice."""
    efforts, angles = [], {}
    for stem, (degrees, effort) in _SQUAT.items():
        name = joints[stem]
        angles[name] = _flexed(stem, degrees, limits[name])
        # The muscles that extend a joint act against its flexion; those of the ankle, against dorsiflexion.
        efforts.append((name, -int(np.sign(angles[name])), effort))
    movement = Movement(angles, dict.fromkeys(angles, 0.0), SQUAT_SECONDS, tuple(efforts))
    return CandidateTrial(
        id="squat",
        task=MOVEMENT,
        what="slow squats, with motion capture and force plates",
        posture={},
        effort="body weight",
        minutes=4,
        movements=(movement, movement),
        measured=tuple(joints.values()),
    )


def positions(
    movement: Movement, names: Sequence[str], defaults: Mapping[str, float], phase: Float[np.ndarray, " pose"]
) -> Float[np.ndarray, "coordinate pose"]:
    """Compute the values of coordinates (rad) at phases of a movement, 0 to 1."""
    shape = 0.5 * (1.0 - np.cos(2.0 * np.pi * phase))
    return np.array(
        [movement.start.get(name, defaults[name]) + movement.angles.get(name, 0.0) * shape for name in names]
    ).reshape(len(names), -1)


def rates(
    movement: Movement, names: Sequence[str], phase: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "coordinate frame"]:
    """Compute the rates of coordinates (rad/s) at phases of a movement."""
    shape = np.pi * np.sin(2.0 * np.pi * phase) / movement.seconds
    return np.array([movement.angles.get(name, 0.0) * shape for name in names]).reshape(len(names), -1)
