"""Envelopes of synthetic raw EMG with a known envelope."""

import numpy as np
import pytest

from wrapjax.subject.emg_envelopes import compute_envelopes, normalise, resample_evenly, sampling_rate

RATE = 1000.0
TIME = np.arange(8000) / RATE
PERIOD = 1.25
#: Slow modulation, below the low-pass cut-off of 2.8 Hz.
MODULATION = 1.0 + 0.8 * np.sin(2.0 * np.pi * 0.5 * TIME)
#: Samples without the edge effects of the filters in the first and last second.
MIDDLE = slice(1000, -1000)


def test_envelope_of_a_modulated_carrier():
    """The mean of a rectified sine is 2 / pi, so that the envelope of A(t) sin(wt) is 2 / pi A(t)."""
    carrier = np.sin(2.0 * np.pi * 150.3 * TIME)
    volts = np.array([MODULATION * carrier, 3e-3 * MODULATION * carrier])
    envelope = compute_envelopes(volts, RATE, PERIOD)
    expected = 2.0 / np.pi * MODULATION * np.array([[1.0], [3e-3]])
    np.testing.assert_allclose(envelope[:, MIDDLE] / expected[:, MIDDLE], 1.0, atol=0.02)


def test_offset_and_movement_artifacts_are_removed():
    """An offset, and movement at 2 Hz of ten times the amplitude, hardly change the envelope."""
    carrier = MODULATION * np.sin(2.0 * np.pi * 150.3 * TIME)
    disturbed = carrier + 5.0 + 10.0 * np.sin(2.0 * np.pi * 2.0 * TIME)
    clean, dirty = compute_envelopes(np.array([carrier, disturbed]), RATE, PERIOD)
    np.testing.assert_allclose(dirty[MIDDLE], clean[MIDDLE], atol=0.01)


def test_filters_have_no_delay():
    """The envelope of a burst that is symmetric in time is symmetric about the same instant."""
    burst = np.exp(-(((TIME - 4.0) / 0.5) ** 2)) * np.cos(2.0 * np.pi * 100.0 * (TIME - 4.0))
    envelope = compute_envelopes(burst[None], RATE, PERIOD)[0]
    assert abs(TIME[np.argmax(envelope)] - 4.0) < 2e-3
    np.testing.assert_allclose(envelope[3000:4000], envelope[5000:4000:-1], atol=1e-6)


def test_cutoff_follows_the_gait_period():
    """Each pass reduces the amplitude at the cut-off frequency, 3.5 over the gait period, to 1 / sqrt(2)."""
    for period in (1.0, 2.0):
        modulation = 1.0 + 0.5 * np.sin(2.0 * np.pi * 3.5 / period * TIME)
        volts = modulation * np.sin(2.0 * np.pi * 150.3 * TIME)
        envelope = compute_envelopes(volts[None], RATE, period)[0, MIDDLE] * np.pi / 2.0
        assert np.ptp(envelope) / 2.0 == pytest.approx(0.25, rel=0.03)


def test_envelopes_are_not_negative():
    burst = np.where(TIME > 4.0, np.sin(2.0 * np.pi * 150.3 * TIME), 0.0)
    assert compute_envelopes(burst[None], RATE, 0.3).min() >= 0.0


def test_normalising_takes_the_maximum_over_all_trials():
    emg = np.zeros((2, 2, 3))
    emg[0] = [[1.0, 2.0, 1.0], [0.1, 0.2, 0.3]]
    emg[1] = [[4.0, 0.0, 1.0], [0.1, 0.0, 0.0]]
    scaled = normalise(emg)
    np.testing.assert_array_equal(scaled.max(axis=(0, 2)), [1.0, 1.0])
    np.testing.assert_allclose(scaled[0, 0], [0.25, 0.5, 0.25])


def test_rounded_times_are_made_even_and_uneven_ones_interpolated():
    values = np.sin(2.0 * np.pi * TIME)[None]
    even, same = resample_evenly(np.round(TIME, 3) + 1e-7, values)
    np.testing.assert_array_equal(same, values)
    np.testing.assert_allclose(np.diff(even), 1.0 / RATE, rtol=1e-9)

    uneven = TIME + 0.02 * np.sin(2.0 * np.pi * 0.3 * TIME)
    grid, interpolated = resample_evenly(uneven, np.sin(2.0 * np.pi * uneven)[None])
    assert np.ptp(np.diff(grid)) < 1e-9
    np.testing.assert_allclose(interpolated[0], np.sin(2.0 * np.pi * grid), atol=1e-9)


def test_sampling_rate_ignores_a_gap():
    assert sampling_rate(np.concatenate([TIME[:1000], TIME[3000:]])) == pytest.approx(RATE)
