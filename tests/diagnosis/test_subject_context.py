"""The context of effects agrees with the recording and the calibration."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.subject.synthetic import COORDINATES, write_wrapped_subject
from tests.subject.synthetic_forces import with_forces
from wrapjax.diagnosis.effects.catalogue import CATALOGUE, available_effects, catalogue
from wrapjax.diagnosis.effects.effect import Effects, NotTestable
from wrapjax.diagnosis.effects.scaled_model import FOOT_HELD, JOINT_AXIS_ROTATION
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.diagnosis.inputs.recorded_paths import RecordedPaths
from wrapjax.diagnosis.inputs.subject_context import build_context, wrap_changes
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.skeleton.joint_changes import with_moved_ends
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.path_sources.exact import build_engine
from wrapjax.subject.subject import load_subject as load_subject


@pytest.fixture(scope="module")
def recording_and_context(calibrated):
    # A muscle with EMG is used as one without.
    without = ("semiten_l",)
    subject = dataclasses.replace(
        calibrated.subject,
        undriven_muscles=without,
        undriven_parameters=calibrated.subject.muscles.select(without),
    )
    return build_context(dataclasses.replace(calibrated, subject=subject))


def test_zero_effect_sizes_predict_as_the_calibration(calibrated, recording_and_context):
    recording, context = recording_and_context
    ids = ("missing_drive", "emg_drift", "soft_tissue_artifact", "muscle_attachment")
    effects = Effects(tuple(CATALOGUE[id].build(context) for id in ids))
    curves = HILL_CURVES[calibrated.result.curves]
    found = predicted_moments(curves, context.parameters, recording, effects, effects.zero)
    np.testing.assert_allclose(found, calibrated.result.modelled, rtol=1e-10, atol=1e-9)
    assert context.coordinates == COORDINATES and context.trials == calibrated.result.trials
    np.testing.assert_allclose(context.duration, 1.2)


def test_unmet_requirements_give_reasons(recording_and_context):
    reasons = {
        entry.id: entry.reason
        for entry in catalogue(recording_and_context[1])
        if isinstance(entry, NotTestable)
    }
    assert "not given" in reasons["speed_dependent_delay"]
    assert "ground reaction forces" in reasons["cop_offset"]
    assert "ankle" in reasons["ankle_foot_orthosis"]
    assert "none is touched" in reasons["wrap_surface"]
    assert {"missing_drive", "muscle_attachment", "soft_tissue_artifact"}.isdisjoint(reasons)


def test_bounds_are_those_that_calibration_ended_on(calibrated, recording_and_context):
    _, context = recording_and_context
    found = {f"{entry.muscle}.{entry.parameter}" for entry in context.at_bounds}
    assert found == set(calibrated.result.at_bounds)
    for entry in context.at_bounds:
        assert 0.0 < entry.prior_sd < entry.limit and entry.unit and entry.outward in (1, -1)
        at = getattr(calibrated.result.parameters, entry.parameter)[context.muscles.index(entry.muscle)]
        assert entry.outward > 0 or at == 0.0 or at - entry.limit > 0.0


def test_paths_of_muscles_without_emg_are_those_of_the_model(recording_and_context):
    """The exact engine against the polynomials of the same muscle, which were fitted to OpenSim."""
    _, context = recording_and_context
    undriven = context.undriven_muscles
    assert undriven.names == ("semiten_l",) and undriven.groups[0][1] == ("semiten_l",)
    row = context.muscles.index("semiten_l")
    np.testing.assert_allclose(undriven.path.length[0], context.paths.length[row], atol=2e-4)
    np.testing.assert_allclose(undriven.path.moment_arm[0], context.paths.moment_arm[row], atol=2e-3)


def test_derivatives_of_paths_by_angles(calibrated, recording_and_context):
    """Length by the moment arm, velocities and moment arms by differences of the polynomials."""
    _, context = recording_and_context
    by_angle = context.paths_by_angle
    np.testing.assert_allclose(-by_angle.length, np.moveaxis(context.paths.moment_arm, 1, 2), atol=1e-12)
    subject, surrogate = calibrated.subject, calibrated.fit.surrogate.select_muscles(context.muscles)
    trials = subject.trials
    recorded = [trials.coordinates.index(name) for name in surrogate.coordinates]
    angles, velocities = trials.angles[:, recorded], trials.angular_velocities[:, recorded]
    about = [surrogate.coordinates.index(name) for name in context.coordinates]
    for number, column in enumerate(about):
        step = np.zeros(angles.shape)
        step[:, column] = 1e-5
        above, below = (
            surrogate(jnp.asarray(angles + sign * step), jnp.asarray(velocities)) for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(
            by_angle.velocity[:, number], (above.velocity - below.velocity) / 2e-5, atol=1e-7
        )
        np.testing.assert_allclose(
            by_angle.moment_arm[:, number],
            (above.moment_arm - below.moment_arm)[:, :, about] / 2e-5,
            atol=1e-7,
        )


def _from_insertion(context):
    """Unit vectors from each muscle's insertion to its origin, in the plane of the leg."""
    hip, knee = np.moveaxis(context.angles, 1, 0)
    forward = {"recfem_l": 0.05, "semiten_l": -0.05}

    def turned(angle, x, y):
        return np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y

    for muscle in context.muscles:
        x, y = turned(knee, forward[muscle], -0.05)
        x, y = turned(hip, x, y - 0.4)
        away = np.stack([forward[muscle] - x, -y])
        yield away / np.linalg.norm(away, axis=0)


