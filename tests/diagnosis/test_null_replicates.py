"""Null replicates: their curves, noise and calibration, and reproducibility by seed."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.noise import noise_of_width
from tests.diagnosis.subject import CURVES, MUSCLES, small_recording_and_context
from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.evidence.linearization import LinearizedModel, moment_slopes, parameter_prior
from wrapjax.diagnosis.inputs.input import phase_frames, speed_numbers
from wrapjax.diagnosis.null_hypotheses import null_replicates
from wrapjax.diagnosis.null_hypotheses.error_sources import InputErrors, MuscleErrors, input_blocks
from wrapjax.diagnosis.null_hypotheses.null_replicates import (
    NullModel,
    ReplicateCurves,
    _replicate_moments,
    _with_emg_noise,
    _with_scaled_arms,
    null_replicate_residuals,
)
from wrapjax.model.forward import joint_moments
from wrapjax.model.freedom import nga_freedom
from wrapjax.model.variables import free_variables

PEOPLE = [ReplicateCurves.drawn(jax.random.key(seed)) for seed in range(20)]


@pytest.mark.parametrize("person", PEOPLE[:3])
def test_curves_are_normalised(person):
    """One at optimal length at rest, zero at the fastest shortening, passive force one at the strain."""
    one, zero = jnp.ones(1), jnp.zeros(1)
    np.testing.assert_allclose(person.active_force(one), 1.0, atol=1e-4)
    np.testing.assert_allclose(person.force_velocity(-one), 0.0, atol=1e-12)
    np.testing.assert_allclose(person.force_velocity(zero), 1.0)
    np.testing.assert_allclose(person.passive_force(one + person.strain), 1.0)
    np.testing.assert_allclose(person.passive_force(one), 0.0, atol=1e-12)


@pytest.mark.parametrize("person", PEOPLE[:3])
def test_force_over_velocity_has_one_slope_at_zero_and_never_falls(person):
    slope = jax.grad(lambda v: person.force_velocity(v))
    below, above = (float(slope(jnp.asarray(v))) for v in (-1e-9, 1e-9))
    assert below == pytest.approx(above, rel=1e-6)
    assert below == pytest.approx(1.0 + 1.0 / float(person.shortening))
    force = np.asarray(person.force_velocity(jnp.linspace(-1.3, 1.8, 200)))
    assert np.diff(force).min() >= 0.0
    assert 1.0 < force.max() < person.plateau


def test_the_active_curve_falls_on_both_sides_and_all_derivatives_are_finite():
    length = jnp.linspace(0.0, 2.5, 300)
    for person in PEOPLE:
        active, passive = person.active_force(length), person.passive_force(length)
        assert float(length[np.argmax(active)]) == pytest.approx(1.0, abs=0.01)
        assert active.min() >= 0.0
        assert np.diff(passive).min() >= 0.0
        assert (np.asarray(passive)[np.asarray(length) < 1.0] == 0.0).all()
        for curve in (person.active_force, person.passive_force):
            assert np.isfinite(jax.jvp(curve, (length,), (jnp.ones_like(length),))[1]).all()


def test_drawn_curves_differ():
    drawn = np.array([np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(one)]) for one in PEOPLE])
    assert (drawn.std(axis=0) > 0.0).all()
    assert len(np.unique(drawn, axis=0)) == len(PEOPLE)


@pytest.fixture(scope="module")
def world():
    """The small leg at its start, with noise, and the parts of its linearisation that replicates use."""
    recording, context = small_recording_and_context()
    base = context.parameters
    free = free_variables(base, nga_freedom(base), context.muscles)
    measured = joint_moments(CURVES, base, recording)
    problem = Objective(
        curves=CURVES, recording=recording, measured=measured, variables=free, penalties=(), limits=()
    )
    start = free.start()
    frames = phase_frames(measured.shape[-1])
    slopes = moment_slopes(problem, start, recording, frames)
    prior_root, from_prior_mean = parameter_prior(problem, start)
    fitted = np.random.default_rng(0).normal(size=slopes.shape[1:])
    cycles, coordinates, phases = fitted.shape
    linearized = LinearizedModel(
        residual=fitted + np.tensordot(from_prior_mean, slopes, axes=1),
        fitted_residual=fitted,
        slopes=slopes,
        prior_root=prior_root,
        from_prior_mean=from_prior_mean,
        nuisances=np.zeros((0, *fitted.shape)),
        candidates=(),
        input_errors=(),
        muscle_errors=MuscleErrors(
            np.zeros((len(MUSCLES), cycles, phases, 3)), np.zeros((len(MUSCLES), *fitted.shape))
        ),
        speeds=speed_numbers(context.speeds),
    )
    return NullModel(
        problem, np.asarray(start), recording, linearized, noise_of_width(np.eye(coordinates), 0.05)
    )


def test_equal_seeds_give_equal_replicates(world):
    """Replicates differ from each other, and do not depend on their number."""
    two = null_replicate_residuals(world, 2, seed=3)
    np.testing.assert_array_equal(null_replicate_residuals(world, 2, seed=3), two)
    other = null_replicate_residuals(world, 2, seed=4)
    assert np.isfinite(two).all()
    assert two.shape == (2, world.linearized.residual.size)
    everyone = np.concatenate([two, other])
    for place, own in enumerate(everyone):
        assert all(np.abs(own - one).max() > 1e-3 for one in everyone[:place])


def test_a_replicate_of_the_models_own_form_is_calibrated_without_residual(world, monkeypatch):
    """Except for the move to the prior mean with the subject's derivatives."""
    lived = []

    def own_moments(parameters, recording, *_):
        lived.append(np.asarray(joint_moments(CURVES, parameters, recording)))
        return lived[-1]

    monkeypatch.setattr(null_replicates, "_replicate_moments", own_moments)
    monkeypatch.setattr(null_replicates, "PARAMETER_ERROR", 0.02)
    linearized = replace(world.linearized, fitted_residual=0.01 * world.linearized.fitted_residual)
    silent = replace(world, linearized=linearized, noise=noise_of_width(1e-9 * np.eye(3), 0.05))
    residuals = null_replicate_residuals(silent, 2, seed=3)
    basis = np.linalg.qr(linearized.slopes.reshape(len(linearized.slopes), -1).T)[0]
    frames = phase_frames(lived[0].shape[-1])
    expected = _move_to_prior_mean(world)
    for residual, moments in zip(residuals, lived, strict=True):
        before = (moments - np.asarray(world.problem.measured))[..., frames].ravel()
        off = [np.std(one - basis @ (basis.T @ one)) for one in (residual, before)]
        assert off[0] < 0.2 * off[1]
        # In a linear model it does not matter where the calibration ended.
        np.testing.assert_allclose(residual, before + expected, atol=0.1 * np.abs(expected).max())


