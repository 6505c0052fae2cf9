"""Cross-validation: blocks of cycles, predictions of held-out cycles, and conflicts between speeds."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.joint_leg import WEIGHT, damped_leg
from tests.diagnosis.subject import CURVES
from wrapjax.calibration.solvers.interface import Linearization
from wrapjax.diagnosis.fits import cross_validation
from wrapjax.diagnosis.fits.cross_validation import cross_fit, cross_validation_plan
from wrapjax.diagnosis.fits.joint_fit import (
    allowed_errors,
    effect_size_covariance,
    fit_jointly,
    joint_problem,
)
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.diagnosis.fits.verification import speed_conflict
from wrapjax.diagnosis.inputs.input import speed_numbers

SPEEDS = np.array([0, 0, 1, 1])


def uses(text):
    return tuple({"c": "calibration", "v": "validation"}[letter] for letter in text)


def blocks_of(plan):
    return [block.tolist() for block in plan.blocks]


def test_with_few_cycles_single_cycles_are_left_out():
    plan = cross_validation_plan(uses("cvccc"), np.array([0, 0, 1, 1, 0]))
    assert plan.calibration.tolist() == [0, 2, 3, 4]
    assert plan.speeds.tolist() == [0, 1, 1, 0]
    assert blocks_of(plan) == [[0], [1], [2], [3]]
    assert plan.counts.tolist() == [2, 2]
    assert not plan.new_speed.any()


def test_with_five_cycles_at_each_speed_blocks_have_one_of_each():
    plan = cross_validation_plan(uses("c" * 10), np.arange(10) % 2)
    assert blocks_of(plan) == [[0, 1], [2, 3], [4, 5], [6, 7], [8, 9]]
    one_short = cross_validation_plan(uses("c" * 9), np.arange(9) % 2)
    assert blocks_of(one_short) == [[number] for number in range(9)]


def test_there_are_five_blocks_at_most():
    """Each cycle is in one of them."""
    plan = cross_validation_plan(uses("c" * 13), np.repeat([0, 1], [7, 6]))
    assert blocks_of(plan) == [[0, 5, 7, 12], [1, 6, 8], [2, 9], [3, 10], [4, 11]]


def test_a_speed_without_calibration_cycles_is_new():
    plan = cross_validation_plan(uses("ccvvcc"), np.array([1, 1, 0, 2, 2, 2]))
    assert plan.new_speed.tolist() == [False, False, True, False, False, False]
    assert plan.speeds.tolist() == [0, 0, 1, 1], "those that fits see are counted from 0"


def test_unknown_speeds_count_as_one_speed():
    for speeds in (np.full(4, 0.7), np.full(4, np.nan)):
        plan = cross_validation_plan(uses("ccvc"), speed_numbers(speeds))
        assert plan.counts.tolist() == [3]
        assert not plan.new_speed.any()
    mixed = cross_validation_plan(uses("cccc"), speed_numbers(np.array([0.5, np.nan, 0.8, np.nan])))
    assert mixed.counts.tolist() == [1, 1, 2]


def test_without_calibration_cycles_there_are_no_blocks():
    plan = cross_validation_plan(uses("vv"), np.array([0, 1]))
    assert (blocks_of(plan), plan.counts.tolist()) == ([], [])
    assert plan.new_speed.all()


@pytest.fixture(scope="module")
def leg():
    """Joint problem of the damped leg with noise, a start, and the prediction of its moments."""
    plain, effects, truth, effect_sizes = damped_leg()
    generator = np.random.default_rng(0)
    phase = 2 * np.pi * np.linspace(0.0, 1.0, plain.measured.shape[-1])
    noise = generator.normal(size=(4, 3, 2)) @ np.stack([np.sin(phase), np.cos(phase)])
    plain = replace(plain, measured=plain.measured + 2.0 * noise)
    problem = joint_problem(plain, effects, truth, effect_sizes, WEIGHT)

    def predict(variables, effect_sizes):
        parameters = plain.variables.unpack(jnp.asarray(variables))
        return np.asarray(
            predicted_moments(CURVES, parameters, plain.recording, effects, jnp.asarray(effect_sizes))
        )

    return problem, np.concatenate([truth, effect_sizes / effects.prior_sd]), predict


def changed(problem, place, by=10.0):
    measured = problem.plain.measured.at[place].add(by)
    return replace(problem, plain=replace(problem.plain, measured=measured))


@pytest.fixture(scope="module")
def from_one_start(leg):
    """Cross-fits from one start, with the measured moments and with those of the second cycle changed."""
    problem, start, predict = leg
    seen = []

    def fit(problem, _, used=None, cache=None):
        seen.append(None if used is None else used.tolist())
        return fit_jointly(problem, start, used)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cross_validation, "fit_jointly", fit)
        plan = cross_validation_plan(uses("cccc"), SPEEDS)
        first = cross_fit(problem, start, plan, SPEEDS, predict)
        of_first = list(seen)
        return first, cross_fit(changed(problem, 1), start, plan, SPEEDS, predict), of_first


def moved(first, second):
    return np.abs(first - second).max(axis=(1, 2)) > 0.0


def test_a_prediction_does_not_depend_on_the_moments_of_its_cycle(from_one_start):
    first, second, _ = from_one_start
    assert moved(first.predicted, second.predicted).tolist() == [True, False, True, True]


def test_a_prediction_at_the_other_speed_uses_no_cycle_of_its_speed(from_one_start):
    first, second, _ = from_one_start
    assert moved(first.at_other_speed, second.at_other_speed).tolist() == [False, False, True, True]
    assert [np.array_equal(*pair) for pair in _effect_sizes_by_speed(first, second)] == [False, True]


def _effect_sizes_by_speed(first, second):
    return [
        (one.effect_sizes, other.effect_sizes)
        for one, other in zip(first.of_speeds, second.of_speeds, strict=True)
    ]


def test_each_cycle_is_left_out_once_and_each_speed_is_fitted(from_one_start):
    *_, seen = from_one_start
    all_but = [[number != place for number in range(4)] for place in range(4)]
    assert seen == [None, *all_but, [True, True, False, False], [False, False, True, True]]


def test_the_start_of_fits_without_a_cycle_leaks_little(leg):
    """They start at the fit to all cycles; its use of the cycle changes their predictions little."""
    problem, start, predict = leg
    plan = cross_validation_plan(uses("cccc"), SPEEDS)
    first, second = (cross_fit(own, start, plan, SPEEDS, predict) for own in (problem, changed(problem, 1)))
    left_out = np.std((first.predicted - second.predicted)[1])
    whole = [predict(fit.full.calibrated, fit.full.effect_sizes)[1] for fit in (first, second)]
    assert left_out < 0.2 * np.std(whole[0] - whole[1])


def test_validation_cycles_are_predicted_by_the_fit_to_all_cycles(leg):
    """A fifth cycle, equal to the first, at the slow speed and at a new speed."""
    problem, start, predict = leg

    def five(variables, effect_sizes):
        found = predict(variables, effect_sizes)
        return np.concatenate([found, found[:1]])

    for speed, new in ((0, False), (2, True)):
        speeds = np.array([*SPEEDS, speed])
        found = cross_fit(problem, start, cross_validation_plan(uses("ccccv"), speeds), speeds, five)
        expected = five(found.full.calibrated, found.full.effect_sizes)[4]
        np.testing.assert_array_equal(found.predicted[4], expected)
        assert np.array_equal(found.at_other_speed[4], expected) is new
        fast = five(found.of_speeds[1].calibrated, found.of_speeds[1].effect_sizes)
        assert np.array_equal(found.at_other_speed[4], fast[4]) is not new


def test_with_one_speed_there_is_no_prediction_at_another(leg):
    problem, start, predict = leg
    one = np.zeros(4, dtype=int)
    found = cross_fit(problem, start, cross_validation_plan(uses("cccc"), one), one, predict)
    assert (found.of_speeds, found.at_other_speed) == ((), None)
    assert speed_conflict(found, WEIGHT) is None


def information(fit, weight):
    return np.linalg.inv(effect_size_covariance(fit, weight))


def ended(fit, used, curvature, away):
    """A fit to some cycles with this curvature by effect sizes, at these sizes in prior deviations."""
    count = fit.problem.plain.variables.count
    size = count + len(curvature)
    whole = np.eye(size)
    whole[count:, count:] = curvature
    plain = replace(fit.problem.plain, moment_error=allowed_errors(fit.problem.plain, used))
    model = Linearization(jnp.zeros(()), jnp.zeros(size), jnp.asarray(whole), jnp.zeros((size, size)))
    variables = np.concatenate([np.zeros(count), away])
    return replace(fit, problem=replace(fit.problem, plain=plain), model=model, variables=variables)


def test_information_of_two_halves_adds_up_to_that_of_all_cycles(from_one_start):
    """Each half has the weight of all cycles, so that the total curvature is the mean of theirs."""
    fit = from_one_start[0].full
    generator = np.random.default_rng(0)
    roots = generator.normal(size=(2, 4, 6))
    slow, fast = roots @ roots.transpose(0, 2, 1)
    halves = [ended(fit, speed == SPEEDS, own, np.zeros(4)) for speed, own in enumerate((slow, fast))]
    whole = ended(fit, None, 0.5 * (slow + fast), np.zeros(4))
    together = sum(information(half, 0.1) for half in halves)
    np.testing.assert_allclose(together, information(whole, 0.1), rtol=1e-5)


def test_correlated_parameters_make_effect_sizes_less_certain(from_one_start):
    fit = from_one_start[0].full
    alone = ended(fit, None, np.eye(4), np.zeros(4))
    place = fit.problem.plain.variables.count
    shared = np.array(alone.model.gauss_newton)
    shared[0, place] = shared[place, 0] = 0.8
    mixed = replace(alone, model=replace(alone.model, gauss_newton=jnp.asarray(shared)))
    sizes = np.asarray(fit.problem.effect_size_sd) ** 2
    np.testing.assert_allclose(np.diag(effect_size_covariance(alone, 0.1)), 0.1 * sizes, rtol=1e-6)
    ratio = np.diag(effect_size_covariance(mixed, 0.1)) / np.diag(effect_size_covariance(alone, 0.1))
    np.testing.assert_allclose(ratio, [1.0 / (1.0 - 0.64), 1.0, 1.0, 1.0], rtol=1e-6)


def test_the_speed_conflict_is_a_mean_squared_difference_in_deviations(from_one_start):
    """Two of four effect sizes differ by two deviations of the difference: a mean square of two."""
    first = from_one_start[0]
    # The standard deviation at each speed is 0.1: a weight of 0.005, and half of the cycles.
    away = 2.0 * np.hypot(0.1, 0.1) * np.array([1.0, -1.0, 0.0, 0.0])
    slow = ended(first.full, SPEEDS == 0, np.eye(4), away)
    fast = ended(first.full, SPEEDS == 1, np.eye(4), np.zeros(4))
    found = replace(first, of_speeds=(slow, fast))
    assert speed_conflict(found, 0.005) == pytest.approx(2.0, rel=1e-5)
    third = ended(first.full, SPEEDS == 1, np.eye(4), 3.0 * away)
    worst = replace(first, of_speeds=(slow, third, fast))
    assert speed_conflict(worst, 0.005) == pytest.approx(18.0, rel=1e-5)
