"""Tests of joint reactions against the Newton-Euler equations, and of the contribution of muscles."""

import itertools

import numpy as np
import opensim
import pytest

from wrapjax.contact_forces.contact_force import lines_of_action, sum_muscle_forces
from wrapjax.errors import InputError
from wrapjax.geometry.exact_paths.engine import PARITY
from wrapjax.osim.joint_reaction import analyse_joint_reactions
from wrapjax.osim.model import describe_model
from wrapjax.osim.motion import Motion

POSES = 4
LENGTH = 0.4
MASSES, CENTERS = (7.0, 3.0), ((0.02, -0.17, 0.01), (-0.01, -0.19, -0.02))
HIP = np.array([0.1, 1.0, 0.2])
#: Path points of each muscle: body (0 ground, 1 thigh, 2 shank) and location.
MUSCLES = {
    "hip_flexor": ((0, (0.15, 1.1, 0.25)), (1, (0.05, -0.2, 0.01))),
    "long_flexor": ((0, (0.05, 1.05, 0.15)), (1, (-0.05, -0.3, 0.0)), (2, (-0.04, -0.1, 0.02))),
}


@pytest.fixture(scope="module", params=["Millard2012EquilibriumMuscle", "Thelen2003Muscle"])
def two_links(request, tmp_path_factory):
    """Model of a thigh and a shank with two pin joints and two muscles of one class."""
    opensim.Logger.setLevelString("Off")
    model = opensim.Model()
    bodies = [model.getGround()]
    for name, mass, center in zip(("thigh", "shank"), MASSES, CENTERS, strict=True):
        body = opensim.Body(name, mass, opensim.Vec3(*center), opensim.Inertia(0.2, 0.1, 0.2))
        model.addBody(body)
        bodies.append(body)
    for number, (name, where) in enumerate((("hip", HIP.tolist()), ("knee", [0.0, -LENGTH, 0.0]))):
        # Joint frames are rotated in their bodies, while forces are given along the bodies' axes.
        rotation = opensim.Vec3(0, 0, 0.7)
        parent = (bodies[number], opensim.Vec3(*where), rotation)
        child = (bodies[number + 1], opensim.Vec3(0), rotation)
        joint = opensim.PinJoint(f"{name}_joint", *parent, *child)
        joint.updCoordinate().setName(name)
        model.addJoint(joint)
    for name, points in MUSCLES.items():
        muscle = getattr(opensim, request.param)(name, 100.0, 0.1, 0.2, 0.0)
        for number, (body, where) in enumerate(points):
            muscle.addNewPathPoint(f"{name}-{number}", bodies[body], opensim.Vec3(*where))
        model.addForce(muscle)
    # A force other than muscles, which must be left out.
    spring = opensim.PointToPointSpring(bodies[0], opensim.Vec3(0), bodies[2], opensim.Vec3(0), 1e4, 0.1)
    model.addForce(spring)
    model.finalizeConnections()
    file = tmp_path_factory.mktemp("links") / "model.osim"
    model.printToXML(str(file))
    return file


@pytest.fixture(scope="module")
def motion():
    generator = np.random.default_rng(8)
    parts = [generator.uniform(-1.0, 1.0, (2, POSES)) * size + 0.3 for size in (0.6, 4.0, 30.0)]
    return Motion(("hip", "knee"), *parts)


@pytest.fixture(scope="module")
def wrench():
    return np.random.default_rng(9).uniform(-200.0, 200.0, (1, 6, POSES))


@pytest.fixture(scope="module")
def forces():
    return np.random.default_rng(10).uniform(100.0, 900.0, (2, POSES))


