"""Every simulated fault of an EMG channel is reported, and channels without a fault are not."""

import numpy as np
import pytest

from tests.preprocessing.synthetic_emg import NAMES, RATE, raw_emg
from wrapjax.preprocessing.checks.emg_quality import emg_faults
from wrapjax.subject.emg_envelopes import compute_envelopes


def _zero(volts):
    volts[2] = 0.0


def _held(volts):
    volts[2, :4000] = volts[2, 0]


def _quiet(volts):
    volts[2] *= 1e-5


def _clipped(volts):
    volts[2] = np.clip(volts[2], -4e-4, 4e-4)


def _copied(volts):
    volts[2] = 1.7 * volts[0]


def _reversed(volts):
    volts[2] = -0.5 * volts[0]


def _millivolts(volts):
    volts[2] *= 1000.0


def _microvolts(volts):
    volts *= 1e6


def _rectified(volts):
    volts[2] = np.abs(volts[2])


def _envelope(volts):
    volts[2] = compute_envelopes(volts, RATE, 1.0)[2] - 1e-6


FAULTS = {
    "zero": (_zero, "is dead", {"vastus"}),
    "held": (_held, "is dead", {"vastus"}),
    "unplugged": (_quiet, "is dead", {"vastus"}),
    "clipped": (_clipped, "is clipped (saturated)", {"vastus"}),
    "copied": (_copied, "is a duplicate of", {"soleus", "vastus"}),
    "reversed": (_reversed, "is the inverse of", {"soleus", "vastus"}),
    "one in mV": (_millivolts, "is in another unit", {"vastus"}),
    "all in uV": (_microvolts, "is in another unit", set(NAMES)),
    "rectified": (_rectified, "is rectified", {"vastus"}),
    "envelope": (_envelope, "is smoothed", {"vastus"}),
}


@pytest.mark.parametrize("seed", range(3))
def test_channels_without_fault_are_not_reported(seed):
    assert list(emg_faults(NAMES, raw_emg(seed=seed)[1], RATE)) == []


@pytest.mark.parametrize("fault", FAULTS)
def test_a_simulated_fault_is_reported(fault):
    simulate, words, faulty = FAULTS[fault]
    volts = raw_emg()[1]
    simulate(volts)
    found = {channel: message for channel, message, _ in emg_faults(NAMES, volts, RATE)}
    assert set(found) == faulty
    assert all(words in message for message in found.values()), found


def test_coarse_quantisation_is_not_reported_as_clipping():
    """With steps of 5 uV successive samples are often equal, and the maximum occurs more than once."""
    volts = np.round(raw_emg()[1] / 5e-6) * 5e-6
    assert list(emg_faults(NAMES, volts, RATE)) == []
