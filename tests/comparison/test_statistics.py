"""Statistical tests agree with SciPy, examples of R's manual and calculation by hand."""

import math

import numpy as np
import pytest
from scipy import stats

from wrapjax.comparison.statistics import anova, holm, paired_test, repeated_anova, spread, tukey_kramer

#: Weights of plants in g: a control and two treatments (R's ``PlantGrowth``; Dobson 1983).
PLANTS = [
    np.array([4.17, 5.58, 5.18, 6.11, 4.50, 4.61, 5.17, 4.53, 5.33, 5.14]),
    np.array([4.81, 4.17, 4.41, 3.59, 5.87, 3.83, 6.03, 4.89, 4.32, 4.69]),
    np.array([6.31, 5.12, 5.54, 5.50, 5.37, 5.29, 4.92, 6.15, 5.80, 5.26]),
]
#: Extra hours of sleep of ten people by two drugs (R's ``sleep``; Student 1908).
SLEEP = [
    np.array([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0]),
    np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4]),
]
#: Fitness of six people before, three and six months into training, its sums of squares by hand: between
#: times 143.444, between people 658.278, left over 57.222.
TRAINING = [
    np.array([45.0, 42.0, 36.0, 39.0, 51.0, 44.0]),
    np.array([50.0, 42.0, 41.0, 35.0, 55.0, 49.0]),
    np.array([55.0, 45.0, 43.0, 40.0, 59.0, 56.0]),
]


@pytest.fixture
def generator():
    return np.random.default_rng(5)


def test_standard_deviation_is_that_of_a_sample():
    assert spread(np.array([1.0, 2.0, 6.0])).mean == 3.0
    assert spread(np.array([1.0, 2.0, 6.0])).sd == pytest.approx(math.sqrt(7.0))
    assert spread(np.array([4.0])).mean == 4.0 and math.isnan(spread(np.array([4.0])).sd)
    assert math.isnan(spread(np.array([])).mean)


class TestAnova:
    def test_textbook(self):
        found = anova(PLANTS)
        assert (found.between_df, found.within_df) == (2, 27)
        assert found.f == pytest.approx(4.846, abs=5e-4) and found.p == pytest.approx(0.01591, abs=5e-6)

    def test_unequal_groups_as_scipy(self, generator):
        groups = [
            generator.normal(mean, 2.0, size) for mean, size in ((0.0, 4), (1.0, 7), (3.0, 3), (0.0, 9))
        ]
        theirs = stats.f_oneway(*groups)
        ours = anova(groups)
        assert (ours.f, ours.p) == pytest.approx((theirs.statistic, theirs.pvalue), rel=1e-12)


class TestTukeyKramer:
    def test_textbook(self):
        """As R's ``TukeyHSD`` prints them."""
        expected = {
            (0, 1): (-0.371, -1.0622161, 0.3202161, 0.3908711),
            (0, 2): (0.494, -0.1972161, 1.1852161, 0.1979960),
            (1, 2): (0.865, 0.1737839, 1.5562161, 0.0120064),
        }
        found = tukey_kramer(PLANTS)
        assert found.keys() == expected.keys()
        for pair, numbers in expected.items():
            one = found[pair]
            assert (one.difference, one.low, one.high, one.p) == pytest.approx(numbers, abs=1e-6)

    def test_unequal_groups_as_scipy(self, generator):
        groups = [generator.normal(mean, 2.0, size) for mean, size in ((0.0, 4), (1.0, 7), (3.0, 3))]
        theirs = stats.tukey_hsd(*groups)
        interval = theirs.confidence_interval()
        for (first, second), ours in tukey_kramer(groups).items():
            assert ours.p == pytest.approx(theirs.pvalue[second, first], rel=1e-8)
            assert ours.low == pytest.approx(interval.low[second, first], rel=1e-6)
            assert ours.high == pytest.approx(interval.high[second, first], rel=1e-6)


