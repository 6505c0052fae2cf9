"""The virtual person's gait is physiological, periodic, and different in every cycle."""

import numpy as np
import pytest

from wrapjax.datasets.virtual_person.anatomy import COORDINATES
from wrapjax.datasets.virtual_person.gait import CHANNELS, cycle_time, draw_cycle, normative_cycle


def percent(cycle, count=101):
    return np.linspace(cycle.start, cycle.end, count)


def test_key_events_have_physiological_phases():
    """Winter 1991: hip most extended near 50 %, knee most flexed at 70 to 75 %, push-off after 50 %."""
    cycle = normative_cycle()
    angles = dict(zip(COORDINATES, np.degrees(cycle.angles(percent(cycle))), strict=True))
    assert 45 <= angles["hip_flexion_r"].argmin() <= 55
    assert -15 < angles["hip_flexion_r"].min() < -5
    assert 70 <= angles["knee_angle_r"].argmax() <= 76
    assert 55 < angles["knee_angle_r"].max() < 65
    assert 10 <= angles["knee_angle_r"][:40].argmax() <= 20
    assert 60 <= angles["ankle_angle_r"].argmin() <= 70
    assert 40 <= angles["ankle_angle_r"].argmax() <= 50


def test_emg_peaks_at_its_time():
    cycle = normative_cycle()
    peaks = dict(zip(CHANNELS, cycle.emg(percent(cycle)).argmax(axis=1), strict=True))
    assert 38 <= peaks["Sol"] <= 48
    assert 2 <= peaks["VastLat"] <= 12
    assert peaks["SemiMemb"] >= 88


def test_slow_walking_has_longer_cycles_smaller_angles_and_less_emg():
    slow, natural = normative_cycle(0.8), normative_cycle(1.2)
    assert cycle_time(1.2) == pytest.approx(1.12, abs=0.02)
    assert slow.duration > 1.15 * natural.duration
    ranges = [np.ptp(cycle.angles(percent(cycle)), axis=1) for cycle in (slow, natural)]
    assert np.all(ranges[0] < ranges[1])
    peaks = [cycle.emg(percent(cycle)).max(axis=1) for cycle in (slow, natural)]
    assert np.all(peaks[0] < 0.9 * peaks[1])


def test_drawn_cycles_are_periodic_and_positive_beyond_their_ends():
    cycle = draw_cycle(np.random.default_rng(1), 1.2, start=4.0)
    time = np.linspace(3.7, 4.3, 50)
    for signal in (cycle.angles, cycle.emg):
        assert np.allclose(signal(time), signal(time + cycle.duration), atol=1e-12)
    assert cycle.emg(time).min() > 0.0


def test_cycles_differ_by_degrees_not_by_tens_of_degrees():
    generator = np.random.default_rng(2)
    cycles = [draw_cycle(generator, 1.2, 0.0) for _ in range(40)]
    angles = np.degrees([cycle.angles(percent(cycle)) for cycle in cycles])
    spread = angles.std(axis=0).mean(axis=1)
    assert np.all((spread > 0.7) & (spread < 4.0))
