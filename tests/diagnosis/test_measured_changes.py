"""Changes of measured moments by errors in the inputs of inverse dynamics, against mechanics and OpenSim."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import opensim
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from tests.subject import synthetic
from tests.subject.synthetic_forces import LOADS, POINT, TORQUE, force, with_forces
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.measured_motion import foot_loads, skin_slides
from wrapjax.diagnosis.effects.scaled_model import FOOT_DISPLACED, FOOT_HELD
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.diagnosis.inputs.recorded_movement import UP, RecordedMovement
from wrapjax.diagnosis.inputs.subject_context import compute_measured_changes
from wrapjax.errors import InputError
from wrapjax.osim.mechanics import Mechanics
from wrapjax.osim.motion import Motion
from wrapjax.subject.subject import load_subject as load_subject

#: Of both segments of the synthetic leg: kg, m, m, kg m^2; and m/s^2.
MASS, LENGTH, TO_CENTER, INERTIA, GRAVITY = 5.0, 0.4, 0.2, 0.1, 9.80665


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    return with_forces(tmp_path_factory.mktemp("forces") / "person")


@pytest.fixture(scope="module")
def found(subject):
    return compute_measured_changes(read_recorded_movement(subject)[0])


@pytest.fixture(scope="module")
def leg(subject):
    """Analytical angles, velocities and accelerations of hip and knee over the cycles."""
    time = subject.trials.time
    turn = 2.0 * np.pi / synthetic.PERIOD
    accelerations = -(turn**2) * (synthetic.angles(time) - np.array([0.2, 0.6])[:, None, None])
    return time, synthetic.angles(time), synthetic.angular_velocities(time), accelerations


def change(changes, id, variant="", **effect_sizes):
    names = [parameter.name for parameter in CATALOGUE[id].parameters]
    vector = np.zeros(len(names))
    for name, effect_size in effect_sizes.items():
        vector[names.index(name)] = effect_size
    # Hip and knee, trials, frames.
    return np.moveaxis(np.asarray(changes[id][variant](jnp.asarray(vector))), 1, 0)


def close(value, expected):
    scale = np.abs(expected).max()
    # Accelerations are those of a spline through samples, which is less accurate at the ends of cycles.
    np.testing.assert_allclose(value[..., 5:-5], np.asarray(expected)[..., 5:-5], atol=2e-3 * scale)


def test_a_center_of_pressure_too_far_forward_reduces_both_moments(found, leg):
    """Hinges along z: the vertical force's lever about either grows by the offset."""
    lever = -0.01 * force(leg[0])[1]
    np.testing.assert_allclose(
        change(found, "cop_offset", anterior_m=0.01), np.stack([lever, lever]), atol=1e-3
    )
    # Sideways it turns nothing about these hinges.
    assert np.abs(change(found, "cop_offset", lateral_m=0.01)).max() < 1e-9


def test_late_forces_change_moments_by_their_time_derivative(found, leg):
    time, (hip, _), _, _ = leg
    knee = np.stack([LENGTH * np.sin(hip), -LENGTH * np.cos(hip)])
    late = (force(time - 0.001) - force(time + 0.001)) / 2.0
    expected = np.stack(
        [-((POINT[0] - x) * late[1] - (POINT[1] - y) * late[0]) for x, y in (np.zeros_like(knee), knee)]
    )
    # A difference over 5 ms either way.
    np.testing.assert_allclose(
        change(found, "force_latency", latency=0.001), expected, atol=0.02 * np.abs(expected).max()
    )


def test_segment_inertia_changes_moments_as_in_a_double_pendulum(found, leg):
    _, (hip, knee), (hip_rate, _), (hip_acceleration, knee_acceleration) = leg
    thigh = MASS * TO_CENTER**2 * hip_acceleration + MASS * GRAVITY * TO_CENTER * np.sin(hip)
    close(change(found, "segment_inertia", mass_fraction_thigh=0.1), -0.1 * np.stack([thigh, 0.0 * thigh]))
    turned = hip_acceleration + knee_acceleration
    both = np.stack([turned, turned])
    close(change(found, "segment_inertia", inertia_fraction_shank=0.1), -0.1 * INERTIA * both)
    pull = LENGTH * (np.cos(knee) * hip_acceleration + np.sin(knee) * hip_rate**2)
    shank = MASS * TO_CENTER * (TO_CENTER * turned + pull + GRAVITY * np.sin(hip + knee))
    close(change(found, "segment_inertia", mass_fraction_shank=0.1)[1], -0.1 * shank)
    # Without an ankle there is no foot.
    assert np.abs(change(found, "segment_inertia", mass_fraction_foot=1.0)).max() == 0.0


