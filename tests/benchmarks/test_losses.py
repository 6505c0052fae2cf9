"""Defends: what is lost of a known signal is told apart by where it is lost."""

import numpy as np
import pytest

from benchmarks.lines import Lines
from benchmarks.losses import loss
from wrapjax.gap.evidence.covariance import MuscleErrors
from wrapjax.gap.evidence.linearized import LinearGap
from wrapjax.gap.evidence.projection import Candidate

CYCLES, COORDINATES, PHASES = 4, 2, 25
ROWS = CYCLES * COORDINATES * PHASES


@pytest.fixture(scope="module")
def signal():
    """Of the simulator: cycle, phase, coordinate."""
    return 5.0 * np.random.default_rng(0).normal(size=(CYCLES, PHASES, COORDINATES))


def lines(signal, signature, *, calibrated=None, held=1.0):
    """A residual that holds so much of the signal beside noise, and an effect with this signature."""
    generator = np.random.default_rng(1)
    shape = (CYCLES, COORDINATES, PHASES)
    ordered = signal.transpose(0, 2, 1)
    residual = held * ordered + generator.normal(size=shape)
    slopes = np.zeros((1, *shape)) if calibrated is None else calibrated.transpose(0, 2, 1)[None]
    gap = LinearGap(
        residual=residual,
        fitted=generator.normal(size=shape),
        slopes=slopes,
        spread=np.array([[100.0]]),
        away=np.zeros(1),
        nuisances=np.zeros((1, *shape)),
        candidates=(
            Candidate(
                "cause", (signature.transpose(0, 2, 1).reshape(1, ROWS),), np.ones(1), np.zeros(1, bool)
            ),
        ),
        input_errors=(),
        muscle_errors=MuscleErrors(np.zeros((1, CYCLES, PHASES, 3)), np.zeros((1, *shape))),
        speeds=np.zeros(CYCLES, dtype=int),
    )
    return Lines(gap, np.full(COORDINATES, 1e-3))


def test_nothing_is_lost_where_nothing_takes_it(signal):
    found = loss(lines(signal, signal), signal, "cause", 7.0, {})
    assert found.d_star == 7.0 and found.captured == pytest.approx(1.0)
    assert found.seen > 20.0 and found.found == pytest.approx(found.seen, abs=5.0)


def test_what_calibration_can_do_as_well_is_not_seen(signal):
    free = loss(lines(signal, signal), signal, "cause", 7.0, {})
    taken = loss(lines(signal, signal, calibrated=signal), signal, "cause", 7.0, {})
    assert taken.seen < 0.05 * free.seen


def test_a_signature_of_another_shape_captures_nothing(signal):
    other = np.random.default_rng(2).normal(size=signal.shape)
    assert loss(lines(signal, other), signal, "cause", 7.0, {}).captured < 0.05


def test_what_a_fit_took_up_is_not_found(signal):
    taken = loss(lines(signal, signal, held=0.0), signal, "cause", 7.0, {})
    assert taken.seen > 20.0 and abs(taken.found) < 5.0
