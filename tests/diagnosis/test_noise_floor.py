"""The noise floor, shrinkage and its intervals, and Shapley values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrapjax.diagnosis.fits.verification import shapley_values
from wrapjax.diagnosis.null_hypotheses.noise_floor import (
    NoiseFloor,
    cycle_errors,
    explainable_share,
    noise_floor,
    shrinkage,
)

PHASE = np.arange(25) / 25
WAVES = np.concatenate([[np.sin(2 * np.pi * k * PHASE), np.cos(2 * np.pi * k * PHASE)] for k in (1, 2, 3)])
MEMBERS = ("damping", "offset", "drift")


def smooth(generator, *shape):
    """Random smooth periodic curves of standard deviation one."""
    return generator.normal(size=(*shape, 6)) @ WAVES / np.sqrt(3.0)


def test_the_floor_is_unbiased():
    """With few cycles at a speed, and any repeatable error."""
    generator = np.random.default_rng(0)
    speeds = np.array([0, 0, 1, 1, 1, 1])
    sizes = np.array([2.0, 1.0])
    repeats = 5.0 * smooth(generator, 2, 3)
    found = np.mean(
        [
            noise_floor(
                repeats[speeds] + sizes[speeds][:, None, None] * smooth(generator, 6, 3), speeds, 18.0
            ).by_cycle
            for _ in range(1500)
        ],
        axis=0,
    )
    np.testing.assert_allclose(found, sizes[speeds] ** 2, rtol=0.08)


def test_input_driven_variance_is_not_noise():
    generator = np.random.default_rng(1)
    residuals, speeds = smooth(generator, 8, 2), np.repeat([0, 1], 4)
    whole = noise_floor(residuals, speeds, 12.0).by_cycle
    driven = np.array([0.25 * whole[:4].mean(), -1.0])
    less = noise_floor(residuals, speeds, 12.0, driven)
    np.testing.assert_allclose(less.by_cycle[:4], 0.75 * whole[:4])
    np.testing.assert_allclose(less.by_cycle[4:], whole[4:], err_msg="a negative estimate is not subtracted")
    np.testing.assert_array_equal(less.without_driven, whole, err_msg="driven variance may be noise as well")
    some = noise_floor(residuals, speeds, 12.0, 9.0 * np.ones(2)).by_cycle
    np.testing.assert_allclose(some, 0.2 * whole, err_msg="some of it is always noise")


def test_a_single_cycle_at_its_speed_has_the_mean_floor_of_the_others():
    generator = np.random.default_rng(2)
    residuals = smooth(generator, 5, 2)
    floor = noise_floor(residuals, np.array([0, 0, 1, 0, 2]), 12.0).by_cycle
    np.testing.assert_allclose(floor[[2, 4]], floor[[0, 1, 3]].mean())
    assert not noise_floor(residuals, np.arange(5), 12.0).known


def test_shrinkage_is_exact_with_a_known_floor():
    """Every cycle loses the same share of the error above its floor."""
    floor = np.array([1.0, 2.0, 1.0, 3.0, 2.0, 1.0])
    above = np.array([8.0, 6.0, 9.0, 7.0, 8.0, 6.0])
    speeds = np.repeat([0, 1], 3)
    for share in (0.5, 1.25, -0.5):
        found = shrinkage(floor + above, floor + (1.0 - share) * above, NoiseFloor(floor, floor, 0.0), speeds)
        np.testing.assert_allclose([found.value, found.low, found.high], share)
    part = explainable_share(floor + above, NoiseFloor(floor, floor, 0.0), speeds)
    assert part.value == pytest.approx(44.0 / 54.0)
    assert part.low < part.value < part.high


def test_an_uncertain_floor_widens_the_interval_only():
    """Every cycle loses half of the error above its floor."""
    floor, above, speeds = np.full(8, 2.0), np.linspace(3.0, 5.0, 8), np.repeat([0, 1], 4)
    before, after = floor + above, floor + 0.5 * above
    exact, most_is_more, doubtful = (
        shrinkage(before, after, one, speeds)
        for one in (
            NoiseFloor(floor, floor, 0.0),
            NoiseFloor(floor, 2.0 * floor, 0.0),
            NoiseFloor(floor, floor, 0.1),
        )
    )
    for one in (most_is_more, doubtful):
        assert one.value == exact.value == pytest.approx(0.5)
        assert one.high > exact.high + 0.02
    assert doubtful.low < exact.low - 0.02
    assert most_is_more.low == pytest.approx(exact.low, abs=0.02), "a higher floor leaves less to explain"


def test_intervals_have_nearly_their_coverage():
    """In recordings of 4 to 10 cycles with a shrinkage of 0.6."""
    generator = np.random.default_rng(3)
    truth = 1.01 * (1.0 - 0.4**2)
    held, known = 0, 0
    for number in range(500):
        cycles = 4 + number % 7
        speeds = np.zeros(cycles, dtype=int) if cycles < 6 else np.arange(cycles) % 2
        size = 1.0 + 0.1 * generator.normal(size=(cycles, 1, 1))
        repeats = (4.0 * smooth(generator, 2, 3))[speeds] * size
        noise = (1.0, 3.0)[number % 2] * smooth(generator, cycles, 3)
        before, after = cycle_errors(repeats + noise), cycle_errors(0.4 * repeats + noise)
        found = shrinkage(before, after, noise_floor(repeats + noise, speeds, 18.0), speeds, seed=number)
        known += found.known
        held += found.known and found.low <= truth <= found.high
    assert known > 400
    assert 0.90 < held / known < 0.99


def test_shrinkage_of_noise_alone_is_unknown():
    """In most recordings of noise alone, and with one cycle at each speed."""
    generator = np.random.default_rng(4)
    speeds = np.repeat([0, 1], 4)
    told = 0
    for _ in range(100):
        noise = smooth(generator, 8, 3)
        before = cycle_errors(noise)
        found = shrinkage(before, 0.9 * before, noise_floor(noise, speeds, 18.0), speeds)
        assert found.known == np.isfinite(found.value) == (not found.reason)
        told += found.known
    assert told <= 10
    alone = NoiseFloor(np.full(2, np.nan), np.full(2, np.nan), 0.1)
    for found in (
        shrinkage(np.ones(2), np.ones(2), alone, np.arange(2)),
        explainable_share(np.ones(2), alone, np.arange(2)),
    ):
        assert "one cycle" in found.reason


@settings(max_examples=30, deadline=None)
@given(worth=st.lists(st.floats(-5.0, 5.0), min_size=7, max_size=7), order=st.permutations(MEMBERS))
def test_shapley_values_add_up_and_do_not_depend_on_the_order(worth, order):
    parts = [frozenset(), *(frozenset({name}) for name in MEMBERS)]
    parts += [frozenset(MEMBERS) - {name} for name in MEMBERS] + [frozenset(MEMBERS)]
    value = dict(zip(parts, [0.5, *worth], strict=True))
    shares = shapley_values(MEMBERS, lambda part: value[frozenset(part)])
    assert sum(shares.values()) == pytest.approx(value[frozenset(MEMBERS)] - 0.5)
    again = shapley_values(order, lambda part: value[frozenset(part)])
    assert again == pytest.approx(shares)


def test_the_overlap_of_two_effects_is_split_evenly():
    """Alone they remove 3 and 5, together 6: the overlap of 2 is halved."""
    value = {(): 0.0, ("a",): 3.0, ("b",): 5.0, ("a", "b"): 6.0}
    assert shapley_values(("a", "b"), value.__getitem__) == pytest.approx({"a": 2.0, "b": 4.0})
    idle = shapley_values(("a", "b", "idle"), lambda part: value[tuple(n for n in part if n != "idle")])
    assert idle == pytest.approx({"a": 2.0, "b": 4.0, "idle": 0.0})
