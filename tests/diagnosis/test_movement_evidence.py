"""Defends: in other movements errors of forces, markers and joints change what they change in gait."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.walking_and_tasks import load_with_seven_cycles
from tests.subject.synthetic_forces import add_forces, force
from tests.subject.task_folders import DURATION, slow_angles, write_mixed_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.diagnosis.diagnosis import diagnosis_input
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.effects.measured_motion import foot_loads
from wrapjax.diagnosis.evidence.linearization import linearize
from wrapjax.diagnosis.evidence.other_tasks import other_tasks, task_evidence
from wrapjax.diagnosis.evidence.score import score
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.path_sources.path_fitting import fit
from wrapjax.subject.gait_alone import with_gait_alone

KEPT = {
    "cop_offset",
    "segment_inertia",
    "wobbling_mass",
    "soft_tissue_artifact",
    "hip_center_offset",
    "emg_drift",
}
WITHOUT = sorted(set(CATALOGUE) - KEPT)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """Walking and a squat, both with ground reaction forces, and a passive rotation of the knee."""
    folder = write_mixed_subject(tmp_path_factory.mktemp("subjects") / "squatting")
    add_forces(folder, DURATION)
    return load_with_seven_cycles(folder)


@pytest.fixture(scope="module")
def calibration(mixed):
    gait = with_gait_alone(mixed, "this test")
    return calibrate(dataclasses.replace(gait, other_leg=None), "NGA", fit(mixed), starts=2)


@pytest.fixture(scope="module")
def data(calibration):
    return diagnosis_input(calibration, WITHOUT)


@pytest.fixture(scope="module")
def others(calibration, data, mixed):
    return other_tasks(calibration, data, mixed)


def rows_of(others, task):
    return np.flatnonzero(np.array(others.tasks) == task)


def measured_change(others, id, variant="", **effect_sizes):
    names = [entry.name for entry in CATALOGUE[id].build(others.context).parameters]
    vector = np.zeros(len(names))
    for name, effect_size in effect_sizes.items():
        vector[names.index(name)] = effect_size
    return np.asarray(others.context.measured_changes[id][variant](jnp.asarray(vector)))


def test_a_displaced_center_of_pressure_changes_the_moments_of_a_squat(others):
    """The vertical force's lever about either hinge grows by the offset."""
    change = measured_change(others, "cop_offset", anterior_m=0.01)
    squat = rows_of(others, "movement")
    assert len(squat) > 1
    lever = -0.01 * force(others.time[squat])[1]
    # The last window extends beyond the recording.
    recorded = np.isfinite(others.measured[squat, 0])
    for coordinate in range(2):
        np.testing.assert_allclose(change[squat, coordinate][recorded], lever[recorded], atol=1e-3)


def test_the_mass_of_a_segment_changes_the_moments_of_a_squat(others):
    """In a slow movement the shank's weight, in the main, acts about the knee."""
    change = measured_change(others, "segment_inertia", mass_fraction_shank=0.1)
    squat = rows_of(others, "movement")
    hip, knee = slow_angles(others.time[squat])
    weight = 0.1 * 5.0 * 9.80665 * 0.2 * np.sin(hip + knee)
    known = np.isfinite(others.measured[squat, 1])
    difference = np.abs(change[squat, 1] + weight)[known]
    assert difference.max() < 0.15 * np.abs(weight).max()


def test_gait_has_its_own_changes_and_passive_trials_have_none(others, data):
    gait, passive = rows_of(others, "gait"), rows_of(others, "passive")
    for id, variants in data.calibration_context.measured_changes.items():
        for label, change in variants.items():
            parameters = CATALOGUE[id].build(others.context).parameters
            sizes = jnp.asarray([entry.prior_sd for entry in parameters])
            found = np.asarray(others.context.measured_changes[id][label](sizes))
            np.testing.assert_array_equal(found[gait], np.asarray(change(sizes)))
            np.testing.assert_array_equal(found[passive], 0.0)
    for id, variants in data.calibration_context.path_changes.items():
        for label, paths in variants.items():
            joined = others.context.path_changes[id][label]
            np.testing.assert_array_equal(joined.length[:, :, gait], paths.length)
            np.testing.assert_array_equal(joined.moment_arm[:, :, passive], 0.0)
            squat = joined.length[:, :, rows_of(others, "movement")]
            assert np.any(squat) == np.any(paths.length)
    assert data.calibration_context.path_changes