def _move_to_prior_mean(world):
    """Change of the moments by the move to the prior mean."""
    return np.tensordot(world.linearized.from_prior_mean, world.linearized.slopes, axes=1).ravel()


def test_scaled_moment_arms_change_lengths_and_velocities_consistently(world):
    """By virtual work, velocities and deviations of length scale with the moment arm."""
    path = world.recording.path.nominal
    scale = jnp.linspace(0.8, 1.3, len(MUSCLES))
    other = _with_scaled_arms(path, scale)
    np.testing.assert_allclose(other.moment_arm, path.moment_arm * scale[:, None, None, None])
    np.testing.assert_allclose(other.velocity, path.velocity * scale[:, None, None])
    means = [one.length.mean(axis=(1, 2)) for one in (path, other)]
    np.testing.assert_allclose(*means)
    swing = [one.length.max(axis=(1, 2)) - one.length.min(axis=(1, 2)) for one in (path, other)]
    np.testing.assert_allclose(swing[1], swing[0] * scale)


def test_muscles_of_one_electrode_share_its_noise(world):
    """A tenth of the envelope, smooth, and independent between cycles."""
    emg = world.recording.emg
    noisy = jax.jit(lambda key: _with_emg_noise(emg, jnp.asarray(0.10), key).coefficients)
    factors = np.log(np.asarray([noisy(jax.random.key(seed)) / emg.coefficients for seed in range(40)]))
    np.testing.assert_array_equal(factors[:, 1], factors[:, 2], err_msg="both gastrocnemii")
    assert np.abs(factors[:, 0] - factors[:, 1]).max() > 0.05
    assert np.abs(factors[:, :, 0] - factors[:, :, 1]).max() > 0.05
    assert np.std(factors) == pytest.approx(0.10, rel=0.1)
    np.testing.assert_allclose(np.ptp(factors, axis=3), 0.0, atol=1e-6)


def test_input_errors_of_a_replicate_have_the_estimated_size(world):
    """Errors of EMG pass through its muscles; errors of angles add to the noise of moments."""
    generator = np.random.default_rng(0)
    shape = world.linearized.slopes.shape[1:]
    emg, angles = (InputErrors(generator.normal(size=(2, *shape)), 0.05) for _ in range(2))
    noise = replace(world.noise, input_shares=(0.5, 2.0))
    noisy = replace(world, linearized=replace(world.linearized, input_errors=(emg, angles)), noise=noise)
    assert noisy.emg_error == pytest.approx(0.05) and world.emg_error == pytest.approx(0.10)
    root = noisy.noise_root(shape[-1])
    expected = noise.block(shape[-1])[None] + 4.0 * input_blocks(angles)
    np.testing.assert_allclose(np.einsum("cij,ckj->cik", root, root), expected, atol=1e-8)


def test_the_muscles_of_a_replicate_differ_from_the_models(world):
    parameters = world.problem.parameters(jnp.asarray(world.variables))
    lived = [
        np.asarray(_replicate_moments(parameters, world.recording, jnp.asarray(0.10), jax.random.key(seed)))
        for seed in (0, 1)
    ]
    for one in lived:
        apart = np.std(one - np.asarray(world.problem.measured)) / np.std(world.problem.measured)
        assert 0.02 < apart < 1.0
    assert np.abs(lived[0] - lived[1]).max() > 0.1