class TestRepeatedAnova:
    def test_textbook(self):
        found = repeated_anova(TRAINING)
        assert (found.effect_df, found.error_df) == (2, 10)
        assert found.f == pytest.approx((143.444 / 2) / (57.222 / 10), rel=1e-4)
        assert found.p == pytest.approx(0.0019, abs=5e-5)

    def test_differences_between_people_have_no_influence(self, generator):
        """That one person is fitter than another says nothing about training."""
        shifted = [group + 10.0 * np.arange(6) for group in TRAINING]
        assert repeated_anova(shifted).f == pytest.approx(repeated_anova(TRAINING).f, rel=1e-10)
        assert repeated_anova(TRAINING).p < 0.1 * anova(TRAINING).p

    def test_two_groups_agree_with_the_paired_test(self):
        found, paired = repeated_anova(SLEEP), paired_test(*SLEEP)
        assert found.f == pytest.approx(paired.t**2, rel=1e-12)
        assert (found.p, found.p_corrected) == pytest.approx((paired.p, paired.p), rel=1e-10)
        assert found.epsilon == pytest.approx(1.0)

    def test_sphericity(self):
        """1 where all differences vary alike, 1/(k - 1) where one contrast takes all variance."""
        alike = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [4.0, 4.0, 4.0]])
        assert repeated_anova(list(alike.T)).epsilon == pytest.approx(1.0)
        contrast = np.array([1.0, -2.0, 4.0, 0.5])[:, None] * np.array([1.0, 0.0, -1.0]) + [0.0, 5.0, 30.0]
        found = repeated_anova(list(contrast.T))
        assert found.epsilon == pytest.approx(0.5)
        assert found.p_corrected == pytest.approx(stats.f.sf(found.f, 1, 3), rel=1e-10)
        assert found.p_corrected > found.p

    def test_correction_by_hand(self):
        """Epsilon from the matrix of covariances, by Box's formula as textbooks print it."""
        covariance = np.cov(np.stack(TRAINING))
        k = 3
        top = (k * (np.trace(covariance) / k - covariance.mean())) ** 2
        rows = covariance.mean(axis=1)
        bottom = (k - 1) * ((covariance**2).sum() - 2 * k * (rows**2).sum() + k**2 * covariance.mean() ** 2)
        assert repeated_anova(TRAINING).epsilon == pytest.approx(top / bottom, rel=1e-10)


class TestPairedTest:
    def test_textbook(self):
        found = paired_test(*SLEEP)
        assert (found.n, found.df) == (10, 9)
        assert found.t == pytest.approx(-4.0621, abs=5e-5) and found.p == pytest.approx(0.002833, abs=5e-7)
        assert (found.difference, found.low, found.high) == pytest.approx((-1.58, -2.4598858, -0.7001142))
        assert found.d_z == pytest.approx(-4.0621 / math.sqrt(10), abs=5e-5)

    def test_as_scipy(self, generator):
        ours, theirs = generator.normal(size=(2, 4))
        found, expected = paired_test(ours, theirs), stats.ttest_rel(ours, theirs)
        interval = expected.confidence_interval()
        assert (found.t, found.p, found.low, found.high) == pytest.approx(
            (expected.statistic, expected.pvalue, interval.low, interval.high), rel=1e-10
        )


class TestInsufficientSamples:
    """Samples that are too small for a test give None, without a warning or an error."""

    @pytest.mark.parametrize("size", [0, 1, 2])
    def test_fewer_than_three_units(self, size):
        groups = [np.arange(size) + 1.0, np.arange(size) ** 2 + 0.5]
        assert anova(groups) is tukey_kramer(groups) is repeated_anova(groups) is paired_test(*groups) is None

    def test_one_method(self):
        groups = [np.array([1.0, 2.0, 3.0])]
        assert anova(groups) is tukey_kramer(groups) is repeated_anova(groups) is None

    @pytest.mark.parametrize("shift", [0.0, 0.1])
    def test_nothing_varies_within_methods(self, shift):
        """Rounding errors must not count as variance: a constant shift is no infinite effect."""
        groups = [np.full(4, 0.3), np.full(4, 0.3 + shift)]
        one, pair = anova(groups), tukey_kramer(groups)[0, 1]
        assert math.isnan(one.f) and math.isnan(one.p)
        assert pair.difference == pytest.approx(shift) and math.isnan(pair.p) and math.isnan(pair.low)

    @pytest.mark.parametrize("shift", [0.0, 0.1])
    def test_differences_do_not_vary(self, shift):
        values = np.array([0.3, 0.7, 1.9])
        found, repeated = paired_test(values + shift, values), repeated_anova([values, values + shift])
        assert found.difference == pytest.approx(shift)
        assert all(math.isnan(number) for number in (found.t, found.p, found.d_z, found.low, found.high))
        assert all(math.isnan(number) for number in (repeated.f, repeated.p, repeated.epsilon))

    def test_not_finite(self):
        groups = [np.array([1.0, math.nan, 2.0]), np.array([1.0, 2.0, 4.0])]
        assert math.isnan(anova(groups).p) and math.isnan(tukey_kramer(groups)[0, 1].p)
        assert math.isnan(repeated_anova(groups).p) and math.isnan(paired_test(*groups).p)


def test_holm_by_hand():
    found = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": math.nan, "e": 0.5})
    # Times 4, 3, 2, 1 in order of size, and never below the one before.
    assert math.isnan(found.pop("d"))
    assert found == pytest.approx({"a": 0.04, "c": 0.09, "b": 0.09, "e": 0.5})
    assert holm({1: 0.6, 2: 0.7}) == {1: 1.0, 2: 1.0}
    assert holm({}) == {}
