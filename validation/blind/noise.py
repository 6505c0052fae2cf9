"""Noise of EMG envelopes and of measured joint moments."""

from __future__ import annotations

import numpy as np

from validation.blind.gait import RATE, Walk, lowpass, smooth_noise
from validation.blind.worlds import USUAL_EMG, USUAL_MOMENTS, EmgSettings, MomentSettings

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
#: Levels of EMG noise of the banks other than `worlds`.
EMG_LEVELS = USUAL_EMG.levels


def noisy_envelopes(
    emg: np.ndarray, level: float, rng: np.random.Generator, settings: EmgSettings = USUAL_EMG
) -> np.ndarray:
    """Add noise to envelopes and filter them; ``level`` is the noise relative to the envelope."""
    burst = smooth_noise(rng, emg.shape, settings.time * RATE)
    pause = smooth_noise(rng, emg.shape, settings.time * RATE)
    noisy = np.abs(emg * (1.0 + level * burst) + (settings.pause * level + settings.baseline) * pause)
    return np.maximum(lowpass(noisy, settings.cutoff, RATE), 0.0)


def moment_noise(
    walk: Walk, mass: float, rng: np.random.Generator, settings: MomentSettings = USUAL_MOMENTS
) -> np.ndarray:
    """Draw correlated noise of joint moments, (recording, coordinate, frame) in N m."""
    sd = settings.noise * MOMENT_SD * mass / 72.0
    mixing = np.linalg.cholesky(MOMENT_CORRELATION) * sd[:, None]
    cycles = np.ptp(walk.phase, axis=1)
    frames = settings.phase * walk.time.size / cycles
    white = np.stack([smooth_noise(rng, (6, walk.time.size), float(width)) for width in frames])
    return np.einsum("kj,rjf->rkf", mixing, white)