def test_a_displaced_hip_center_changes_the_lever_of_the_force_through_it(found, leg):
    """An upward force has a smaller lever about a point ahead of the hip."""
    time, angles, _, _ = leg

    def centers(at):
        hip, knee = synthetic.angles(at)
        down = [np.stack([np.sin(angle), -np.cos(angle)]) for angle in (hip, hip + knee)]
        return TO_CENTER * down[0], LENGTH * down[0] + TO_CENTER * down[1]

    step = 1e-4
    through = -force(time)[:2]
    for before, now, after in zip(centers(time - step), centers(time), centers(time + step), strict=True):
        through = through + MASS * (before - 2.0 * now + after) / step**2
    through[1] += 2.0 * MASS * GRAVITY
    # Ahead and up in the frame of what carries the leg, here the thigh itself.
    hip = angles[0]
    for name, (x, y) in {
        "anterior_m": (np.cos(hip), np.sin(hip)),
        "superior_m": (-np.sin(hip), np.cos(hip)),
    }.items():
        moment = change(found, "hip_center_offset", FOOT_HELD, **{name: 0.015})
        close(moment[0], -0.015 * (x * through[1] - y * through[0]))
        assert np.abs(moment[1]).max() == 0.0


def test_the_usual_spread_of_the_knee_center_is_the_lever_of_the_force_through_the_knee(found, leg):
    time, (hip, _), _, _ = leg

    def center(at):
        hip, knee = synthetic.angles(at)
        thigh, shank = (np.stack([np.sin(angle), -np.cos(angle)]) for angle in (hip, hip + knee))
        return LENGTH * thigh + TO_CENTER * shank

    step = 1e-4
    through = MASS * (center(time - step) - 2.0 * center(time) + center(time + step)) / step**2
    through += np.array([0.0, MASS * GRAVITY])[:, None, None] - force(time)[:2]
    # Ahead and up in the thigh, which carries the knee.
    for name, (x, y) in {
        "knee_anterior_m": (np.cos(hip), np.sin(hip)),
        "knee_superior_m": (-np.sin(hip), np.cos(hip)),
    }.items():
        moment = change(found, "joint_center_spread", **{name: 0.005})
        close(moment[1], -0.005 * (x * through[1] - y * through[0]))
        assert np.abs(moment[0]).max() == 0.0


def test_a_turned_knee_axis_contains_moments_across_the_hinge(found, leg):
    """The leg moves in a plane: across the hinge there is only the moment of the ground reaction force."""
    time, (hip, _), _, _ = leg
    arm = POINT[:, None, None] - np.stack([LENGTH * np.sin(hip), -LENGTH * np.cos(hip), 0.0 * hip])
    moment = -np.cross(arm, force(time), axis=0) - TORQUE[:, None, None]
    # About the thigh's long axis, outward on the left: from pointing right towards pointing forward.
    forward = np.stack([np.cos(hip), np.sin(hip), 0.0 * hip])
    expected = 0.1 * (forward * moment).sum(axis=0)
    turned = change(found, "joint_axis_rotation", FOOT_HELD, knee_rad=0.1)
    np.testing.assert_allclose(turned[1], expected, atol=1e-3 * np.abs(expected).max())
    assert np.abs(turned[0]).max() == 0.0
    # About what is forward: on the left the axis' right end, which is the inner one, comes down.
    downward = np.stack([np.sin(hip), -np.cos(hip), 0.0 * hip])
    expected = 0.1 * (downward * moment).sum(axis=0)
    tilted = change(found, "joint_axis_rotation", FOOT_HELD, knee_tilt_rad=0.1)
    np.testing.assert_allclose(tilted[1], expected, atol=1e-3 * np.abs(expected).max())
    assert np.abs(tilted[0]).max() == 0.0


