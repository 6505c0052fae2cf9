"""Contrasts of two conditions: common errors cancel, and an effect of one condition is found there."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.noise import noise_of_width
from wrapjax.diagnosis.against import ConditionDifference
from wrapjax.diagnosis.condition_contrast import compute_contrast, contrast_rows, strongest
from wrapjax.diagnosis.error_sources import MuscleErrors
from wrapjax.diagnosis.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.null_covariance import nulls
from wrapjax.diagnosis.score_test import score_each

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
    assert strongest(found.scores, found.threshold) == ()
    assert np.abs(found.difference).max() < 2.5


@pytest.mark.parametrize("first", [True, False])
def test_an_effect_of_one_condition_is_found_there_with_its_size(first):
    mask = (IS_FIRST if first else ~IS_FIRST)[:, None, None]
    found = contrast_of(model(3.0 * WAVE * mask))
    assert strongest(found.scores, found.threshold) == (0,)
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
        alarms += bool(strongest(found.scores, found.threshold))
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
