"""Defends: passive and isometric trials add evidence for effects that they show, and none for others."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.walking_and_tasks import load_with_seven_cycles
from tests.subject.task_folders import write_mixed_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.diagnosis.diagnosis import diagnose_calibrated, diagnosis_input
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.evidence.linearization import linearize
from wrapjax.diagnosis.evidence.other_tasks import MOST_WINDOWS, chosen_windows, other_tasks, task_evidence
from wrapjax.diagnosis.evidence.score import score
from wrapjax.diagnosis.evidence.task_covariance import ErrorSizes, LinearizedTasks, TaskCovariance
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.diagnosis.inputs.input import phase_frames
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.path_sources.path_fitting import fit
from wrapjax.subject.gait_alone import with_gait_alone

KEPT = {"joint_damping", "emg_drift", "curve_family"}
WITHOUT = sorted(set(CATALOGUE) - KEPT)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """Seven cycles of walking, six of them for calibration, a passive rotation of the knee, and a squat."""
    return load_with_seven_cycles(write_mixed_subject(tmp_path_factory.mktemp("subjects") / "mixed"))


@pytest.fixture(scope="module")
def calibration(mixed):
    """Calibration to walking alone, with paths that hold over all tasks."""
    gait = with_gait_alone(mixed, "this test")
    return calibrate(dataclasses.replace(gait, other_leg=None), "NGA", fit(mixed), starts=2)


@pytest.fixture(scope="module")
def gait(calibration):
    """Input, linearised model and scores of the gait alone."""
    data = diagnosis_input(calibration, WITHOUT)
    linearized = linearize(data, data.variables)
    none = np.zeros((0, linearized.residual.size))
    return data, linearized, score(linearized, data.measured_moment_sd, none, 2.0)


def with_damping(others, data, sizes):
    """Give the windows the moments of the model that was calibrated to gait, with this damping of joints."""
    effect = CATALOGUE["joint_damping"].build(others.context)
    parameters = data.law.held.parameters(jnp.asarray(data.variables))
    predicted = predicted_moments(
        data.law.held.curves, parameters, others.recording, Effects((effect,)), jnp.asarray(sizes)
    )
    device = ~others.context.is_gait[:, None, None] & np.isfinite(others.measured)
    return dataclasses.replace(others, measured=np.where(device, predicted, others.measured))


@pytest.fixture(scope="module")
def evidence(gait, mixed, calibration):
    """Function from the damping in the passive trial to what other tasks add, and the scores with it."""
    data, linearized, scores = gait
    others = other_tasks(calibration, data, mixed)

    def of(sizes):
        changed = with_damping(others, data, sizes)
        return task_evidence(data, changed, linearized, data.variables, scores)

    return of


@pytest.fixture(scope="module")
def damped(gait, evidence):
    """The passive trial has the damping that gait alone suggests."""
    return evidence(gait[2].by_id["joint_damping"].effect_sizes)


def test_a_passive_trial_confirms_or_refutes_what_gait_suggests(damped, evidence):
    """Damping is shown where a joint is moved; a drift of EMG says nothing of muscles at rest."""
    refuted, _ = evidence(np.zeros(2))
    assert damped[0].added["joint_damping"] > 0.5
    assert refuted.added["joint_damping"] < -3.0
    assert max(abs(one.added["emg_drift"]) for one in (damped[0], refuted)) < 0.5


def test_scores_are_those_of_gait_with_what_is_added(damped, gait):
    found, scores = damped
    before = gait[2].by_id
    for id, one in scores.by_id.items():
        assert one.evidence == pytest.approx(before[id].evidence + found.added[id])
        assert one.detectability >= before[id].detectability
    order = [one.evidence for one in scores.by_id.values()]
    assert order == sorted(order, reverse=True) and scores.compared == tuple(scores.by_id)


def tasks_of(gait, is_gait):
    """Regard cycles of gait that are not marked as two halves of one trial of another task."""
    data, linearized, _ = gait
    cycles, coordinates, _ = linearized.residual.shape
    angles = np.asarray(data.calibration_context.angles)[..., phase_frames(data.measured.shape[-1])]
    size = np.tile(data.measured_moment_sd, (cycles, 1))
    everything = np.ones((cycles, coordinates), dtype=bool)
    trial = np.where(is_gait, 0, 1)
    return LinearizedTasks(linearized, linearized.speeds, is_gait, everything, size, trial, angles)


def test_rows_of_gait_have_the_null_of_the_score_test(gait):
    data, linearized, _ = gait
    tasks = tasks_of(gait, np.ones(6, dtype=bool))
    found = TaskCovariance.of(tasks, np.arange(linearized.residual.size))(ErrorSizes(0.02, 0.03))
    expected = list(nulls(linearized, data.measured_moment_sd))
    nearest = min(np.abs(found - null.covariance).max() for null in expected)
    assert nearest < 1e-9 * np.abs(found).max()


def test_a_usual_amount_of_each_effect_is_allowed_in_other_tasks_alone(gait):
    _, linearized, _ = gait
    tasks, rows = tasks_of(gait, np.array([True] * 4 + [False] * 2)), np.arange(linearized.residual.size)
    none = dataclasses.replace(tasks, linearized=dataclasses.replace(linearized, candidates=()))
    with_effects, without = (TaskCovariance.of(one, rows).fixed for one in (tasks, none))
    added, windows = with_effects - without, 4 * linearized.residual[0].size
    tolerance = 1e-9 * np.abs(with_effects).max()
    assert np.abs(added[:windows]).max() < tolerance
    variances = [
        np.square(0.3 * one.prior_sd[:, None] * variant[:, windows:]).sum(axis=0) / len(one.variants)
        for one in linearized.candidates
        for variant in one.variants
    ]
    np.testing.assert_allclose(np.diag(added)[windows:], np.sum(variances, axis=0), atol=tolerance)
    assert np.sum(variances) > 1e3 * tolerance


def test_errors_by_angle_are_alike_where_angles_of_one_trial_are(gait):
    _, linearized, _ = gait
    tasks = tasks_of(gait, np.array([True] * 4 + [False] * 2))
    covariance = TaskCovariance.of(tasks, np.arange(linearized.residual.size))
    cycles, coordinates, phases = linearized.residual.shape
    by_angle = covariance.by_angle.reshape(cycles, coordinates, phases, cycles, coordinates, phases)
    np.testing.assert_array_equal(by_angle[:4], 0.0)
    np.testing.assert_array_equal(by_angle[4:, 0, :, :, 1], 0.0)
    size = np.square(tasks.moment_size[4, 0])
    apart = np.abs(tasks.angles[4, 0, :, None] - tasks.angles[5, 0, None])
    alike = by_angle[4, 0, :, 5, 0] / size
    assert (alike[apart < 0.05] > 0.98).all() and (alike[apart > 0.7] < 0.14).all()
    np.testing.assert_allclose(covariance.by_angle, covariance.by_angle.T)
    assert np.linalg.eigvalsh(covariance.by_angle).min() > -1e-9 * size


def test_errors_of_each_recording_are_reported(damped):
    error, *of_squat = damped[0].errors
    assert (error.recording, error.task, error.coordinate) == ("knee", "passive", "knee_angle_l")
    assert [(one.recording, one.task) for one in of_squat] == [("squat", "movement")] * 2
    assert error.windows == 4 and 0.0 < error.rms <= error.worst_rms
    assert 1.0 - 1e-6 <= error.time[0] < error.time[1] <= 4.7 + 1e-6 and error.angle[0] < error.angle[1]


def test_windows_are_spread_over_the_recordings(mixed):
    """A long recording does not displace a short one."""
    own = chosen_windows(mixed.trials, {"knee"})
    places = np.concatenate([np.resize(own[1:3], 60), own[1:2]])
    trials = dataclasses.replace(
        mixed.trials.select(places), recordings=(*("long",) * 60, "short"), names=tuple(map(str, range(61)))
    )
    chosen = chosen_windows(trials, {"long", "short"})
    assert len(chosen) == MOST_WINDOWS and chosen[-1] == 60
    assert np.ptp(np.diff(chosen[:-1])) <= 1


@pytest.mark.slow
def test_a_whole_diagnosis_uses_them(mixed, calibration, tmp_path):
    alone = diagnose_calibrated(calibration, without=WITHOUT, null_replicates=2).result
    found = diagnose_calibrated(calibration, without=WITHOUT, null_replicates=2, all_tasks=mixed)
    assert alone.task_evidence is None
    evidence = {one.id: one.evidence for one in alone.effects}
    added = found.result.task_evidence.added
    for one in found.result.effects:
        assert one.evidence - added[one.id] == pytest.approx(evidence[one.id], abs=1e-9)
    found.save(tmp_path / "gap")
    content = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert set(content["other_tasks"]["added_nats"]) == set(added)
    where = [entry for entry in content["where"] if "angle_deg" in entry]
    assert {(entry["recording"], entry["coordinate"]) for entry in where} == {
        ("knee", "knee_angle_l"),
        ("squat", "knee_angle_l"),
        ("squat", "hip_flexion_l"),
    }
    assert "Other tasks" in (tmp_path / "gap" / "report.html").read_text()