def test_crossed_plates_exchange_shares_of_the_feet(subject, found, leg):
    """This foot's force, and the other's at this foot's center of pressure, by cross products."""
    time, (hip, _), _, _ = leg
    gait, _ = read_recorded_movement(subject)
    other = gait.other_foot_wrench()[3:].reshape(3, *time.shape)
    vertical = force(time)[1]
    limit = 0.05 * vertical.max()
    both = (vertical > limit) & (other[1] > limit)
    assert 0.1 < both.mean() < 0.9
    # Where the force's line and its moment about the upright meet the ground's plane.
    own = force(time)
    about = np.cross(POINT[:, None, None], own, axis=0) + TORQUE[:, None, None]
    center = np.stack([about[2], 0.0 * own[0], -about[0]]) / np.maximum(own[1], 1.0)
    knee = np.stack([LENGTH * np.sin(hip), -LENGTH * np.cos(hip), 0.0 * hip])
    for name, acting, moment in (
        ("own_share", own, about),
        ("leaked_share", other, np.cross(center, other, axis=0)),
    ):
        moments = [(moment - np.cross(joint, acting, axis=0))[2] for joint in (0.0 * knee, knee)]
        expected = -0.1 * np.where(both, np.stack(moments), 0.0)
        crossed = change(found, "crossed_plates", **{name: 0.1})
        np.testing.assert_allclose(crossed, expected, atol=1e-6 * np.abs(expected).max())


def test_wobbling_mass_at_impact_is_a_pulse_after_foot_strike(found, leg):
    time = leg[0]
    pulse = change(found, "wobbling_mass", "impact", hip_impulse=0.7, knee_impulse=0.4)
    vertical = force(time)[1]
    struck = (vertical[:, 1:] > 0.05 * vertical.max()) & (vertical[:, :-1] <= 0.05 * vertical.max())
    hip, knee = 0, 1
    for coordinate, impulse in ((hip, 0.7), (knee, 0.4)):
        np.testing.assert_allclose(np.trapezoid(pulse[coordinate], time, axis=-1), impulse, rtol=1e-3)
    for row in range(len(time)):
        assert struck[row].sum() == 1
        # The foot strikes late in these cycles, so the pulse goes on at their start.
        since = (np.flatnonzero(pulse[0, row] > 1e-9) - struck[row].argmax() - 1) % 100
        assert set(since) == set(range(1, 10))


def test_wobbling_mass_at_every_change_of_load_integrates_to_its_impulse(found, leg):
    time = leg[0]
    moment = change(found, "wobbling_mass", "every change of load", hip_impulse=0.7, knee_impulse=0.4)
    vertical = force(time)[1]
    for coordinate, impulse in ((0, 0.7), (1, 0.4)):
        given = cumulative_trapezoid(moment[coordinate], time, axis=-1, initial=0.0)
        expected = impulse * (vertical - vertical[:, :1]) / vertical.max(axis=1, keepdims=True)
        np.testing.assert_allclose(given, expected, atol=0.01 * impulse)


def test_missing_recordings_give_a_reason(subject, found):
    assert "cop_offset" in found and {"foot_deformation", "knee_laxity"}.isdisjoint(found)
    one, *others = subject.recordings
    for key, word in (("ground_forces", "no ground reaction forces"), ("external_loads", "on what body")):
        without = dataclasses.replace(subject, recordings=(dataclasses.replace(one, **{key: None}), *others))
        gait, reason = read_recorded_movement(without)
        assert gait is None and word in reason
    # The angles of the hip are not recorded.
    knee = dataclasses.replace(
        subject.trials,
        coordinates=("knee_angle_l",),
        moment_coordinates=("knee_angle_l",),
        angles=subject.trials.angles[:, 1:],
        angular_velocities=subject.trials.angular_velocities[:, 1:],
    )
    gait, reason = read_recorded_movement(dataclasses.replace(subject, trials=knee))
    assert gait is None and "angles of these trials lack hip_flexion_l" in reason


def test_an_unknown_body_is_named(subject, tmp_path):
    file = tmp_path / "loads.xml"
    file.write_text(LOADS.replace("tibia_l", "tibia_r"))
    wrong = tuple(dataclasses.replace(trial, external_loads=file) for trial in subject.recordings)
    with pytest.raises(InputError, match=r"loads.xml.*tibia_r.*no such body.*'tibia_l'"):
        read_recorded_movement(dataclasses.replace(subject, recordings=wrong))


