"""Defends: the value of a trial follows from its own rows, as from the whole covariance at once."""

import numpy as np
import pytest

from wrapjax.diagnosis.evidence.linearization import Candidate
from wrapjax.diagnosis.protocol.detectability import Design, Detection, detection, information_gain

ROWS = 12


def effect(id: str, generator, parameters: int = 2, variants: int = 1) -> Candidate:
    shapes = tuple(generator.normal(size=(parameters, ROWS)) for _ in range(variants))
    return Candidate(id, shapes, np.linspace(0.5, 2.0, parameters), np.zeros(parameters, bool))


@pytest.fixture(scope="module")
def design():
    generator = np.random.default_rng(3)
    root = generator.normal(size=(ROWS, ROWS))
    candidates = (effect("one", generator), effect("two", generator, 3, 2), effect("three", generator, 1))
    covariance = root @ root.T + np.eye(ROWS)
    return Design.of_effects(candidates, covariance), candidates, covariance


def test_rows_recorded_one_after_the_other_tell_what_they_tell_together(design):
    start, candidates, covariance = design
    columns = np.concatenate(
        [one.prior_sd[:, None] * variant for one in candidates for variant in one.variants]
    ).T
    whole = columns.T @ np.linalg.solve(covariance, columns)
    first, second, last = np.arange(4), np.arange(4, 9), np.arange(9, ROWS)
    step = start.recorded(first).recorded(second)
    np.testing.assert_allclose(step.information_with(last), whole, rtol=1e-6)
    kept = start.recorded(first).of_rows(np.arange(4, ROWS)).recorded(np.arange(5))
    np.testing.assert_allclose(kept.information_with(np.arange(5, 8)), whole, rtol=1e-6)


def test_a_further_row_never_makes_an_effect_less_visible(design):
    start, candidates, _ = design
    few = detection(start.information_with(np.arange(5)), candidates)
    more = detection(start.information_with(np.arange(9)), candidates)
    assert (more.detectability >= few.detectability).all()
    assert (more.expected_evidence >= few.expected_evidence).all()


def test_detectability_is_the_signal_over_the_noise_and_a_copy_is_not_apart():
    """Two equal effects of signal 3 N m in noise of 1.5 N m: d' is 2, and each can do what the other does."""
    shape = np.zeros((1, ROWS))
    shape[0, 2] = 3.0
    pair = tuple(Candidate(id, (shape,), np.ones(1), np.zeros(1, bool)) for id in ("one", "copy"))
    found = detection(Design.of_effects(pair, 1.5**2 * np.eye(ROWS)).information_with(np.arange(ROWS)), pair)
    np.testing.assert_allclose(found.detectability, 2.0, rtol=1e-6)
    # What is left of 4 where the other one is allowed for with variance 4: 4 - 4 * 4 / 5.
    np.testing.assert_allclose(found.apart, [[4.0, 0.8], [0.8, 4.0]], rtol=1e-6)
    assert found.tied(9.0, 1.9).tolist() == [[False, True], [True, False]]
    assert not found.tied(9.0, 2.1).any() and not found.tied(0.5, 1.9).any()


def test_information_counts_effects_by_their_weight():
    detected = Detection(np.array([1.0, 3.0]), np.array([[1.0, 0.0], [0.0, 9.0]]))
    alone = information_gain(detected, np.array([0.0, 1.0]), np.eye(2))
    assert alone == pytest.approx(0.5 * np.log(10.0))
    assert information_gain(detected, np.array([0.5, 0.5]), np.eye(2)) == pytest.approx(
        0.25 * (np.log(2.0) + np.log(10.0))
    )
