"""Gait events and cycles from the vertical ground reaction force; phases are counted from strikes."""

import tomllib

import numpy as np
import pytest

from wrapjax.io.storage import read_storage
from wrapjax.preprocessing.gait.gait_events import (
    AT_STRIKE,
    find_contacts,
    gait_phases,
    phase_from_strikes,
    uniform_phases,
)

RATE = 1000.0
STRIKES = np.array([0.2, 1.3, 2.5])
#: A walk of equal strides.
WALK = 0.3 + 1.1 * np.arange(5)


def force_of_steps(time, strikes, stance=0.7, weight=700.0):
    """Compute a vertical force with two peaks per stance, zero between stances."""
    force = np.zeros_like(time)
    for strike in strikes:
        phase = (time - strike) / stance
        inside = (phase > 0.0) & (phase < 1.0)
        force += inside * weight * (np.sin(np.pi * phase) + 0.3 * np.sin(3.0 * np.pi * phase))
    return force


def test_strikes_and_offs_are_found_within_a_few_samples():
    time = np.arange(6000) / RATE
    strikes = np.array([0.5, 1.61, 2.7, 3.83])
    contacts = find_contacts(time, force_of_steps(time, strikes))
    # The threshold of 30 N is exceeded from 5 ms after the start of contact to 5 ms before its end.
    np.testing.assert_allclose(contacts.strikes, strikes, atol=6e-3)
    np.testing.assert_allclose(contacts.offs, strikes + 0.7, atol=6e-3)
    assert len(contacts.cycles()) == 3
    assert contacts.cycles(start=1.0, end=3.0) == (tuple(contacts.strikes[1:3]),)


def test_short_contacts_and_gaps_are_ignored():
    time = np.arange(4000) / RATE
    force = force_of_steps(time, [0.5, 1.6])
    force[(time > 0.52) & (time < 0.54)] = 0.0  # ringing of the plate after the impact
    force[(time > 1.35) & (time < 1.38)] = 60.0  # toes touch the belt during swing
    contacts = find_contacts(time, force)
    assert contacts.strikes.size == contacts.offs.size == 2


def test_a_contact_at_the_start_of_the_recording_has_no_strike():
    time = np.arange(2000) / RATE
    contacts = find_contacts(time, force_of_steps(time, [-0.3, 0.8]))
    assert contacts.strikes.size == 1 and contacts.offs.size == 2


def test_an_interval_with_an_unmeasured_step_is_not_a_cycle():
    time = np.arange(9000) / RATE
    contacts = find_contacts(time, force_of_steps(time, [0.5, 1.6, 7.0]))
    assert len(contacts.cycles()) == 1
    assert len(contacts.cycles(longest=10.0)) == 2


@pytest.mark.parametrize("threshold", [20.0, 30.0, 50.0])
def test_all_cycles_of_a_treadmill_recording_are_found_within_a_frame(data_folder, threshold):
    folder = data_folder / "healthy_treadmill"
    with (folder / "subject.toml").open("rb") as stream:
        listed = [cycle for trial in tomllib.load(stream)["trial"] for cycle in trial["cycles"]]
    forces = read_storage(folder / "trials" / "walk" / "ground_forces.mot", trust_row_count=False)
    # The second plate is under the left foot.
    vertical = forces.values[:, forces.columns.index("1_ground_force_vy")]
    found = find_contacts(forces.time, vertical, threshold).cycles()
    assert len(found) == len(listed) == 53
    # Samples are 20 ms apart, their times printed to a microsecond.
    np.testing.assert_allclose(found, listed, atol=0.02 + 1e-5)


def cycle(start, end):
    return np.linspace(start, end, 101)


def test_a_cycle_from_strike_to_strike_is_uniform():
    found = phase_from_strikes(cycle(0.2, 1.3), STRIKES)
    np.testing.assert_allclose(found, uniform_phases(101), atol=1e-9)