@pytest.fixture(scope="module")
def recorded(data_folder):
    """A healthy adult with full kinematics and both feet on plates."""
    subject = load_subject(data_folder / "healthy_overground")
    gait = read_recorded_movement(subject)[0]
    return subject, gait, compute_measured_changes(gait)


def moments_of(gait):
    found = gait.mechanics.moments(gait.transmitted_wrenches()).reshape(-1, *gait.time.shape)
    return dict(zip(gait.mechanics.coordinates, found, strict=True))


def test_recorded_moments_are_reproduced(recorded):
    """The laboratory filtered the motion, so that terms with accelerations differ a little."""
    subject, gait, _ = recorded
    own = moments_of(gait)
    limits = {"hip_flexion_r": 6.0, "hip_adduction_r": 2.5, "knee_angle_r": 2.0, "ankle_angle_r": 0.4}
    for name, limit in limits.items():
        theirs = subject.trials.moments[:, subject.trials.moment_coordinates.index(name)]
        assert np.sqrt(np.mean((own[name] - theirs) ** 2)) < limit < 0.25 * np.abs(theirs).max()


def test_loads_of_the_foot(recorded):
    """The whole foot is loaded in mid-stance, the forefoot late in stance and not at foot strike."""
    _, gait, _ = recorded
    whole, forefoot = foot_loads(gait).values()
    np.testing.assert_allclose(whole, (gait.force[1] / gait.force[1].max()).reshape(whole.shape))
    # This cycle begins 15 % after the strike.
    assert forefoot.max() == 1.0 and 0.0 <= forefoot.min() < 0.03 and 25 < forefoot.argmax() < 50
    assert forefoot[0, :5].max() < 0.5 < whole[0, :5].min()


@pytest.mark.parametrize("where", ["whole foot", "forefoot"])
def test_foot_deformation_agrees_with_inverse_dynamics_of_the_changed_motion(recorded, where):
    subject, gait, found = recorded
    trials = subject.trials
    askew = np.zeros_like(trials.angles)
    askew[:, trials.coordinates.index("ankle_angle_r")] = 0.02 * foot_loads(gait)[where]
    step = trials.time[0, 1] - trials.time[0, 0]
    bent = dataclasses.replace(
        trials,
        angles=trials.angles + askew,
        angular_velocities=trials.angular_velocities + np.gradient(askew, axis=-1) / step,
    )
    moved, _ = read_recorded_movement(dataclasses.replace(subject, trials=bent))
    before, after = moments_of(gait), moments_of(moved)
    expected = np.stack([after[name] - before[name] for name in trials.moment_coordinates])
    slope = change(found, "foot_deformation", where, bend=0.02)
    np.testing.assert_allclose(slope[..., 5:-5], expected[..., 5:-5], atol=0.15 * np.abs(expected).max())


def test_soft_tissue_artifact_agrees_with_inverse_dynamics_of_the_changed_motion(recorded):
    """About every coordinate, for a slide and both shares."""
    subject, gait, found = recorded
    trials = subject.trials
    names = trials.moment_coordinates
    knee = names.index("knee_angle_r")
    rows = [trials.coordinates.index(name) for name in names]
    for when, (slide, by_phase) in skin_slides(np.linspace(0.0, 1.0, trials.time.shape[1])).items():
        duration = (trials.time[:, -1] - trials.time[:, 0])[:, None]
        angles, rates = trials.angles.copy(), trials.angular_velocities.copy()
        hip = rows[names.index("hip_flexion_r")]
        angles[:, rows[knee]] += (
            0.02 * slide + 0.01 * trials.angles[:, rows[knee]] + 0.03 * trials.angles[:, hip]
        )
        rates[:, rows[knee]] += 0.02 * by_phase / duration + 0.01 * trials.angular_velocities[:, rows[knee]]
        rates[:, rows[knee]] += 0.03 * trials.angular_velocities[:, hip]
        other = dataclasses.replace(trials, angles=angles, angular_velocities=rates)
        moved, _ = read_recorded_movement(dataclasses.replace(subject, trials=other))
        before, after = moments_of(gait), moments_of(moved)
        expected = np.stack([after[name] - before[name] for name in names])
        effect_sizes = np.zeros(3 * len(names))
        effect_sizes[knee :: len(names)] = 0.02, 0.01, 0.03
        slope = np.asarray(found["soft_tissue_artifact"][when](jnp.asarray(effect_sizes)))
        slope = np.moveaxis(slope, 1, 0)
        assert np.abs(expected).max() > 1.0
        np.testing.assert_allclose(slope[..., 5:-5], expected[..., 5:-5], atol=0.05 * np.abs(expected).max())


