"""Defends: what is lost of a known signal is told apart by where it is lost."""

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.diagnosis.signal_losses import loss


@pytest.fixture(scope="module")
def signal():
    """Of the simulator: cycle, phase, coordinate."""
    return 5.0 * np.random.default_rng(0).normal(size=(CYCLES, PHASES, COORDINATES))


def test_nothing_is_lost_where_nothing_takes_it(signal):
    found = loss(lines(signal, {"cause": signal}), signal, "cause", 7.0)
    assert found.d_star == 7.0 and found.captured == pytest.approx(1.0)
    assert found.seen > 20.0 and found.found == pytest.approx(found.seen, abs=5.0)


def test_what_calibration_can_do_as_well_is_not_seen(signal):
    free = loss(lines(signal, {"cause": signal}), signal, "cause", 7.0)
    taken = loss(lines(signal, {"cause": signal}, calibrated=signal), signal, "cause", 7.0)
    assert taken.seen < 0.05 * free.seen


def test_a_signature_of_another_shape_captures_nothing(signal):
    other = np.random.default_rng(2).normal(size=signal.shape)
    assert loss(lines(signal, {"cause": other}), signal, "cause", 7.0).captured < 0.05


def test_what_a_fit_took_up_is_not_found(signal):
    taken = loss(lines(0.0 * signal, {"cause": signal}), signal, "cause", 7.0)
    assert taken.seen > 20.0 and abs(taken.found) < 5.0
