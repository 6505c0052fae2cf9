"""Channels that were exchanged in all recordings: found by their phases of activity in walking."""

import numpy as np
import pytest

from wrapjax.subject.gait_activity import EXCHANGE_GAIN, USUAL_ACTIVITY, exchanged_channels, usual_envelope
from wrapjax.subject.muscle_groups import REGIONS

MUSCLES = {"Sol": ["soleus_l"], "TA": ["tib_ant_l"], "VM": ["vasmed_l"], "VL": ["vas_lat_l"], "X": ["sart_l"]}


def recorded(noise: float = 0.2) -> dict[str, np.ndarray]:
    """Draw usual envelopes with noise; the sartorius has no usual one."""
    generator = np.random.default_rng(1)
    usual = {name: usual_envelope(muscles, 101) for name, muscles in MUSCLES.items()}
    return {
        name: 0.05 + (0.5 if own is None else own) + noise * generator.normal(size=101)
        for name, own in usual.items()
    }


def test_usual_envelopes_repeat_and_follow_the_onsets():
    envelope = usual_envelope(["tibant_r"], 101)
    assert envelope[0] == pytest.approx(envelope[-1], abs=1e-6)
    assert envelope[90] > 0.99 and envelope[5] > 0.9 and envelope[35] < 0.01
    assert usual_envelope(["sart_r"], 101) is None
    assert set(USUAL_ACTIVITY) <= {name for members in REGIONS.values() for name in members}
    for phases in USUAL_ACTIVITY.values():
        assert all(0.0 <= first < last < first + 100.0 for first, last in phases)


def test_exchanged_channels_are_found_whatever_their_gain_and_no_others():
    envelopes = recorded()
    assert exchanged_channels(envelopes, MUSCLES) == {}
    exchanged = {**envelopes, "Sol": 3.0 * envelopes["VL"], "VL": 0.2 * envelopes["Sol"]}
    found = exchanged_channels(exchanged, MUSCLES)
    assert max(found, key=found.get) == ("Sol", "VL") and found["Sol", "VL"] > EXCHANGE_GAIN
    assert all("X" not in pair for pair in found)


def test_muscles_with_the_same_phases_cannot_be_told_apart():
    envelopes = recorded()
    exchanged = {**envelopes, "VM": envelopes["VL"], "VL": envelopes["VM"]}
    assert exchanged_channels(exchanged, MUSCLES) == {}


def test_a_channel_that_records_nothing_is_left_out():
    assert exchanged_channels({**recorded(), "Sol": np.zeros(101)}, MUSCLES) == {}
