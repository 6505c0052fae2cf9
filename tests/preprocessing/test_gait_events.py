"""Gait events and cycles from the vertical ground reaction force."""

import tomllib

import numpy as np
import pytest

from wrapjax.io.storage import read_storage
from wrapjax.preprocessing.gait_events import find_contacts

RATE = 1000.0


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
