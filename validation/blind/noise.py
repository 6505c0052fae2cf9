"""Noise of electrodes and of inverse dynamics, and the laboratory's filters."""

from __future__ import annotations

import numpy as np

from validation.blind.gait import RATE, Walk, lowpass, smooth_noise

#: Standard deviation of the moments' noise in N m for 72 kg, and how it hangs together over the joints.
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
#: Correlation of the moments' noise in cycles, of the electrodes' in s.
MOMENT_PHASE, EMG_TIME = 0.030, 0.030
#: Envelopes are cut off here, in Hz; noise in the pauses is this share of that in the bursts.
EMG_CUTOFF, PAUSE = 6.0, 0.10
EMG_LEVELS = (0.05, 0.10, 0.20)


def noisy_envelopes(emg: np.ndarray, level: float, rng: np.random.Generator) -> np.ndarray:
    """Envelopes as a laboratory computes them from noisy electrodes; ``level`` is the noise's share."""
    burst = smooth_noise(rng, emg.shape, EMG_TIME * RATE)
    pause = smooth_noise(rng, emg.shape, EMG_TIME * RATE)
    noisy = np.abs(emg * (1.0 + level * burst) + PAUSE * level * pause)
    return np.maximum(lowpass(noisy, EMG_CUTOFF, RATE), 0.0)


def moment_noise(walk: Walk, mass: float, rng: np.random.Generator) -> np.ndarray:
    """Correlated noise, (recording, coordinate, frame) in N m."""
    mixing = np.linalg.cholesky(MOMENT_CORRELATION) * (MOMENT_SD * mass / 72.0)[:, None]
    cycles = np.ptp(walk.phase, axis=1)
    frames = MOMENT_PHASE * walk.time.size / cycles
    white = np.stack([smooth_noise(rng, (6, walk.time.size), float(width)) for width in frames])
    return np.einsum("kj,rjf->rkf", mixing, white)
