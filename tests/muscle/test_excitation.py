"""Sharpening of EMG envelopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from wrapjax.muscle.excitation import fit_emg_spline, sharpen_emg


@pytest.mark.parametrize(("cutoff", "error_ratio"), [(5.0, 0.35), (6.0, 0.35), (7.0, 0.35), (8.0, 0.55)])
def test_sharpening_undoes_a_low_pass_filter(cutoff, error_ratio):
    """The effect of a zero-phase Butterworth filter is removed for the most part."""
    time = np.arange(600) / 100.0
    bursts = np.exp(-0.5 * (((time[:, None] - np.array([1.0, 2.1, 3.3, 4.4])) / 0.055) ** 2)).sum(axis=1)
    filtered = sosfiltfilt(butter(2, cutoff, fs=100.0, output="sos"), bursts)
    inside = slice(50, 550)
    emg = fit_emg_spline(time[None, inside], filtered[None, None, inside])
    # At the cutoff the filter halves the amplitude, so that half must be restored.
    residual = (1.0 - np.exp(-0.5 * (2.0 * np.pi * cutoff * 0.025) ** 2)) ** 2
    sharper = sharpen_emg(emg, jnp.array(1.0 / residual), 0.025)
    sharpened = jax.vmap(lambda one: one.at_delay(jnp.array(0.0)))(sharper)[0, 0]
    before, after = (
        np.abs(own - bursts[inside])[20:-20].max() for own in (filtered[inside], np.asarray(sharpened))
    )
    assert before > 0.02 and after < error_ratio * before


def test_zero_share_leaves_the_envelope_unchanged():
    time = np.linspace(0.0, 1.0, 41)[None]
    emg = fit_emg_spline(time, np.random.default_rng(0).uniform(size=(1, 2, 41)))
    same = sharpen_emg(emg, jnp.array(0.0), 0.025)
    np.testing.assert_array_equal(same.coefficients, emg.coefficients)
