"""Phases count from the strike before, whichever part of a walk a cycle was cut from."""

import numpy as np
import pytest

from wrapjax.contact.gait_phase import evenly, phase_from_strikes

STRIKES = np.array([0.2, 1.3, 2.5])


def test_a_cycle_from_strike_to_strike_is_even():
    found = phase_from_strikes(np.linspace(0.2, 1.3, 101), STRIKES)
    np.testing.assert_allclose(found, evenly(101), atol=1e-9)


@pytest.mark.parametrize("early", [0.5, -0.5])
def test_a_frame_beside_the_strike_does_not_turn_the_cycle_over(early):
    """Cycles are given to few digits."""
    step = 1.1 / 100
    found = phase_from_strikes(np.linspace(0.2, 1.3, 101) - early * step, STRIKES)
    np.testing.assert_allclose(found, evenly(101), atol=1.0)


def test_a_cycle_that_begins_later_says_so_and_rises_beyond_the_next_strike():
    time = np.linspace(0.75, 1.9, 101)
    found = phase_from_strikes(time, STRIKES)
    assert found[0] == pytest.approx(50.0) and found[-1] == pytest.approx(150.0)
    assert (np.diff(found) > 0.0).all()


def test_what_no_strikes_surround_is_unknown():
    assert phase_from_strikes(np.linspace(0.0, 1.1, 101), STRIKES) is None
    assert phase_from_strikes(np.linspace(1.5, 2.9, 101), STRIKES) is None
    assert phase_from_strikes(np.linspace(0.2, 1.3, 101), STRIKES[:1]) is None
