"""Calibration of several tasks together: weights, moments that were not measured, tasks left out in turn."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from tests.subject.task_folders import SQUAT, add_trial, write_mixed_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.calibration.objective import MOMENT_ERROR
from wrapjax.calibration.sample_weights import (
    effective_samples,
    moment_errors_by_weight,
    samples_by_recording,
)
from wrapjax.calibration.uncertainty.uncertainty import uncertainty
from wrapjax.errors import InputError
from wrapjax.evaluation.evaluation import evaluate
from wrapjax.evaluation.left_out_tasks import LeftOutTasks, leave_out_tasks
from wrapjax.evaluation.metrics import LeftOutTask, errors_by_task
from wrapjax.evaluation.stored_run import read_curves
from wrapjax.path_sources.exact import exact_geometry
from wrapjax.report.calibration.evaluation_page import redraw_evaluation
from wrapjax.subject.subject import load_subject
from wrapjax.subject.trials import Trials


def test_rest_counts_for_one_sample_however_long():
    time = np.arange(6000) * 0.01
    noise = 0.1 * np.random.default_rng(0).standard_normal(time.size)
    assert effective_samples(np.full(time.size, 20.0), 0.01) == 1.0
    assert effective_samples(20.0 + noise, 0.01) < 3.0


def test_a_wave_counts_for_its_time_and_not_for_its_frames():
    def samples(duration, step):
        time = np.arange(0.0, duration, step)
        return effective_samples(50.0 * np.sin(2.0 * np.pi * time), step)

    assert samples(20.0, 0.01) == pytest.approx(samples(20.0, 0.002), rel=0.05)
    assert samples(40.0, 0.01) == pytest.approx(2.0 * samples(20.0, 0.01), rel=0.05)
    assert 20.0 < samples(20.0, 0.01) < 200.0


def test_noise_as_large_as_the_allowable_error_counts_for_half():
    noise = MOMENT_ERROR * np.random.default_rng(2).standard_normal(40000)
    assert effective_samples(noise, 0.05) == pytest.approx(0.5 * 40000 * 0.05 / 0.1, rel=0.05)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    folder = write_mixed_subject(tmp_path_factory.mktemp("mixed") / "subject")
    validation = SQUAT.replace("[[2.5, 5.0], [5.2, 5.6]]", "[[3.0, 4.5]]")
    return load_subject(add_trial(folder, "squat_again", validation, use="validation"))


def weights_of(trials: Trials) -> np.ndarray:
    errors = moment_errors_by_weight(trials)
    return MOMENT_ERROR**2 / np.square(errors)


def test_weights_follow_the_samples_and_keep_the_scale_of_the_cost(mixed):
    trials = mixed.trials.used_for("calibration")
    weight = weights_of(trials)
    known = np.isfinite(trials.moments)
    assert np.all(weight[~known] == 0.0) and np.all(weight[known] > 0.0)
    assert weight.mean() == pytest.approx(1.0)
    samples = samples_by_recording(trials)
    names = np.array(trials.recordings)
    for name in samples:
        share = weight[names == name].sum() / weight.sum()
        assert share == pytest.approx(samples[name] / sum(samples.values()))


def test_a_given_number_of_samples_overrides_the_estimate(mixed):
    trials = mixed.trials.used_for("calibration")
    given = np.where(np.array(trials.recordings) == "knee", 7.0, np.nan)
    samples = samples_by_recording(replace(trials, given_samples=given))
    assert samples["knee"] == pytest.approx(7.0)
    assert samples["walk_a"] == pytest.approx(samples_by_recording(trials)["walk_a"])
    assert moment_errors_by_weight(mixed.trials.only_gait()) is None


@pytest.fixture(scope="module")
def calibrated(mixed):
    return calibrate(mixed, "NGA", exact_geometry(mixed), starts=1)


def test_moments_that_were_not_measured_do_not_count(mixed, calibrated):
    problem = calibrated.result.solution.problem
    variables = problem.start(problem.initial)
    rows = np.asarray(eqx.filter_jit(problem.terms)(problem.initial)["joint_moment"])
    rows = rows.reshape(problem.measured.shape)
    known = np.isfinite(mixed.trials.used_for("calibration").moments)
    assert np.all(rows[~known] == 0.0) and np.all(rows[known] != 0.0)
    gradient = np.asarray(problem.linearized_at(variables).gradient)
    step = 1e-6 * np.random.default_rng(1).standard_normal(variables.size)
    change = float(problem.value_at(variables + step) - problem.value_at(variables - step))
    assert change == pytest.approx(4.0 * gradient @ step, rel=1e-3)


def test_all_tasks_are_predicted_and_errors_are_by_task(mixed, calibrated):
    assert calibrated.status.converged
    result = calibrated.result
    assert result.modelled.shape == mixed.trials.moments.shape and np.isfinite(result.modelled).all()
    rows = {(row.task, row.coordinate): row for row in errors_by_task(mixed.trials, result.modelled)}
    assert set(rows) == {
        ("gait", "hip_flexion_l"),
        ("gait", "knee_angle_l"),
        ("passive", "knee_angle_l"),
        ("movement", "hip_flexion_l"),
        ("movement", "knee_angle_l"),
    }
    assert rows["passive", "knee_angle_l"].seconds == pytest.approx(3.71)
    before = errors_by_task(mixed.trials, result.initial_modelled)
    assert sum(row.rmse for row in rows.values()) < sum(row.rmse for row in before)


@pytest.mark.slow
def test_every_task_is_left_out_in_turn(mixed, calibrated):
    left_out = leave_out_tasks(calibrated, starts=1)
    assert [row.without.task for row in left_out.rows] == ["gait", "gait", "passive", "movement", "movement"]
    for row in left_out.rows:
        assert row.without.rmse > 0.0 and row.with_all.seconds == row.without.seconds


def test_a_run_of_several_tasks_is_written_and_read_again(mixed, calibrated, tmp_path):
    errors = errors_by_task(mixed.trials, calibrated.result.modelled)
    left_out = LeftOutTasks(calibrated, tuple(LeftOutTask(row, row, converged=True) for row in errors))
    left_out.save(tmp_path / "run")
    table = (tmp_path / "run" / "left_out_tasks.csv").read_text().splitlines()
    assert len(table) == 1 + 2 * len(left_out.rows)
    page = (tmp_path / "run" / "report.html").read_text()
    assert "Tasks left out in turn" in page and "Muscle activations" in page
    with pytest.raises(InputError, match="other tasks than gait"):
        read_curves(tmp_path / "run", mixed)
    evaluated = evaluate(tmp_path / "run", mixed)
    np.testing.assert_allclose(evaluated.modelled, calibrated.result.modelled, rtol=1e-6, atol=1e-6)
    evaluated.save(tmp_path / "evaluation")
    before = (tmp_path / "evaluation" / "report.html").read_text()
    redraw_evaluation(tmp_path / "evaluation")
    assert len((tmp_path / "evaluation" / "report.html").read_text()) == pytest.approx(len(before), rel=0.01)


def test_one_task_cannot_be_left_out(mixed, calibrated):
    alone = replace(mixed, trials=mixed.trials.only_gait())
    with pytest.raises(InputError, match="two or more tasks"):
        leave_out_tasks(replace(calibrated, subject=alone))


def test_uncertainty_names_what_it_cannot_treat(calibrated):
    with pytest.raises(InputError, match="found other tasks"):
        uncertainty(calibrated)
    gait = calibrated.subject.trials.only_gait()
    weighted = replace(calibrated.subject, trials=replace(gait, given_samples=np.full(len(gait), 7.0)))
    with pytest.raises(InputError, match="found trials with 'effective_samples'"):
        uncertainty(replace(calibrated, subject=weighted))
