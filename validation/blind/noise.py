"""Noise of EMG envelopes and of measured joint moments."""

from __future__ import annotations

import numpy as np

from validation.blind.gait import RATE, Walk, lowpass, smooth_noise

#: Standard deviation of moment noise in N m for 72 kg, and its correlation between coordinates.
MOMENT_SD = np.array([3.2, 3.0, 1.2, 2.5, 2.2, 1.0])
MOMENT_CORRELATION = np.array(
    [
        [1.0, 0.1, 0.1, -0.5, 0.3, 0.0],
        [0.1, 1.0, 0.3, 0.0, 0.0, 0.3],
        [0.1, 0.3, 1.0, 0.0, 0.0, 0.2],
        [-0.5, 0.0, 0.0, 1.0, -0.4, 0.0],
        [0.3, 0.0, 0.0, -0.4, 1.0, 0.2],
        [0.0, 0.3, 0.2, 0.0, 0.2, 1.0],
    ]
)
#: Correlation width of moment noise in gait cycles, of EMG noise in s.
MOMENT_PHASE, EMG_TIME = 0.030, 0.030
#: Cutoff frequency of envelopes, Hz; noise in pauses relative to that in bursts.
EMG_CUTOFF, PAUSE = 6.0, 0.10
EMG_LEVELS = (0.05, 0.10, 0.20)


def noisy_envelopes(emg: np.ndarray, level: float, rng: np.random.Generator) -> np.ndarray:
    """Add noise to envelopes and filter them; ``level`` is the noise relative to the envelope."""
    burst = smooth_noise(rng, emg.shape, EMG_TIME * RATE)
    pause = smooth_noise(rng, emg.shape, EMG_TIME * RATE)
    noisy = np.abs(emg * (1.0 + level * burst) + PAUSE * level * pause)
    return np.maximum(lowpass(noisy, EMG_CUTOFF, RATE), 0.0)


def moment_noise(walk: Walk, mass: float, rng: np.random.Generator) -> np.ndarray:
    """Draw correlated noise of joint moments, (recording, coordinate, frame) in N m."""
    mixing = np.linalg.cholesky(MOMENT_CORRELATION) * (MOMENT_SD * mass / 72.0)[:, None]
    cycles = np.ptp(walk.phase, axis=1)
    frames = MOMENT_PHASE * walk.time.size / cycles
    white = np.stack([smooth_noise(rng, (6, walk.time.size), float(width)) for width in frames])
    return np.einsum("kj,rjf->rkf", mixing, white)
