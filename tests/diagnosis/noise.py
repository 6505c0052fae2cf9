"""Cycle noise with a smooth kernel, for tests."""

import numpy as np

from wrapjax.diagnosis.null_hypotheses.cycle_noise import CycleNoise
from wrapjax.diagnosis.null_hypotheses.error_sources import periodic_kernel


def noise_of_width(between, width):
    """Return noise with this correlation width in gait cycles."""
    phases = 2 * round(1.5 / width) + 1
    return CycleNoise(between, np.maximum(np.fft.rfft(periodic_kernel(phases, width)[0]).real, 0.0))
