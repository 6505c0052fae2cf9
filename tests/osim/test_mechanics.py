"""Tests of the terms of inverse dynamics against OpenSim's solver, and of changed external loads."""

import numpy as np
import opensim
import pytest

from wrapjax.errors import InputError
from wrapjax.osim.mechanics import Mechanics, analyse_mechanics
from wrapjax.osim.motion import Motion

MOVING = ("hip", "knee")
POSES = 4


@pytest.fixture(scope="module")
def motion():
    """Values, speeds and accelerations of hip and knee, large enough for every term to count."""
    generator = np.random.default_rng(4)
    return [generator.uniform(-1.0, 1.0, (2, POSES)) * size + 0.5 for size in (0.5, 3.0, 20.0)]


@pytest.fixture(scope="module")
def mechanics(odd_model, motion) -> Mechanics:
    return analyse_mechanics(odd_model, MOVING, Motion(MOVING, *motion))


@pytest.fixture(scope="module")
def wrench():
    """External load on the foot: moment about ground's origin, and force."""
    return np.random.default_rng(5).uniform(-100.0, 100.0, (1, 6, POSES))


class ReferenceSolver:
    """OpenSim's solver for the same model, set to poses by OpenSim's own functions."""

    def __init__(self, file):
        self.model = opensim.Model(str(file))
        for index in range(self.model.getMuscles().getSize()):
            self.model.getMuscles().get(index).set_appliesForce(False)
        self.state = self.model.initSystem()

    def moments(self, motion, pose, wrench):
        model, state = self.model, self.state
        value, speed, acceleration = (part[:, pose] for part in motion)
        # Patella and pulley follow the model's couplers: scale (0.2 q^2 + slope q + offset).
        names, rows = ["hip", "knee"], [list(part) for part in zip(value, speed, acceleration, strict=True)]
        for name, slope, offset, scale in (("patella_turn", 0.5, 0.1, 1.5), ("pulley_turn", 0.7, 0.05, 1.0)):
            q, u, a = rows[-1]
            second, first = 0.4 * scale, scale * (0.4 * q + slope)
            names.append(name)
            rows.append([scale * (0.2 * q**2 + slope * q + offset), first * u, first * a + second * u**2])
        accelerations = opensim.Vector(state.getNU(), 0.0)
        order = {}
        for name, (q, u, a) in zip(names, rows, strict=True):
            coordinate = model.getCoordinateSet().get(name)
            coordinate.setValue(state, q, False)
            coordinate.setSpeedValue(state, 0.0)
            order[name] = (coordinate, u, a)
        columns = {}
        for name, (coordinate, _, _) in order.items():
            coordinate.setSpeedValue(state, 1.0)
            columns[name] = int(np.argmax(state.getU().to_numpy()))
            coordinate.setSpeedValue(state, 0.0)
        for name, (coordinate, u, a) in order.items():
            coordinate.setSpeedValue(state, u)
            accelerations.set(columns[name], a)
        model.realizeVelocity(state)
        foot = model.getBodySet().get("foot")
        force = wrench[3:]
        moment = wrench[:3] - np.cross(foot.getPositionInGround(state).to_numpy(), force)
        count = model.getNumBodies() + 1
        still = opensim.SpatialVec(opensim.Vec3(0), opensim.Vec3(0))
        nothing, applied = (opensim.VectorOfSpatialVec(count, still) for _ in range(2))
        applied.set(
            int(foot.getMobilizedBodyIndex()),
            opensim.SpatialVec(opensim.Vec3(*moment.tolist()), opensim.Vec3(*force.tolist())),
        )
        none = opensim.Vector(state.getNU(), 0.0)
        solver = opensim.InverseDynamicsSolver(model)
        # With applied forces given, the solver ignores those of the model, gravity included.
        weight = solver.solve(state, accelerations).to_numpy()
        weight = weight - solver.solve(state, accelerations, none, nothing).to_numpy()
        found = solver.solve(state, accelerations, none, applied).to_numpy() + weight
        return found[[columns["hip"], columns["knee"]]]


def test_moments_equal_opensims(odd_model, motion, mechanics, wrench):
    found = mechanics.moments(mechanics.transmitted(("foot",), wrench))
    reference = ReferenceSolver(odd_model)
    expected = [reference.moments(motion, pose, wrench[0, :, pose]) for pose in range(POSES)]
    np.testing.assert_allclose(found, np.stack(expected, axis=1), rtol=1e-10, atol=1e-10)
    # Neither the wrench of mass nor that of rotational inertia is negligible.
    assert np.abs(mechanics.mass_wrench[:, :3]).max() > 1.0 and np.abs(mechanics.inertia_wrench).max() > 0.5


def test_displacement_of_a_force_changes_moments_by_its_moment_about_the_hinge(mechanics, wrench):
    """A displacement d of a force F reduces the moment about a hinge with axis a by a . (d x F)."""
    moved = np.array([0.01, 0.0, 0.004])
    change = np.zeros_like(wrench)
    change[0, :3] = np.cross(moved, wrench[0, 3:].T).T
    before, after = (
        mechanics.moments(mechanics.transmitted(("foot",), load)) for load in (wrench, wrench + change)
    )
    # Both hinges are along z, so that only components in the sagittal plane have an effect.
    across = moved[0] * wrench[0, 4] - moved[1] * wrench[0, 3]
    np.testing.assert_allclose(after - before, -np.stack([across, across]), atol=1e-10)


def test_screws_and_centers_are_those_of_hinges(mechanics, motion):
    """The knee is 0.4 m below a hip at a height of 1 m, and rotates with the thigh."""
    hip = motion[0][0]
    knee = np.stack([0.4 * np.sin(hip), 1.0 - 0.4 * np.cos(hip), 0.0 * hip])
    np.testing.assert_allclose(mechanics.joint_center[1], knee, atol=1e-12)
    axis = np.array([[0.0], [0.0], [1.0]]) + 0.0 * knee
    np.testing.assert_allclose(mechanics.screw[1, :3], axis, atol=1e-12)
    # Points of a hinge's axis are at rest, so that ground's origin rotates about the knee.
    np.testing.assert_allclose(mechanics.screw[1, 3:], np.cross(axis, -knee, axis=0), atol=1e-12)


def test_coordinates_move_the_bodies_below_their_joint(mechanics):
    moved = {
        name: {body for body, moves in zip(mechanics.bodies, row, strict=True) if moves}
        for name, row in zip(mechanics.coordinates, mechanics.moves, strict=True)
    }
    assert moved["knee"] == {"shank", "foot", "toes"}
    assert moved["hip"] == set(mechanics.bodies)
    assert dict(zip(mechanics.bodies, mechanics.parents, strict=True))["foot"] == "shank"


def test_an_unknown_coordinate_is_named(odd_model):
    zeros = np.zeros((1, 1))
    with pytest.raises(InputError, match=r"kneee.*no such coordinate.*'knee'"):
        analyse_mechanics(odd_model, ("kneee",), Motion(("hip",), zeros, zeros, zeros))