def moments_with(subject, file):
    return moments_of(read_recorded_movement(dataclasses.replace(subject, model_file=file))[0])


def with_other_joint(subject, coordinate, folder, change_frames):
    """Write the model with other frames of the joint that has a coordinate."""
    model = opensim.Model(str(subject.model_file))
    joint = model.updComponent(model.getCoordinateSet().get(coordinate).getJoint().getAbsolutePathString())
    joint = opensim.Joint.safeDownCast(joint)
    change_frames([opensim.PhysicalOffsetFrame.safeDownCast(joint.upd_frames(number)) for number in (0, 1)])
    model.finalizeConnections()
    file = folder / "other.osim"
    model.printToXML(str(file))
    return file


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_displaced_hip_agrees_with_inverse_dynamics_of_the_changed_model(recorded, tmp_path, axis):
    """OpenSim's inverse dynamics with the displaced hip and the recorded angles."""
    subject, _, found = recorded
    names = subject.trials.moment_coordinates
    step = 0.01

    def displaced(by):
        def change_frames(frames):
            where = frames[0].get_translation().to_numpy()
            where[axis] += by
            frames[0].set_translation(opensim.Vec3(*where))

        return moments_with(subject, with_other_joint(subject, "hip_flexion_r", tmp_path, change_frames))

    ahead, behind = displaced(step), displaced(-step)
    expected = np.stack([0.5 * (ahead[name] - behind[name]) for name in names])
    effect_size = {("anterior_m", "superior_m", "lateral_m")[axis]: step}
    slope = change(found, "hip_center_offset", FOOT_DISPLACED, **effect_size)
    assert np.abs(expected[names.index("ankle_angle_r")]).max() > 0.5
    np.testing.assert_allclose(slope, expected, atol=0.01 * np.abs(expected).max())
    # Where markers hold the foot, all but the hip is as it was.
    held = change(found, "hip_center_offset", FOOT_HELD, **effect_size)
    beyond = [row for row, name in enumerate(names) if not name.startswith("hip")]
    assert np.abs(held[beyond]).max() == 0.0 < np.abs(held).max()


@pytest.mark.parametrize(("effect_size", "axis"), [("knee_rad", 1), ("knee_tilt_rad", 0)])
def test_a_turned_knee_axis_agrees_with_inverse_dynamics_of_the_changed_model(
    recorded, tmp_path, effect_size, axis
):
    """OpenSim's inverse dynamics with the turned axis and the recorded angles."""
    subject, _, found = recorded
    names = subject.trials.moment_coordinates
    step = 0.05

    def turned(by):
        def change_frames(frames):
            # Thigh and shank have the same axes while this knee is straight.
            for frame in frames:
                before = Rotation.from_euler("XYZ", frame.get_orientation().to_numpy())
                after = Rotation.from_rotvec(by * np.eye(3)[axis]) * before
                frame.set_orientation(opensim.Vec3(*after.as_euler("XYZ").tolist()))

        return moments_with(subject, with_other_joint(subject, "knee_angle_r", tmp_path, change_frames))

    # Of a right leg, toes that turn out and an outer end that goes up.
    sign = -1.0
    more, less = turned(sign * step), turned(-sign * step)
    expected = np.stack([0.5 * (more[name] - less[name]) for name in names])
    slope = change(found, "joint_axis_rotation", FOOT_DISPLACED, **{effect_size: step})
    held = change(found, "joint_axis_rotation", FOOT_HELD, **{effect_size: step})
    knee, ankle = names.index("knee_angle_r"), names.index("ankle_angle_r")
    np.testing.assert_allclose(slope, expected, atol=0.02 * np.abs(expected).max())
    # Where markers hold the foot, the axis alone is another; a knee that is straight puts nothing elsewhere.
    assert np.abs(held[ankle]).max() == 0.0 < np.abs(held[knee]).max()
    bent = subject.trials.angles[0, subject.trials.coordinates.index("knee_angle_r")]
    assert abs(slope[ankle, 0, np.abs(bent).argmin()]) < 0.2 * np.abs(slope[ankle]).max()


