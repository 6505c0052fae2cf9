"""The score test: equal to marginal likelihoods by brute force, and calibrated under the null."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from tests.diagnosis.noise import noise_of_width
from wrapjax.diagnosis.evidence.linearization import Candidate
from wrapjax.diagnosis.evidence.score_test import (
    PRIOR_FACTORS,
    distinguishability,
    effect_evidence,
    project,
    score_each,
)
from wrapjax.diagnosis.null_hypotheses.cycle_noise import cycle_noise
from wrapjax.diagnosis.null_hypotheses.error_sources import InputErrors, MuscleErrors, periodic_kernel
from wrapjax.diagnosis.null_hypotheses.null_covariance import (
    Null,
    input_covariance,
    muscle_covariance,
    parameter_covariance,
    repeatable_covariance,
)

CYCLES, COORDINATES, PHASES = 6, 2, 10
ROWS = CYCLES * COORDINATES * PHASES
SPEEDS = np.repeat([0, 1], CYCLES // 2)


@pytest.fixture
def generator():
    return np.random.default_rng(7)


@pytest.fixture
def covariance(generator):
    noise = noise_of_width(np.array([[1.0, 0.4], [0.4, 2.0]]), 0.05).covariance(CYCLES, PHASES)
    nuisance = parameter_covariance(generator.normal(size=(3, CYCLES, COORDINATES, PHASES)), np.full(3, 0.5))
    return noise + nuisance


def candidate(generator, name, parameters=1, variants=1, one_sided=False):
    signatures = tuple(generator.normal(size=(parameters, ROWS)) for _ in range(variants))
    return Candidate(name, signatures, np.full(parameters, 0.7), np.full(parameters, one_sided))


def test_evidence_is_the_ratio_of_marginal_likelihoods(generator, covariance):
    effect = candidate(generator, "one", parameters=3)
    residual = generator.multivariate_normal(np.zeros(ROWS), covariance)
    (found,) = score_each(residual[None], [Null(covariance)], [effect])[0].scores
    (signature,) = effect.variants
    with_effect = [covariance + signature.T @ signature * (0.7 * size) ** 2 for size in PRIOR_FACTORS]
    likelihoods = [multivariate_normal(cov=cov).logpdf(residual) for cov in with_effect]
    expected = np.logaddexp.reduce(likelihoods) - np.log(len(PRIOR_FACTORS))
    expected -= multivariate_normal(cov=covariance).logpdf(residual)
    assert found.evidence == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_effect_sizes_beyond_their_limit_are_no_evidence(generator, covariance):
    free = candidate(generator, "one", parameters=2)
    held = replace(free, limit=np.array([0.5, np.inf]))
    (signature,) = free.variants
    # The first effect size would have to be 20 times its limit.
    residual = 10.0 * signature[0] + generator.multivariate_normal(np.zeros(ROWS), covariance)
    (without,), (within,) = (
        score_each(residual[None], [Null(covariance)], [one])[0].scores for one in (free, held)
    )
    assert without.effect_sizes[0] > 9.0 and within.effect_sizes[0] == 0.5
    assert within.evidence < without.evidence
    prior_sd = [np.minimum(0.7 * size, [0.25, np.inf]) for size in PRIOR_FACTORS]
    likelihoods = [
        multivariate_normal(cov=covariance + signature.T @ np.diag(sd**2) @ signature).logpdf(residual)
        for sd in prior_sd
    ]
    expected = np.logaddexp.reduce(likelihoods) - np.log(len(PRIOR_FACTORS))
    expected -= multivariate_normal(cov=covariance).logpdf(residual)
    assert within.evidence == pytest.approx(expected, rel=1e-9)


def test_evidence_of_a_one_sided_parameter_is_that_of_a_half_normal_prior():
    for slope in (-3.0, 0.5, 6.0):
        evidence, effect_sizes, _, _ = effect_evidence(
            np.array([[slope]]), np.array([[2.0]]), np.array([0.7]), np.array([True])
        )
        integral, _ = quad(
            lambda t, slope=slope: 2 * norm.pdf(t, scale=0.7) * np.exp(slope * t - t * t), 0, 12, epsabs=1e-13
        )
        assert evidence == pytest.approx(np.log(integral), abs=1e-8)
        assert effect_sizes[0, 0] >= 0.0


def test_variants_and_nulls_are_averaged(generator, covariance):
    effect = candidate(generator, "several", variants=2)
    residual = generator.normal(size=ROWS)
    nulls = [Null(covariance, np.log(0.2)), Null(3.0 * covariance, np.log(0.8))]
    (found,) = score_each(residual[None], nulls, [effect])[0].scores

    def likelihood(scale, signature=None, size=1.0):
        own = scale * covariance
        if signature is not None:
            own = own + signature.T @ signature * (0.7 * size) ** 2
        return multivariate_normal(cov=own).logpdf(residual)

    with_effect = [
        np.log(weight / 2 / len(PRIOR_FACTORS)) + likelihood(scale, signature, size)
        for weight, scale in ((0.2, 1.0), (0.8, 3.0))
        for signature in effect.variants
        for size in PRIOR_FACTORS
    ]
    without = [np.log(weight) + likelihood(scale) for weight, scale in ((0.2, 1.0), (0.8, 3.0))]
    expected = np.logaddexp.reduce(with_effect) - np.logaddexp.reduce(without)
    assert found.evidence == pytest.approx(expected, rel=1e-9)


def test_the_present_effect_is_found_with_its_size(generator, covariance):
    effects = [candidate(generator, str(number)) for number in range(8)]
    residual = 1.5 * effects[3].variants[0][0] + generator.multivariate_normal(np.zeros(ROWS), covariance)
    found = score_each(residual[None], [Null(covariance)], effects)[0].scores
    best = max(found, key=lambda one: one.evidence)
    assert best.id == "3"
    assert abs(best.effect_sizes[0] - 1.5) < 3 * best.sd[0]
    assert best.detectability > 5


def test_a_larger_prior_factor_gives_more_evidence_for_a_large_effect(generator, covariance):
    """Effects can be several times as large as their prior expects."""
    effect = candidate(generator, "one", parameters=4)
    (signature,) = effect.variants
    residual = np.full(4, 5.0 * 0.7) @ signature
    (found,) = score_each(residual[None], [Null(covariance)], [effect])[0].scores
    inverse = np.linalg.inv(covariance)
    of_prior, *_ = effect_evidence(
        (signature @ inverse @ residual)[None],
        signature @ inverse @ signature.T,
        effect.prior_sd,
        effect.one_sided,
    )
    assert found.evidence > of_prior[0] + 10.0


def test_detectability_is_the_shift_of_the_score_in_deviations(generator, covariance):
    """By effect sizes of one prior standard deviation."""
    effect = candidate(generator, "one")
    (signature,) = effect.variants
    (found,) = score_each(np.zeros(ROWS)[None], [Null(covariance)], [effect])[0].scores
    inverse = np.linalg.inv(covariance)
    slopes = [
        signature[0] @ inverse @ generator.multivariate_normal(0.7 * signature[0], covariance)
        for _ in range(400)
    ]
    moved = np.mean(slopes) / np.std(slopes)
    assert moved == pytest.approx(found.detectability, rel=0.15)


def test_two_effects_with_one_signature_are_a_tie(generator, covariance):
    one, other = (candidate(generator, name).variants[0] for name in ("one", "other"))
    null_replicate = np.concatenate([2.0 * one, other])
    signals = (one[0], other[0], np.array([0.5, 1.0]) @ null_replicate)
    apart = distinguishability(signals, (one, other, null_replicate), covariance)
    assert apart[0, 2] < 1e-9 and np.diag(apart).max() < 1e-9
    assert apart[0, 1] > 9.0 and apart[2, 0] > 9.0


def test_noise_is_estimated_from_deviations(generator):
    truth = noise_of_width(np.array([[4.0, -1.2], [-1.2, 1.0]]), 0.05)
    speeds = np.repeat([0, 1], 60)
    factor = np.linalg.cholesky(truth.block(25))
    drawn = (generator.normal(size=(120, 50)) @ factor.T).reshape(120, 2, 25)
    drawn[speeds == 0] += 10.0
    found = cycle_noise(drawn, speeds)
    np.testing.assert_allclose(found.between, truth.between, rtol=0.15)
    np.testing.assert_allclose(found.block(25), truth.block(25), atol=0.1 * truth.between.max())


def test_covariances_are_those_of_random_draws(generator):
    """Each term against the sample covariance of simulated errors."""
    draws = 40_000
    phase_factor = np.linalg.cholesky(periodic_kernel(4, 0.2) + 1e-12 * np.eye(4))

    signatures = generator.normal(size=(2, 2, 2, 4))
    errors = generator.normal(size=(draws, 2, 2, 4)) @ phase_factor.T
    drawn = np.einsum("nicp,ickp->nckp", errors, signatures).reshape(draws, -1)
    _same(drawn, input_covariance(InputErrors(signatures, 0.2)))

    effect_sizes = generator.normal(size=(draws, 2)) * [0.5, 2.0]
    drawn = np.einsum("ni,ickp->nckp", effect_sizes, signatures).reshape(draws, -1)
    _same(drawn, parameter_covariance(signatures, np.array([0.5, 2.0])))

    states, arms = generator.normal(size=(1, 2, 4, 3)), generator.normal(size=(1, 2, 2, 4))
    rows = states.reshape(8, 3)
    kernel = np.exp(-0.5 * np.sum((rows[:, None] - rows[None]) ** 2, axis=-1))
    forces = (generator.normal(size=(draws, 8)) @ np.linalg.cholesky(kernel + 1e-12 * np.eye(8)).T).reshape(
        draws, 2, 1, 4
    )
    _same((forces * arms[0]).reshape(draws, -1), muscle_covariance(MuscleErrors(states, arms)))


def test_the_repeatable_error_is_equal_in_all_cycles_of_a_speed():
    found = repeatable_covariance(np.array([1.0, 3.0]), np.array([0, 0, 1]), 5).reshape(3, 2, 5, 3, 2, 5)
    np.testing.assert_allclose(found[0, 1, 2, 1, 1, 2], 9.0)
    np.testing.assert_allclose(found[0, 1, 2, 2, 1, 2], 0.7 * 9.0)
    assert found[0, 0, 2, 0, 1, 2] == 0.0


def _same(drawn, covariance):
    sample = drawn.T @ drawn / len(drawn)
    np.testing.assert_allclose(sample, covariance, atol=0.05 * np.sqrt(np.diag(covariance)).max() ** 2)


def test_parameters_can_be_added_to_a_projection(generator):
    """Adding them to the projection or to the covariance gives the same null hypothesis."""
    shapes = generator.normal(size=(3, 2, 24))
    candidates = (
        Candidate("one", (shapes[0], shapes[1]), np.array([0.5, 2.0]), np.zeros(2, bool)),
        Candidate("other", (shapes[2],), np.ones(2), np.zeros(2, bool)),
    )
    root = generator.normal(size=(24, 24))
    covariance = root @ root.T + np.eye(24)
    residuals = generator.normal(size=(3, 24))
    spread = np.array([0.3, 1.2, 0.3, 1.2, 0.0, 0.0])
    columns = shapes.reshape(6, 24) * spread[:, None]
    at_once = project(residuals, Null(covariance + columns.T @ columns), candidates)
    afterwards = project(residuals, Null(covariance), candidates).allowing(spread)
    for one, other in zip(vars(at_once).values(), vars(afterwards).values(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11)
