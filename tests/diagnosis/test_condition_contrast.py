"""Contrasts of two conditions: common errors cancel, and an effect of one condition is found there."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from tests.diagnosis.noise import noise_of_width
from wrapjax.diagnosis.conditions.against import ConditionDifference
from wrapjax.diagnosis.conditions.condition_contrast import (
    Contrast,
    DifferenceResult,
    Direction,
    compute_contrast,
    contrast_rows,
)
from wrapjax.diagnosis.conditions.contrast_nulls import ContrastNulls, weighted_sums, with_means
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.evidence.score_test import Score, score_each
from wrapjax.diagnosis.null_hypotheses.error_sources import MuscleErrors
from wrapjax.diagnosis.null_hypotheses.null_covariance import fixed_covariance, muscle_covariance, nulls
from wrapjax.report.diagnosis.difference_page import difference_findings

CYCLES, COORDINATES, PHASES = 16, 2, 25
SHAPE = (CYCLES, COORDINATES, PHASES)
IS_FIRST = np.arange(CYCLES) % 2 == 0
SPEEDS = np.zeros(CYCLES, dtype=int)
PHASE = 2.0 * np.pi * np.arange(PHASES) / PHASES
MOMENT_SD = np.array([20.0, 20.0])


def of_every_cycle(first, second):
    return np.broadcast_to(np.stack([first, second]), SHAPE)


WAVE, OTHER = of_every_cycle(np.sin(PHASE), 0 * PHASE), of_every_cycle(0 * PHASE, np.cos(2 * PHASE))
#: An error of the model that no effect has, in both conditions.
COMMON = 8.0 * of_every_cycle(np.sin(3 * PHASE) + np.sin(PHASE), np.sin(4 * PHASE))


def model(signal, seed=0):
    """Build a linearised model whose residual is a signal, a large common error, and cycle noise."""
    generator = np.random.default_rng(seed)
    noise = noise_of_width(np.array([[1.0, 0.2], [0.2, 1.0]]), 0.05)
    root = np.linalg.cholesky(noise.block(PHASES))
    drawn = (generator.standard_normal((CYCLES, COORDINATES * PHASES)) @ root.T).reshape(SHAPE)
    residual = COMMON + signal + drawn
    states = np.broadcast_to(generator.standard_normal((2, 1, PHASES, 3)), (2, CYCLES, PHASES, 3))
    return LinearizedModel(
        residual=residual,
        fitted_residual=residual,
        slopes=np.broadcast_to(generator.standard_normal((3, 1, COORDINATES, PHASES)), (3, *SHAPE)),
        prior_root=5.0 * np.eye(3),
        from_prior_mean=np.zeros(3),
        nuisances=np.zeros((0, *SHAPE)),
        candidates=tuple(
            Candidate(id, (signature.reshape(1, -1),), np.array([3.0]), np.array([one_sided]))
            for id, signature, one_sided in (("cop_offset", WAVE, True), ("joint_damping", OTHER, False))
        ),
        input_errors=(),
        muscle_errors=MuscleErrors(states, generator.standard_normal((2, *SHAPE))),
        speeds=(~IS_FIRST).astype(int),
        known_noise=noise,
    )


def contrast_of(linearized, is_first=IS_FIRST):
    return compute_contrast(linearized, SPEEDS, is_first, MOMENT_SD)


def test_contrasts_are_differences_of_means_at_common_speeds():
    speeds = np.array([0, 0, 0, 1, 1, 2])
    first = np.array([True, True, False, True, False, True])
    rows = contrast_rows(speeds, first)
    np.testing.assert_allclose(rows, [[0.5, 0.5, -1.0, 0, 0, 0], [0, 0, 0, 1.0, -1.0, 0]])


def test_common_errors_are_no_difference():
    found = contrast_of(model(0.0))
    assert found.strongest == ()
    assert np.abs(found.difference).max() < 2.5


@pytest.mark.parametrize("first", [True, False])
def test_an_effect_of_one_condition_is_found_there_with_its_size(first):
    mask = (IS_FIRST if first else ~IS_FIRST)[:, None, None]
    found = contrast_of(model(3.0 * WAVE * mask))
    assert found.strongest == (0,)
    assert found.directions[0].id == "cop_offset" and found.directions[0].first is first
    assert found.scores[0].effect_sizes[0] == pytest.approx(3.0, abs=0.6)
    assert found.explained > 0.8
    np.testing.assert_allclose(found.predicted[0, 0], (3.0 if first else -3.0) * np.sin(PHASE), atol=0.6)
    result = object.__new__(ConditionDifference)
    fields = {
        "conditions": ("brace", "none"),
        "coordinates": ("hip", "knee")[:COORDINATES],
        "speeds": np.arange(float(len(found.difference))),
        "measured_difference": found.difference,
        "contrast": found,
    }
    for name, value in fields.items():
        object.__setattr__(result, name, value)
    dataset = result.to_dataset()
    strongest_one = dataset.isel(hypothesis=0)
    assert strongest_one["condition"].item() == ("brace" if first else "none")
    assert strongest_one["effect"].item() == "cop_offset" and dataset.attrs["outcome"] == "named"
    np.testing.assert_array_equal(dataset["explained"], found.predicted)


def test_the_strongest_effect_of_an_error_without_a_name_is_not_named_more_often_than_allowed():
    alarms = 0
    for seed in range(10):
        found = contrast_of(model(0.0, seed))
        alarms += bool(found.strongest)
    assert alarms <= 3


def test_an_effect_is_easier_to_detect_in_a_contrast():
    """The common error and the parameters that could absorb the effect cancel."""
    linearized = model(0.0)
    found = contrast_of(linearized)
    one = next(
        score
        for score, kind in zip(found.scores, found.directions, strict=True)
        if kind.id == "joint_damping" and kind.first
    )
    everywhere = replace(linearized, speeds=SPEEDS)
    plain = score_each(
        linearized.residual.reshape(1, -1), list(nulls(everywhere, MOMENT_SD)), linearized.candidates
    )[0].scores[1]
    assert one.detectability > 1.5 * plain.detectability


def outcome_of(contrast):
    return result_of(contrast).outcome


def result_of(contrast):
    result = object.__new__(DifferenceResult)
    fields = {"contrast": contrast, "conditions": ("brace", "none"), "cycles": (8, 8)}
    for name, value in fields.items():
        object.__setattr__(result, name, value)
    return result


def with_uncertain_parameter(signal=0.0):
    """Build a model with one unknown parameter, which acts in the first condition as `joint_damping` does.

    In the second condition it acts half as much. Its true value, 4 N m, is not the prior mean.
    """
    linearized = model(signal - COMMON)
    slope = np.where(IS_FIRST[:, None, None], 2.0 * OTHER, OTHER)[None]
    return replace(
        linearized,
        slopes=slope,
        prior_root=np.array([[20.0]]),
        from_prior_mean=np.zeros(1),
        residual=linearized.residual + 4.0 * slope[0],
    )


def test_the_mean_of_both_conditions_determines_what_parameters_leave_in_the_contrast():
    nothing = contrast_of(with_uncertain_parameter())
    assert nothing.strongest == () and outcome_of(nothing) == "none"
    one = next(
        score
        for score, kind in zip(nothing.scores, nothing.directions, strict=True)
        if kind.id == "joint_damping"
    )
    # Without the mean, the parameter's prior, with the same effect on the contrast, limits d' to 3 / 20.
    assert one.detectability > 2.0
    found = contrast_of(with_uncertain_parameter(3.0 * OTHER * IS_FIRST[:, None, None]))
    assert found.directions[0].id == "joint_damping" and outcome_of(found) == "named"
    assert found.scores[0].effect_sizes[0] == pytest.approx(3.0, abs=1.0)


def test_contrast_and_mean_have_the_covariance_of_the_cycles():
    """The log density of the mean times that of the contrast given the mean is that of both."""
    linearized = model(2.0 * WAVE)
    rows = contrast_rows(SPEEDS, IS_FIRST)
    both = with_means(rows)
    residual = weighted_sums(both, linearized.residual).ravel()
    own = COORDINATES * PHASES
    sums = np.kron(both, np.eye(own))
    _, given = ContrastNulls(linearized, MOMENT_SD).score(rows, residual, np.zeros((0, own)), ())
    # Without repeatable errors, from the covariance of single cycles.
    covariance = fixed_covariance(linearized) + 0.005**2 * muscle_covariance(linearized.muscle_errors)
    joint = scipy.stats.multivariate_normal(cov=sums @ covariance @ sums.T, allow_singular=True)
    null, samples = given[0].null, given[0].samples
    white = np.linalg.solve(np.linalg.cholesky(null.covariance), samples[0])
    _, logdet = np.linalg.slogdet(null.covariance)
    log_density = null.log_prior + 0.005 / 0.02 - 0.5 * white @ white - 0.5 * logdet
    assert log_density == pytest.approx(joint.logpdf(residual) + own * np.log(2.0 * np.pi), rel=1e-5)


def test_a_difference_that_no_effect_explains_is_unknown():
    shape = of_every_cycle(np.sin(5 * PHASE), np.cos(5 * PHASE))
    found = contrast_of(model(5.0 * shape * IS_FIRST[:, None, None]))
    assert found.remaining > found.allowed_remaining and outcome_of(found) == "unknown"
    sentence = difference_findings(result_of(found))[0]
    assert sentence.startswith("Something differs that no effect of the catalogue explains")
    assert "times the variance of known errors" in sentence


def test_an_effect_that_does_not_hold_on_other_cycles_is_not_named():
    found = contrast_of(model(3.0 * WAVE * IS_FIRST[:, None, None]))
    assert outcome_of(found) == "named"
    assert outcome_of(replace(found, explained=0.2)) == "unknown"
    unconfirmed = replace(found, explained=float("nan"))
    assert outcome_of(unconfirmed) == "unknown"
    assert "does not hold on cycles" in difference_findings(result_of(unconfirmed))[0]


@pytest.mark.parametrize(("second", "outcome"), [(85.0, "tie"), (70.0, "named")])
def test_effects_within_the_error_of_form_of_the_strongest_are_a_tie(second, outcome):
    scores = tuple(
        Score(id, evidence, 0, (0,), 1.0, np.ones(1), np.ones(1), 5.0)
        for id, evidence in (("cop_offset", 100.0), ("joint_damping", second))
    )
    contrast = object.__new__(Contrast)
    fields = {
        "scores": scores,
        "directions": tuple(Direction(score.id, True) for score in scores),
        "threshold": 3.0,
        "explained": 0.9,
        "remaining": 1.0,
        "allowed_remaining": 1.2,
    }
    for name, value in fields.items():
        object.__setattr__(contrast, name, value)
    assert outcome_of(contrast) == outcome