def turn(angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def newton_euler(motion, pose, load, tension):
    """Sum up what acts on each link, from the last one to the first, with pen and paper's formulas.

    Forces of hip and knee on the parent, then the moment about the knee and the force on the shank.
    """
    (q1, q2), (u1, u2), (a1, a2) = (
        part[:, pose] for part in (motion.values, motion.speeds, motion.accelerations)
    )
    axes = [np.eye(3), turn(q1), turn(q1 + q2)]
    knee = axes[1] @ [0.0, -LENGTH, 0.0]
    origins = [np.zeros(3), HIP, HIP + knee]
    arms = [axes[link] @ CENTERS[link - 1] for link in (1, 2)]

    def carried(arm, rate, change):
        """Acceleration of the end of an arm that rotates about z."""
        flat = arm * [1.0, 1.0, 0.0]
        return change * np.cross([0.0, 0.0, 1.0], arm) - rate**2 * flat

    centers = [
        carried(arms[0], u1, a1),
        carried(knee, u1, a1) + carried(arms[1], u1 + u2, a1 + a2),
    ]
    gravity = np.array([0.0, -9.80665, 0.0])
    pulls, turns = [np.zeros(3) for _ in range(3)], np.zeros(3)
    for points, force in zip(MUSCLES.values(), tension, strict=True):
        places = [(body, origins[body] + axes[body] @ where) for body, where in points]
        for (body, start), (next_body, end) in itertools.pairwise(places):
            along = force * (end - start) / np.linalg.norm(end - start)
            for link, point, pull in ((body, start, along), (next_body, end, -along)):
                pulls[link] += pull
                turns += np.cross(point - origins[2], pull) * (link == 2)
    at_knee = MASSES[1] * (centers[1] - gravity) - load[3:] - pulls[2]
    at_hip = at_knee + MASSES[0] * (centers[0] - gravity) - pulls[1]
    # Euler's equation of the shank, which rotates about z only.
    spin = np.diag([0.2, 0.1, 0.2])
    rate, change = np.array([0.0, 0.0, u1 + u2]), np.array([0.0, 0.0, a1 + a2])
    about_knee = axes[2] @ (spin @ change + np.cross(rate, spin @ rate))
    about_knee += np.cross(arms[1], MASSES[1] * (centers[1] - gravity))
    about_knee -= turns + load[:3] - np.cross(origins[2], load[3:])
    on_parent = np.stack([-at_hip, -axes[1].T @ at_knee])
    return on_parent, axes[2].T @ about_knee, axes[2].T @ at_knee


def test_reactions_satisfy_the_newton_euler_equations(two_links, motion, wrench, forces):
    joints = ("hip_joint", "knee_joint")
    found = analyse_joint_reactions(two_links, joints, motion, ("shank",), wrench, tuple(MUSCLES), forces)
    for pose in range(POSES):
        on_parent, moment, force = newton_euler(motion, pose, wrench[0, :, pose], forces[:, pose])
        np.testing.assert_allclose(found.on_parent[:, :, pose], on_parent, rtol=1e-9, atol=1e-7)
        np.testing.assert_allclose(found.on_child[1, 3:, pose], force, rtol=1e-9, atol=1e-7)
        # Actuators provide the moment about the pin's axis, the joint those about the other axes.
        np.testing.assert_allclose(found.on_child[1, :2, pose], moment[:2], rtol=1e-9, atol=1e-7)


def test_joint_forces_do_not_depend_on_where_a_load_acts(two_links, motion, wrench, forces):
    """The point of application changes joint moments, which actuators provide, but no joint force."""
    inputs = (two_links, ("hip_joint",), motion, ("shank",))
    shifted = wrench.copy()
    shifted[:, :3] += 50.0
    one, other = (
        analyse_joint_reactions(*inputs, load, tuple(MUSCLES), forces) for load in (wrench, shifted)
    )
    np.testing.assert_allclose(one.on_parent, other.on_parent, atol=1e-7)


def test_muscles_that_are_not_named_exert_no_force(two_links, motion, wrench, forces):
    inputs = (two_links, ("hip_joint", "knee_joint"), motion, ("shank",), wrench)
    one = analyse_joint_reactions(*inputs, ("long_flexor",), forces[1:])
    without_first = forces.copy()
    without_first[0] = 0.0
    other = analyse_joint_reactions(*inputs, tuple(MUSCLES), without_first)
    np.testing.assert_allclose(one.on_parent, other.on_parent, atol=1e-7)


def test_unknown_names_are_reported(two_links, motion, wrench, forces):
    with pytest.raises(InputError, match="knee_jont: the model has no such joint; did you mean 'knee_joint'"):
        analyse_joint_reactions(two_links, ("knee_jont",), motion, ("shank",), wrench, tuple(MUSCLES), forces)


def test_muscle_contributions_are_along_their_lines_of_action(odd_model, motion):
    """For wraps, pulleys, conditional and moving points, and a muscle over two joints."""
    muscles, joints = (
        ("extensor", "flexor", "toe_flexor", "conditional", "moving"),
        ("hip_joint", "knee_joint"),
    )
    none = np.zeros((0, 6, POSES))
    force = np.random.default_rng(11).uniform(100.0, 900.0, (len(muscles), POSES))
    inputs = (odd_model, joints, motion, (), none, muscles)
    with_force, without = (analyse_joint_reactions(*inputs, size * force).on_parent for size in (1.0, 0.0))
    added = with_force - without

    lines = lines_of_action(
        describe_model(odd_model), muscles, joints, motion.coordinates, motion.values[None], PARITY
    )
    share = sum_muscle_forces(lines, force[:, None])[0]
    np.testing.assert_allclose(np.moveaxis(share, 1, 1), added, atol=1e-5)
    assert np.abs(share).max() > 100.0
    # Both ends are below the hip, which the muscle does not cross.
    np.testing.assert_allclose(lines[muscles.index("toe_flexor"), 0], 0.0, atol=1e-12)
