"""OpenSim computations on a leg: muscle paths, inverse dynamics, foot points, and muscle curves.

This is the only module that imports `opensim`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.anatomy import COORDINATES, PELVIS, Leg
from validation.blind.leg_file import leg_text

#: Bodies from proximal to distal, and the coordinates between each and the next.
_ORDER = ("pelvis", "femur_r", "tibia_r", "calcn_r")
_CROSSED = (COORDINATES[:3], COORDINATES[3:4], COORDINATES[4:])
ALL_COORDINATES = (*PELVIS, *COORDINATES)


@contextmanager
def opensim_model(leg: Leg) -> Iterator[tuple[Any, Any, Any]]:
    """Load a leg into OpenSim; yields the module, the model and a state."""
    import opensim

    opensim.Logger.setLevelString("Off")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.osim"
        path.write_text(leg_text(leg), encoding="utf-8")
        model = opensim.Model(str(path))
    yield opensim, model, model.initSystem()


def muscle_paths(
    leg: Leg, angles: np.ndarray, muscles: Sequence[int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Compute lengths (muscle, frame) in m and moment arms (muscle, coordinate, frame) in m.

    ``angles`` are those of the six coordinates of the leg, (coordinate, frame) in rad.
    """
    chosen = range(len(leg.muscles)) if muscles is None else muscles
    frames = angles.shape[1]
    lengths = np.zeros((len(chosen), frames))
    arms = np.zeros((len(chosen), len(COORDINATES), frames))
    with opensim_model(leg) as (_, model, state):
        coordinates = [model.getCoordinateSet().get(name) for name in COORDINATES]
        entries = [model.getMuscles().get(leg.muscles[index].name) for index in chosen]
        crossed = [
            [COORDINATES.index(name) for name in crossed_coordinates(leg.muscles[index])] for index in chosen
        ]
        for frame in range(frames):
            for coordinate, value in zip(coordinates, angles[:, frame], strict=True):
                coordinate.setValue(state, float(value), False)
            model.realizePosition(state)
            for row, muscle in enumerate(entries):
                lengths[row, frame] = muscle.getLength(state)
                for column in crossed[row]:
                    arms[row, column, frame] = muscle.computeMomentArm(state, coordinates[column])
    return lengths, arms


def crossed_coordinates(muscle: Any) -> tuple[str, ...]:
    """Return the coordinates between the most proximal and most distal body of a muscle."""
    places = [_ORDER.index(body) for body, _ in muscle.points]
    return tuple(name for group in _CROSSED[min(places) : max(places)] for name in group)


def foot_points(leg: Leg, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transform points of the foot, (frame, 3) in its frame, to the laboratory; pose is (12, frame)."""
    out = np.zeros_like(points)
    with opensim_model(leg) as (opensim, model, state):
        coordinates = [model.getCoordinateSet().get(name) for name in ALL_COORDINATES]
        foot = model.getBodySet().get("calcn_r")
        for frame in range(pose.shape[1]):
            for coordinate, value in zip(coordinates, pose[:, frame], strict=True):
                coordinate.setValue(state, float(value), False)
            model.realizePosition(state)
            place = foot.findStationLocationInGround(state, opensim.Vec3(*map(float, points[frame])))
            out[frame] = [place.get(axis) for axis in range(3)]
    return out


def inverse_dynamics(
    leg: Leg, pose: np.ndarray, rate: np.ndarray, acceleration: np.ndarray, ground: np.ndarray
) -> np.ndarray:
    """Compute joint moments of the leg by inverse dynamics, (coordinate, frame) in N m.

    ``pose``, ``rate`` and ``acceleration`` are (12, frame): pelvis, then leg. ``ground`` is (9, frame):
    force, point and free moment on the foot, in the laboratory.
    """
    moments = np.zeros((len(COORDINATES), pose.shape[1]))
    with opensim_model(leg) as (opensim, model, state):
        solver = opensim.InverseDynamicsSolver(model)
        coordinates = [model.getCoordinateSet().get(name) for name in ALL_COORDINATES]
        foot = model.getBodySet().get("calcn_r")
        bodies = model.getNumBodies() + 1  # including the ground
        index = int(foot.getMobilizedBodyIndex())
        none = opensim.Vector(state.getNU(), 0.0)
        for muscle in range(model.getMuscles().getSize()):
            model.getMuscles().get(muscle).set_appliesForce(False)
        state = model.initSystem()
        for frame in range(pose.shape[1]):
            for coordinate, value, speed in zip(coordinates, pose[:, frame], rate[:, frame], strict=True):
                coordinate.setValue(state, float(value), False)
                coordinate.setSpeedValue(state, float(speed))
            model.realizeVelocity(state)
            wrench = ground[:, frame]
            origin = foot.getPositionInGround(state)
            lever = wrench[3:6] - np.array([origin.get(axis) for axis in range(3)])
            turning = wrench[6:9] + np.cross(lever, wrench[:3])
            applied = opensim.VectorOfSpatialVec(bodies, opensim.SpatialVec(opensim.Vec3(0), opensim.Vec3(0)))
            applied.set(
                index,
                opensim.SpatialVec(opensim.Vec3(*map(float, turning)), opensim.Vec3(*map(float, wrench[:3]))),
            )
            udot = opensim.Vector([float(value) for value in acceleration[:, frame]])
            forces = solver.solve(state, udot, none, applied)
            moments[:, frame] = [forces.get(len(PELVIS) + row) for row in range(len(COORDINATES))]
    return moments


@cache
def millard_tables() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Tabulate OpenSim's Millard 2012 curves: active, velocity, passive."""
    import opensim

    opensim.Logger.setLevelString("Off")

    def table(curve, low, high):
        x = np.linspace(low, high, 1501)
        return x, np.array([curve.calcValue(float(value)) for value in x])

    return {
        "active": table(opensim.ActiveForceLengthCurve(), 0.2, 2.0),
        "velocity": table(opensim.ForceVelocityCurve(), -1.0, 1.0),
        "passive": table(opensim.FiberForceLengthCurve(), 0.2, 2.2),
    }