def test_what_has_a_phase_of_gait_is_zero_in_a_squat(others):
    """A slide of the skin at a phase, and soft tissue after a strike; a share of the angle is in both."""
    squat, gait = rows_of(others, "movement"), rows_of(others, "gait")
    slide = measured_change(others, "soft_tissue_artifact", "loading", slide_knee_angle_l=0.06)
    share = measured_change(others, "soft_tissue_artifact", "loading", share_knee_angle_l=0.06)
    impact = measured_change(others, "wobbling_mass", "impact", knee_impulse=0.5)
    for one in (slide, impact):
        assert np.abs(one[squat]).max() == 0.0 < np.abs(one[gait]).max()
    assert np.abs(share[squat]).max() > 0.0


def test_loads_are_relative_to_those_of_the_gait(data_folder):
    """Twice the force bends a foot twice as much."""
    from wrapjax.subject.subject import load_subject

    gait = read_recorded_movement(load_subject(data_folder / "healthy_overground"))[0]
    stronger = dataclasses.replace(gait, wrenches=2.0 * gait.wrenches, gait=gait)
    before, after = foot_loads(gait), foot_loads(stronger)
    np.testing.assert_allclose(after["whole foot"], 2.0 * before["whole foot"])
    assert after["forefoot"].max() == pytest.approx(2.0, rel=0.02)
    weaker = dataclasses.replace(gait, wrenches=0.01 * gait.wrenches, gait=gait)
    assert gait.in_contact.any() and not weaker.in_contact.any()
    assert not dataclasses.replace(gait, other_wrench=None, gait=gait).other_foot_wrench().any()


#: Offset of the center of pressure forwards and outwards, m.
OFFSET = np.array([0.05, 0.0])


@pytest.fixture(scope="module")
def evidence(others, data):
    """Function from the offset of the center of pressure in the squat, which gait has, to what tasks add."""

    def offset_moments(context, recording, sizes):
        effects = Effects((CATALOGUE["cop_offset"].build(context),))
        parameters = data.law.held.parameters(jnp.asarray(data.variables))
        curves = data.law.held.curves
        return np.asarray(predicted_moments(curves, parameters, recording, effects, jnp.asarray(sizes)))

    def added(context, recording):
        return offset_moments(context, recording, OFFSET) - offset_moments(context, recording, 0.0 * OFFSET)

    walking = dataclasses.replace(data, measured=data.measured + added(data.context, data.recording))
    linearized = linearize(walking, walking.variables)
    none = np.zeros((0, linearized.residual.size))
    scores = score(linearized, walking.measured_moment_sd, none, 2.0)
    gait = others.context.is_gait[:, None, None]

    def of(sizes):
        changed = np.where(
            gait,
            others.measured + added(others.context, others.recording),
            offset_moments(others.context, others.recording, sizes),
        )
        measured = np.where(np.isfinite(others.measured), changed, np.nan)
        tasks = dataclasses.replace(others, measured=measured)
        return task_evidence(walking, tasks, linearized, walking.variables, scores)[0]

    return of


@pytest.mark.slow
def test_a_squat_confirms_or_refutes_a_displaced_center_of_pressure(evidence):
    confirmed, refuted = evidence(OFFSET), evidence(-OFFSET)
    # Without signatures in the squat either sign would add the same.
    assert confirmed.added["cop_offset"] > refuted.added["cop_offset"] + 2.0
    assert not confirmed.not_used and {one.recording for one in confirmed.errors} == {"knee", "squat"}


def test_a_movement_without_the_forces_that_gait_has_is_not_used(calibration, data, mixed):
    recordings = tuple(
        dataclasses.replace(entry, ground_forces=None) if entry.name == "squat" else entry
        for entry in mixed.recordings
    )
    found = other_tasks(calibration, data, dataclasses.replace(mixed, recordings=recordings))
    assert set(found.tasks) == {"gait", "passive"}
    assert "ground reaction forces" in found.not_used["squat"]


def test_why_a_recording_is_not_used(calibration, data, mixed):
    trials = mixed.trials
    uses = tuple(
        "validation" if name == "knee" else use
        for name, use in zip(trials.recordings, trials.uses, strict=True)
    )
    recordings = tuple(
        dataclasses.replace(entry, use="validation") if entry.name == "knee" else entry
        for entry in mixed.recordings
    )
    moments = trials.moments.copy()
    moments[np.array(trials.recordings) == "squat", :, 5:] = np.nan
    changed = dataclasses.replace(
        mixed, recordings=recordings, trials=dataclasses.replace(trials, uses=uses, moments=moments)
    )
    assert other_tasks(calibration, data, changed) is None
    squat_alone = dataclasses.replace(
        changed, trials=dataclasses.replace(changed.trials, moments=trials.moments)
    )
    found = other_tasks(calibration, data, squat_alone)
    assert found.not_used == {"knee": "it is for validation"}
