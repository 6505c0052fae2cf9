"""Losses of a known signal by calibration, signatures and residual."""

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.diagnosis.signal_losses import signal_loss


@pytest.fixture(scope="module")
def signal():
    """Draw a signal of the simulator: cycle, phase, coordinate."""
    return 5.0 * np.random.default_rng(0).normal(size=(CYCLES, PHASES, COORDINATES))


def test_nothing_is_lost_with_matching_signature_and_residual(signal):
    loss = signal_loss(lines(signal, {"cause": signal}), signal, "cause", 7.0)
    assert loss.d_star == 7.0 and loss.captured == pytest.approx(1.0)
    assert loss.seen > 20.0 and loss.found == pytest.approx(loss.seen, abs=5.0)


def test_signal_in_the_span_of_calibrated_variables_is_not_seen(signal):
    free = signal_loss(lines(signal, {"cause": signal}), signal, "cause", 7.0)
    absorbed = signal_loss(lines(signal, {"cause": signal}, calibrated=signal), signal, "cause", 7.0)
    assert absorbed.seen < 0.05 * free.seen


def test_signature_of_another_shape_captures_nothing(signal):
    other = np.random.default_rng(2).normal(size=signal.shape)
    assert signal_loss(lines(signal, {"cause": other}), signal, "cause", 7.0).captured < 0.05


def test_signal_absent_from_the_residual_is_not_found(signal):
    absorbed = signal_loss(lines(0.0 * signal, {"cause": signal}), signal, "cause", 7.0)
    assert absorbed.seen > 20.0 and abs(absorbed.found) < 5.0