@pytest.mark.parametrize("early", [0.5, -0.5])
def test_a_frame_just_before_the_strike_has_phase_zero(early):
    """Limits of cycles are given with few digits."""
    step = 1.1 / 100
    found = phase_from_strikes(cycle(0.2, 1.3) - early * step, STRIKES)
    np.testing.assert_allclose(found, uniform_phases(101), atol=1.0)


def test_a_cycle_that_starts_later_exceeds_100_after_the_next_strike():
    time = cycle(0.75, 1.9)
    found = phase_from_strikes(time, STRIKES)
    assert found[0] == pytest.approx(50.0) and found[-1] == pytest.approx(150.0)
    assert (np.diff(found) > 0.0).all()


def test_strikes_are_extrapolated():
    """By the median stride time; by the duration of the cycle if only one strike was recorded."""
    ahead = phase_from_strikes(cycle(0.85, 1.95), WALK)
    for number in range(-5, 10):
        beyond = phase_from_strikes(cycle(0.85, 1.95) + 1.1 * number, WALK)
        np.testing.assert_allclose(beyond, ahead, atol=1e-9)
    np.testing.assert_allclose(phase_from_strikes(cycle(0.85, 1.95), WALK[:1]), ahead, atol=1e-9)


@pytest.mark.parametrize("early", [0.02, -0.01])
def test_limits_of_cycles_take_precedence_over_filtered_forces(early):
    """Filtered forces rise early; the first cycle, the last one and one without forces are treated alike."""
    listed = np.array([cycle(*WALK[row : row + 2]) for row in (0, 1, 3, 2)])
    forces = [WALK - early] * 3 + [np.zeros(0)]
    np.testing.assert_array_equal(gait_phases(listed, forces), np.tile(uniform_phases(101), (4, 1)))
    np.testing.assert_array_equal(
        gait_phases(listed, [WALK[1:-1] - early] * 4), np.tile(uniform_phases(101), (4, 1))
    )


def test_cycles_that_start_elsewhere_are_counted_from_strikes():
    """No strike was recorded after the last cycle, and none at all in another."""
    later = 0.4 * 1.1
    cut = np.array([cycle(*WALK[row : row + 2] + later) for row in (0, 1, 3, 2)])
    found = gait_phases(cut, [WALK[:-1]] * 3 + [np.zeros(0)])
    np.testing.assert_allclose(found, np.tile(40.0 + uniform_phases(101), (4, 1)), atol=1e-9)


def test_one_cycle_that_starts_elsewhere_suffices_to_use_strikes():
    listed = np.array([cycle(*WALK[:2]), cycle(*WALK[1:3] + 2.0 * AT_STRIKE)])
    first, second = gait_phases(listed, [WALK - 0.02] * 2)
    assert first[0] == pytest.approx(100.0 * 0.02 / 1.1) and second[0] == pytest.approx(100.0 * 0.08 / 1.1)


def test_a_partial_stride_is_not_a_complete_cycle():
    """It starts at a strike and ends before the next one."""
    found = gait_phases(np.array([cycle(WALK[0], WALK[0] + 0.88)]), [WALK])
    np.testing.assert_allclose(found[0], 0.8 * uniform_phases(101), atol=1e-9)


def test_starts_are_averaged_on_a_circle():
    """5 % late and 5 % early average to the strike, not to half a cycle."""
    late, early = (cycle(*WALK[:2] + 1.1 * share) for share in (0.05, -0.05))
    found = gait_phases(np.array([late, early, late]), [WALK, WALK, np.zeros(0)])
    assert found[1][0] == pytest.approx(95.0)
    assert min(found[2][0], 100.0 - found[2][0]) == pytest.approx(0.0, abs=1e-9)


def test_without_strikes_phases_are_uniform():
    found = gait_phases(np.array([cycle(0.0, 1.1), cycle(2.0, 3.2)]), [np.zeros(0)] * 2)
    np.testing.assert_array_equal(found, np.tile(uniform_phases(101), (2, 1)))
