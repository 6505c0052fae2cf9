"""Muscles load a joint along the straight segment by which they cross it."""

import numpy as np
import pytest

from wrapjax.contact_forces.contact_force import lines_of_action, sum_muscle_forces
from wrapjax.errors import InputError
from wrapjax.geometry.skeleton.functions import IDENTITY
from wrapjax.geometry.skeleton.model_description import (
    Axis,
    Coordinate,
    Joint,
    ModelDescription,
    Muscle,
    PathPoint,
    Pose,
)

UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
#: The pelvis' frame of the hip: turned by a quarter about z, so that its x is the pelvis' y.
IN_PELVIS = Pose(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), (0.1, -0.05, 0.08))
SOMEWHERE = Pose(UNTURNED, (0.0, 0.0, 0.0))


def _pin(name, parent, child, in_parent):
    axes = (Axis("rotation", (0.0, 0.0, 1.0), name, IDENTITY),)
    return Joint(f"{name}_joint", "PinJoint", parent, child, (name,), in_parent, SOMEWHERE, axes, SOMEWHERE)


def _muscle(name, *points):
    entries = [
        PathPoint(f"{name}-{number}", "PathPoint", body, where) for number, (body, where) in enumerate(points)
    ]
    return Muscle(name, "GeometryPath", tuple(entries), ())


ORIGIN, VIA, END = (0.12, 0.1, 0.05), (0.05, -0.2, 0.0), (0.03, -0.1, 0.01)
MODEL = ModelDescription(
    name="by hand",
    muscles=(
        _muscle("short", ("pelvis", ORIGIN), ("femur", VIA)),
        _muscle("long", ("pelvis", ORIGIN), ("femur", VIA), ("tibia", END)),
        _muscle("there_and_back", ("pelvis", ORIGIN), ("femur", VIA), ("pelvis", (0.0, 0.2, 0.0))),
        _muscle("inside", ("femur", VIA), ("femur", END)),
    ),
    coordinates=tuple(
        Coordinate(name, "rotational", 0.0, (-2.0, 2.0), False, False, False, ())
        for name in ("tilt", "hip", "knee")
    ),
    joints=(
        _pin("tilt", "ground", "pelvis", SOMEWHERE),
        _pin("hip", "pelvis", "femur", IN_PELVIS),
        _pin("knee", "femur", "tibia", Pose(UNTURNED, (0.0, -0.4, 0.0))),
        Joint("odd", "BallJoint", "pelvis", "torso", (), SOMEWHERE, SOMEWHERE, None, SOMEWHERE),
    ),
    wraps=(),
    constraints=(),
)
NAMES = tuple(muscle.name for muscle in MODEL.muscles)
JOINTS = ("hip_joint", "knee_joint")
COORDINATES = ("tilt", "hip", "knee")


def turn(angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def angles():
    return np.random.default_rng(2).uniform(-0.8, 0.8, (2, len(COORDINATES), 3))


@pytest.fixture(scope="module")
def lines(angles):
    return lines_of_action(MODEL, NAMES, JOINTS, COORDINATES, angles)


def unit(vector):
    return vector / np.linalg.norm(vector)


def test_lines_are_unit_vectors_toward_the_proximal_body(lines, angles):
    """In the frame of the pelvis, by hand."""
    axes = np.array(IN_PELVIS.rotation)
    for trial, frame in np.ndindex(2, 3):
        _, hip, knee = angles[trial, :, frame]
        femur = axes @ turn(hip)
        via = np.array(IN_PELVIS.translation) + femur @ VIA
        end = np.array(IN_PELVIS.translation) + femur @ ([0.0, -0.4, 0.0] + turn(knee) @ END)
        across_hip = unit(ORIGIN - via)
        back = unit(np.array([0.0, 0.2, 0.0]) - via)
        expected = [across_hip, across_hip, across_hip + back, np.zeros(3)]
        np.testing.assert_allclose(lines[:, 0, :, trial, frame], expected, atol=1e-12)
        np.testing.assert_allclose(lines[1, 1, :, trial, frame], femur.T @ unit(via - end), atol=1e-12)
        np.testing.assert_allclose(lines[[0, 2, 3], 1, :, trial, frame], 0.0, atol=1e-12)


def test_muscle_forces_are_summed(lines):
    force = np.random.default_rng(5).uniform(0.0, 500.0, (len(NAMES), 2, 3))
    share = sum_muscle_forces(lines, force)
    assert share.shape == (2, len(JOINTS), 3, 3)
    np.testing.assert_allclose(share[1, 0, 2], (lines[:, 0, 2, 1] * force[:, 1]).sum(axis=0))


def test_an_unsupported_joint_is_refused(angles):
    with pytest.raises(InputError, match="hip_jont: the model has no such joint; did you mean 'hip_joint'"):
        lines_of_action(MODEL, NAMES, ("hip_jont",), COORDINATES, angles)
    with pytest.raises(InputError, match="odd: is a BallJoint that the path engine cannot move"):
        lines_of_action(MODEL, NAMES, ("odd",), COORDINATES, angles)
