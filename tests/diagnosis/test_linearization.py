"""Linearisation of a calibrated model, and the score of effects on it.

The last test is on data of the model's own form: it shows that the pieces fit, and is no accuracy.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.subject import CURVES, MUSCLES, small_recording_and_context
from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.evidence.linearization import linearized_model, mean_emg, moment_slopes
from wrapjax.diagnosis.evidence.score_test import score_each
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.diagnosis.inputs.input import phase_frames
from wrapjax.diagnosis.null_hypotheses.null_covariance import fixed_covariance, nulls
from wrapjax.model.forward import joint_moments
from wrapjax.model.freedom import nga_freedom
from wrapjax.model.variables import free_variables

EFFECTS = ("joint_damping", "ankle_foot_orthosis", "emg_drift", "slow_fibers", "curve_family")


@pytest.fixture(scope="module")
def setting():
    """A leg with joint damping and smooth noise; the plain model has the true parameters."""
    recording, context = small_recording_and_context()
    base = context.parameters
    free = free_variables(base, nga_freedom(base), context.muscles)
    effects = tuple(CATALOGUE[id].build(context) for id in EFFECTS)
    damping = Effects(effects[:1])
    effect_sizes = 2.0 * damping.prior_sd
    moments = np.asarray(predicted_moments(CURVES, base, recording, damping, jnp.asarray(effect_sizes)))
    generator = np.random.default_rng(2)
    measured = moments + 0.5 * generator.normal(size=(*moments.shape[:2], 1))
    problem = Objective(
        limits=(),
        curves=CURVES,
        recording=recording,
        measured=jnp.asarray(measured),
        variables=free,
        penalties=(),
    )
    linearized = linearized_model(problem, free.start(), recording, measured, context, effects)
    return problem, recording, measured, linearized, effect_sizes


def test_the_residual_is_at_the_prior_mean_of_the_parameters(setting):
    """To first order: halving the distance quarters the difference."""
    problem, recording, measured, linearized, _ = setting
    free, frames = problem.variables, phase_frames(measured.shape[-1])
    start = np.asarray(free.start())
    precision = np.asarray(free.prior_precision)
    to_expected = -linearized.from_prior_mean
    # With as many muscles as variables of a kind, and no penalty, this is the mean of the calibration's
    # prior, apart from the small influence of the bounds.
    known = precision > 0.0
    np.testing.assert_allclose(
        (start - linearized.from_prior_mean)[known], np.asarray(free.prior_mean)[known], atol=0.15
    )
    slope = np.tensordot(to_expected, linearized.slopes, axes=1)
    np.testing.assert_allclose(linearized.residual, linearized.fitted_residual - slope, atol=1e-9)
    quiet = dataclasses.replace(recording, emg=mean_emg(recording.emg, linearized.speeds))

    def left(share):
        moments = joint_moments(CURVES, free.unpack(jnp.asarray(start + share * to_expected)), quiet)
        return (measured - np.asarray(moments))[..., frames]

    near_fit = left(0.0)
    far, near = (np.abs(left(share) - (near_fit - share * slope)).max() for share in (2e-3, 1e-3))
    assert near == pytest.approx(far / 4.0, rel=0.1)


def test_moving_the_residual_adds_no_noise_of_emg(setting):
    """The move is in the span of the calibrated parameters, which are part of the null hypothesis."""
    linearized = setting[3]
    moved = (linearized.residual - linearized.fitted_residual).ravel()
    lines = linearized.calibrated.reshape(linearized.calibrated.shape[0], -1)
    effect_sizes = np.linalg.lstsq(lines.T, moved, rcond=None)[0]
    np.testing.assert_allclose(lines.T @ effect_sizes, moved, atol=1e-9 * np.abs(moved).max())


def test_noise_of_emg_is_not_in_the_slopes(setting):
    """With recorded envelopes it is in slopes and residual, and reduces all gains."""
    problem, recording, _, _, _ = setting
    free, context = problem.variables, small_recording_and_context()[1]
    # All cycles have one speed, and are equal except for noise.
    context = dataclasses.replace(context, speeds=np.full(len(context.trials), 0.8))
    emg = mean_emg(recording.emg, np.zeros(len(context.trials), dtype=int))
    true = dataclasses.replace(recording, emg=emg)
    measured = np.asarray(joint_moments(CURVES, free.unpack(free.start()), true))
    gains = [row for row, label in enumerate(free.labels) if label.endswith("emg_scale")]
    frames = phase_frames(measured.shape[-1])
    alike = []
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(size=emg.coefficients[:, :, :1].shape)
        heard = dataclasses.replace(emg, coefficients=emg.coefficients * (1.0 + 0.3 * noise))
        noisy = dataclasses.replace(true, emg=heard)
        linearized = linearized_model(problem, free.start(), noisy, measured, context, ())
        as_recorded = moment_slopes(problem, free.start(), noisy, frames)
        lines = np.stack([as_recorded[gains], linearized.slopes[gains]]).reshape(2, len(gains), -1)
        alike.append(
            lines
            @ linearized.fitted_residual.ravel()
            / np.linalg.norm(lines, axis=-1)
            / np.linalg.norm(linearized.fitted_residual)
        )
    recorded, mean = np.mean(alike, axis=(0, 2))
    assert recorded < -0.05
    assert abs(mean) < 0.5 * abs(recorded)


def test_envelopes_are_averaged_over_the_cycles_of_a_speed(setting):
    emg = setting[1].emg
    mean = mean_emg(emg, np.array([0, 1, 1, 0]))
    np.testing.assert_allclose(
        mean.coefficients[:, 0], 0.5 * (emg.coefficients[:, 0] + emg.coefficients[:, 3])
    )
    np.testing.assert_array_equal(mean.coefficients[:, 1], mean.coefficients[:, 2])
    apart = mean_emg(emg, np.arange(4))
    np.testing.assert_allclose(apart.coefficients, emg.coefficients, rtol=1e-12)


def test_an_error_of_emg_affects_all_muscles_of_its_channel(setting):
    problem, _, _, linearized, _ = setting
    free, (emg, angles) = problem.variables, linearized.input_errors
    # The second channel drives both gastrocnemii.
    rows = [free.labels.index(f"{name}.emg_scale") for name in ("gasmed_l", "gaslat_l")]
    values = np.asarray(free.start())[rows]
    expected = 0.10 * np.tensordot(values, linearized.slopes[rows], axes=1)
    np.testing.assert_allclose(emg.signatures[1], expected, rtol=1e-9, atol=1e-12)
    assert angles.signatures.shape[0] == 3
    assert np.abs(angles.signatures).max() > 0.1


def test_muscle_errors_are_in_maximum_isometric_forces(setting):
    problem, recording, _, linearized, _ = setting
    arms = np.asarray(recording.path.nominal.moment_arm)[
        ..., phase_frames(recording.path.nominal.length.shape[-1])
    ]
    force = np.asarray(problem.initial.max_isometric_force)[:, None, None, None]
    np.testing.assert_allclose(linearized.muscle_errors.arms, arms * force)
    assert linearized.muscle_errors.states.shape[0] == len(MUSCLES)


def test_nuisances_are_part_of_the_null_and_never_candidates(setting):
    linearized = setting[3]
    assert {candidate.id for candidate in linearized.candidates} == set(EFFECTS) - {"curve_family"}
    assert len(linearized.nuisances)


def test_the_usual_spread_of_an_effect_is_part_of_the_null_and_reduces_its_evidence(setting):
    """An effect is named only where it is larger than in people without it."""
    problem, recording, measured, *_ = setting
    _, context = small_recording_and_context()
    damping = CATALOGUE["joint_damping"].build(context)
    prior_sd = np.array([entry.prior_sd for entry in damping.parameters])
    usual = dataclasses.replace(
        damping,
        parameters=tuple(dataclasses.replace(one, usual_sd=2.0 * one.prior_sd) for one in damping.parameters),
    )

    def linearized_with(effect):
        return linearized_model(problem, problem.variables.start(), recording, measured, context, (effect,))

    without, linearized = linearized_with(damping), linearized_with(usual)
    added = linearized.nuisances[len(without.nuisances) :]
    (candidate,) = linearized.candidates
    expected = 2.0 * prior_sd[:, None] * candidate.variants[0]
    np.testing.assert_allclose(added.reshape(len(expected), -1), expected, rtol=1e-6)

    def evidence(model):
        (test,) = score_each(
            model.residual.reshape(1, -1), nulls(model, measured.std(axis=(0, 2))), model.candidates
        )
        return test.scores[0].evidence

    assert evidence(linearized) < 0.5 * evidence(without)


def test_variants_share_the_variance_of_the_usual_spread(setting):
    """Each variant holds in a share of people, so that equal variants spread as one does alone."""
    problem, recording, measured, *_ = setting
    _, context = small_recording_and_context()
    damping = CATALOGUE["joint_damping"].build(context)
    usual = dataclasses.replace(
        damping, parameters=tuple(dataclasses.replace(one, usual_sd=1.0) for one in damping.parameters)
    )
    alike = dataclasses.replace(
        usual, variants=tuple(dataclasses.replace(usual.variants[0], label=name) for name in "abc")
    )

    def covariance(effect):
        start = problem.variables.start()
        rows = linearized_model(problem, start, recording, measured, context, (effect,)).nuisances
        columns = rows.reshape(len(rows), -1)
        return columns.T @ columns

    np.testing.assert_allclose(covariance(alike), covariance(usual), rtol=1e-9, atol=1e-9)


def test_candidates_have_the_limits_of_their_effects(setting):
    *_, linearized, _ = setting
    _, context = small_recording_and_context()
    for candidate in linearized.candidates:
        effect = CATALOGUE[candidate.id].build(context)
        np.testing.assert_array_equal(candidate.limit, [entry.limit for entry in effect.parameters])
        # A score and a joint fit have the same prior.
        large = Effects((effect.of_size(3.0),))
        np.testing.assert_array_equal(candidate.scaled_prior_sd(3.0), large.prior_sd)
    covariance = fixed_covariance(linearized)
    np.testing.assert_allclose(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_the_present_effect_has_most_evidence(setting):
    *_, measured, linearized, effect_sizes = setting
    sizes = measured.std(axis=(0, 2))
    (found,) = score_each(linearized.residual.reshape(1, -1), nulls(linearized, sizes), linearized.candidates)
    first = max(found.scores, key=lambda one: one.evidence)
    assert first.id == "joint_damping"
    assert first.evidence > 5.0
    assert np.all(np.abs(first.effect_sizes - effect_sizes) < 3.0 * first.sd)
