"""The error budget and the input-driven variance: exact sums, unbiased parts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrapjax.diagnosis.localization import BINS, bin_weights, split_error
from wrapjax.diagnosis.null_hypotheses.noise_floor import input_driven_variance

FRAMES = 101
PHASE = np.linspace(0.0, 1.0, FRAMES)


def smooth(generator, *shape, harmonics=3):
    """Random smooth periodic curves of standard deviation one."""
    waves = np.concatenate(
        [[np.sin(2 * np.pi * k * PHASE), np.cos(2 * np.pi * k * PHASE)] for k in range(1, harmonics + 1)]
    )
    return generator.normal(size=(*shape, 2 * harmonics)) @ waves / np.sqrt(harmonics)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.lists(st.integers(2, 5), min_size=1, max_size=3),
    frames=st.integers(21, 130),
)
def test_parts_add_up_to_the_mean_squared_error(seed, counts, frames):
    generator = np.random.default_rng(seed)
    speeds = np.repeat(np.arange(len(counts)), counts)
    residuals = generator.normal(size=(len(speeds), 3, frames)) + 4.0
    driven = generator.normal(size=(len(counts), 3, frames))
    budget = split_error(residuals, speeds, driven)
    for speed in range(len(counts)):
        square = np.mean(residuals[speeds == speed] ** 2, axis=0)
        np.testing.assert_allclose(budget.total[speed], square @ bin_weights(frames).T, rtol=1e-9, atol=1e-9)


def test_bins_cover_the_cycle_with_equal_weights():
    for frames in (101, 88):
        weights = bin_weights(frames)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        np.testing.assert_allclose(weights.sum(axis=0)[1:-1], BINS / (frames - 1))
        np.testing.assert_allclose(weights @ np.linspace(0, BINS, frames), np.arange(BINS) + 0.5, atol=0.02)


def test_parts_are_unbiased():
    generator = np.random.default_rng(1)
    speeds = np.repeat([0, 1], 5)
    common, specific = smooth(generator, 2), smooth(generator, 2)
    common -= common[:, :-1].mean(axis=1, keepdims=True)
    found = []
    for _ in range(300):
        cycles = 1.5 * smooth(generator, 10, 2)
        own = np.where(speeds[:, None, None] == 0, specific, -specific)
        found.append(split_error(2.0 + 3.0 * common + own + cycles, speeds).pooled())
    average = {name: np.mean([one[name] for one in found], axis=0) for name in found[0]}
    expected = {
        "bias": 4.0,
        "common": 9.0 * np.mean(common[:, :-1] ** 2, axis=1),
        "specific": np.mean(specific[:, :-1] ** 2, axis=1),
        "driven": 0.0,
        "noise": 1.5**2,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(average[name], value, rtol=0.06, atol=0.06, err_msg=name)


def test_noise_alone_is_not_explainable_on_average():
    generator = np.random.default_rng(2)
    shares = [
        split_error(smooth(generator, 8, 3), np.repeat([0, 1], 4)).explainable_share for _ in range(200)
    ]
    assert abs(np.mean(shares)) < 0.03
    assert min(shares) < 0.0, "parts are not clipped"


def test_one_cycle_at_a_speed_is_refused():
    with pytest.raises(ValueError, match=r"\[2, 1\]"):
        split_error(np.zeros((3, 1, 21)), np.array([0, 0, 1]))


def test_input_driven_variance_is_separated_from_noise():
    generator = np.random.default_rng(3)
    speeds = np.repeat([0, 1], 6)
    inputs = smooth(generator, 12, 4)
    noise = smooth(generator, 12, 2)
    drift = np.linspace(-1.0, 1.0, 6)[np.tile(np.arange(6), 2)][:, None, None]
    order = np.broadcast_to(drift, (12, 1, FRAMES))
    followed = 3.0 * order * smooth(generator, 1)[None]
    quiet = input_driven_variance(noise, np.concatenate([inputs, order], axis=1), speeds).mean()
    share = input_driven_variance(
        noise + followed, np.concatenate([inputs, order], axis=1), speeds
    ).mean() / np.mean(followed**2)
    assert abs(quiet) < 0.2
    assert 0.5 < share < 1.5


def test_many_unrelated_inputs_drive_no_variance():
    """As many inputs as a recording has, over few cycles."""
    found = []
    for seed in range(6):
        generator = np.random.default_rng(seed)
        speeds = np.repeat([0, 1, 2], 7)
        noise, inputs = (smooth(generator, 21, count, harmonics=8) for count in (6, 25))
        found.append(input_driven_variance(noise, inputs, speeds).mean() / np.mean(noise**2))
    assert abs(np.mean(found)) < 0.05 and max(found) < 0.15


def test_a_drift_is_explainable_although_it_has_no_mean():
    generator = np.random.default_rng(4)
    speeds = np.repeat([0, 1], 6)
    order = np.tile(np.linspace(-1.0, 1.0, 6), 2)[:, None, None] * np.ones((1, 1, FRAMES))
    residuals = 4.0 * order * smooth(generator, 2)[None] + 0.5 * smooth(generator, 12, 2)
    without = split_error(residuals, speeds)
    budget = split_error(residuals, speeds, input_driven_variance(residuals, order, speeds))
    assert without.explainable_share < 0.1
    assert budget.explainable_share > 0.6
