"""Synthetic raw EMG: bursts of noise in the frequency band of EMG, with movement artifacts."""

import numpy as np
from scipy.signal import butter, sosfilt

RATE = 1000.0
NAMES = ("soleus", "tibialis", "vastus", "rectus", "semimem")


def emg_noise(generator, shape, rate):
    """Generate noise of 30 to 300 Hz."""
    band = butter(2, [30.0, 300.0], "bandpass", fs=rate, output="sos")
    return sosfilt(band, generator.standard_normal(shape), axis=1)


def raw_emg(seconds=6.0, channels=5, seed=0, rate=RATE):
    """Generate EMG in V (channel, sample): bursts of 0.1 to 0.3 mV, noise of 2 uV, movement of 0.5 mV."""
    generator = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    carrier = emg_noise(generator, (channels, time.size), rate)
    phase = 2.0 * np.pi * (time + np.arange(channels)[:, None] / channels)
    burst = np.maximum(np.sin(phase), 0.0) * np.linspace(1e-4, 3e-4, channels)[:, None]
    noise = 2e-6 * generator.standard_normal(carrier.shape)
    return time, burst * carrier + noise + 5e-4 * np.sin(0.3 * phase)