def test_a_joint_without_offset_frames_is_not_displaced(recorded, tmp_path):
    """OpenSim reads such models, but does not write them."""
    subject, _, _ = recorded
    text = subject.model_file.read_text(encoding="utf-8")
    model = opensim.Model(str(subject.model_file))
    joint = model.getCoordinateSet().get("hip_flexion_r").getJoint()
    frame, body = (own.getName() for own in (joint.getChildFrame(), joint.getChildFrame().findBaseFrame()))
    own = f"<socket_child_frame>{frame}</socket_child_frame>"
    assert text.count(own) == 1
    file = tmp_path / "bare.osim"
    bare = f"<socket_child_frame>/bodyset/{body}</socket_child_frame>"
    file.write_text(text.replace(own, bare), encoding="utf-8")
    gait, _ = read_recorded_movement(dataclasses.replace(subject, model_file=file))
    assert np.abs(gait.derivative_by_joint("hip_flexion_r", np.ones(3), np.zeros(3))).max() == 0.0
    assert np.abs(gait.derivative_by_joint("knee_angle_r", np.ones(3), np.zeros(3))).max() > 0.0


def test_knee_laxity_is_a_lever_of_the_vertical_force(recorded):
    """A force further outward abducts the right leg, so that the abductors' moment (negative) is smaller."""
    subject, gait, found = recorded
    names = subject.trials.moment_coordinates
    moment = change(found, "knee_laxity", lever_m=0.01)
    expected = 0.01 * gait.force[1].reshape(gait.time.shape)
    adduction = names.index("hip_adduction_r")
    np.testing.assert_allclose(moment[adduction], expected, atol=0.1 * np.abs(expected).max())
    assert np.abs(np.delete(moment, adduction, axis=0)).max() == 0.0


def test_the_other_foot_is_estimated_half_a_cycle_away():
    """Symmetric gait over ground, along an axis that is not that of the laboratory."""
    frames = 21
    phase = np.linspace(0.0, 1.0, frames)
    ahead, right = np.array([0.0, 0.0, 1.0]), np.array([-1.0, 0.0, 0.0])
    pelvis = UP + 1.3 * phase[:, None] * ahead

    def foot(phase, side):
        """Force and point of a foot relative to the pelvis, the left one half a cycle after the right."""
        turn = 2.0 * np.pi * (phase if side > 0 else phase + 0.5)[:, None]
        load = 1.0 + np.cos(turn)
        force = 400.0 * load * UP + 50.0 * load * np.sin(turn) * ahead - side * 30.0 * load * right
        return force, 0.3 * np.cos(turn) * ahead + side * (0.1 + 0.02 * np.sin(turn)) * right - UP

    def wrench(side):
        force, point = foot(phase, side)
        twist = side * 5.0 * (1.0 + np.cos(2.0 * np.pi * (phase + 0.25 * (1 - side))))[:, None] * UP
        return np.concatenate([np.cross(point + pelvis, force) + twist, force], axis=1).T

    axes = np.stack([ahead, UP, right], axis=1)
    none = np.zeros((2, 6, frames))
    mechanics = Mechanics(
        bodies=("pelvis", "foot"),
        parents=("ground", "pelvis"),
        coordinates=(),
        moves=np.zeros((0, 2), dtype=bool),
        screw=np.zeros((0, 6, frames)),
        joint_center=np.zeros((0, 3, frames)),
        rotation=np.tile(axes[None, :, :, None], (2, 1, 1, frames)),
        origin=np.stack([pelvis.T, pelvis.T]),
        mass_wrench=none,
        inertia_wrench=none,
    )
    gait = RecordedMovement(
        side="r",
        time=phase[None],
        motion=Motion((), *(np.zeros((0, phase.size)) for _ in range(3))),
        mechanics=mechanics,
        loaded_bodies=("foot",),
        wrenches=wrench(1)[None],
        wrenches_by_latency=wrench(1)[None],
        other_wrench=None,
        analyse=lambda motion, shift: mechanics,
    )
    np.testing.assert_allclose(gait.rightward[:, 0], right, atol=1e-12)
    np.testing.assert_allclose(gait.other_foot_wrench(), wrench(-1), atol=1e-9)
    np.testing.assert_array_equal(
        dataclasses.replace(gait, other_wrench=none[0]).other_foot_wrench(), none[0]
    )