def test_derivatives_of_paths_by_their_ends(recording_and_context):
    """A straight path in a plane gets longer by the displacement along it."""
    _, context = recording_and_context
    for row, expected in enumerate(_from_insertion(context)):
        for axis in range(3):
            changes = np.zeros((2, 6))
            changes[row, axis] = 1.0
            found = context.attachments.by_muscle(jnp.asarray(changes)).length[row]
            np.testing.assert_allclose(found, expected[axis] if axis < 2 else 0.0, atol=1e-6)
    assert context.attachments.names[0] == f"{context.muscles[0]}.origin_x_m"


@pytest.mark.slow
def test_derivatives_of_paths_by_wraps(tmp_path):
    """A cylinder that is half a millimetre thicker lengthens the paths that touch it."""
    subject = load_subject(write_wrapped_subject(tmp_path / "wrapped"))
    changes = wrap_changes(build_engine(subject), subject)
    assert changes.names[-1] == "ST_at_condyles_l.radius_factor"
    thicker = np.where(changes.places == 5, 0.5e-3 / 0.035, 0.0)
    longer = np.asarray(changes.by_muscle(jnp.asarray(thicker)).length)
    rows = [subject.muscles.names.index(name) for name in ("recfem_l", "semiten_l")]
    assert np.abs(longer[rows[0]]).max() == 0.0
    # A path that is deflected by less than half a turn gains at most pi times the change of the radius.
    assert 1e-4 < longer[rows[1]].max() < np.pi * 0.5e-3 and longer[rows[1]].min() > -1e-12


@pytest.fixture(scope="module")
def with_ground(calibrated, tmp_path_factory):
    subject = with_forces(tmp_path_factory.mktemp("ground") / "person")
    return build_context(dataclasses.replace(calibrated, subject=subject))[1]


def test_derivatives_of_paths_by_the_hip_center(with_ground):
    """Where the model's hip is too far forward or up, the person's insertions are behind or below."""
    slopes = with_ground.path_changes["hip_center_offset"][FOOT_HELD]
    for row, away in enumerate(_from_insertion(with_ground)):
        np.testing.assert_allclose(slopes.length[row, 0], away[0], atol=1e-6)
        np.testing.assert_allclose(slopes.length[row, 1], away[1], atol=1e-6)
        np.testing.assert_allclose(slopes.length[row, 2], 0.0, atol=1e-6)


def test_derivatives_of_paths_by_the_knee_axis(tmp_path):
    """With insertions beside the plane of the leg, which a turned axis displaces."""
    subject = with_forces(tmp_path / "person")
    whole = build_engine(subject)
    beside = ExactPaths(
        with_moved_ends(whole.model, whole.muscles, -1, 2, 0.03), whole.muscles, whole.coordinates
    )
    gait, _ = read_recorded_movement(subject)
    slopes = JOINT_AXIS_ROTATION.path_derivatives(RecordedPaths(subject, gait, beside))[FOOT_HELD]
    hip, knee = np.moveaxis(subject.trials.angles, 1, 0)
    forward = {"recfem_l": 0.05, "semiten_l": -0.05}

    def length(muscle, turn):
        # The person's axis is turned the other way than the model's.
        axis = Rotation.from_rotvec(-np.array(turn)).apply([0.0, 0.0, 1.0])
        bent = Rotation.from_rotvec(knee.ravel()[:, None] * axis)
        thigh = Rotation.from_rotvec(hip.ravel()[:, None] * [0.0, 0.0, 1.0])
        insertion = thigh.apply(bent.apply([forward[muscle], -0.05, 0.03]) - [0.0, 0.4, 0.0])
        return np.linalg.norm(insertion - [forward[muscle], 0.0, 0.0], axis=1).reshape(knee.shape)

    # On the left, toes that turn out turn about what points up, and an axis whose left end goes up about what
    # points forward.
    for row, muscle in enumerate(whole.muscles):
        for place, about in ((0, (0.0, 1e-4, 0.0)), (1, (1e-4, 0.0, 0.0))):
            expected = (length(muscle, about) - length(muscle, np.negative(about))) / 2e-4
            assert np.abs(expected).max() > 1e-3
            np.testing.assert_allclose(slopes.length[row, place], expected, atol=1e-7)
    # There is neither ankle nor subtalar joint.
    assert np.abs(slopes.length[:, 2:]).max() == 0.0


def test_measured_changes_of_selected_cycles(with_ground):
    context = with_ground
    effects = available_effects(catalogue(context))
    sizes = {effect.id: effect.parameters for effect in effects}
    assert set(context.measured_changes) <= set(sizes) and "crossed_plates" in sizes
    assert "loading" in context.measured_changes["soft_tissue_artifact"]
    part = context.select([2, 0])
    for id, changes in context.measured_changes.items():
        effect_sizes = jnp.array([parameter.prior_sd for parameter in sizes[id]])
        for label, change in changes.items():
            np.testing.assert_array_equal(
                part.measured_changes[id][label](effect_sizes), change(effect_sizes)[np.array([2, 0])]
            )
            assert np.abs(change(0.0 * effect_sizes)).max() == 0.0
