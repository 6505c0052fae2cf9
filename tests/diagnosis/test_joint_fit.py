"""Joint fits of calibrated parameters and effect sizes: exact gradients, and selection of cycles."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.counting import counted_programs
from tests.diagnosis.joint_leg import FINE, WEIGHT, damped_leg, effects_of
from tests.diagnosis.subject import small_recording_and_context
from wrapjax.calibration.objective import MOMENT_ERROR
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.fits.joint_fit import allowed_errors, fit_jointly, joint_problem

USED = np.array([True, False, True, True])


@pytest.fixture(scope="module")
def leg():
    return damped_leg()


@pytest.fixture(scope="module")
def problem(leg):
    plain, effects, truth, _ = leg
    return joint_problem(plain, effects, truth, np.zeros(effects.count), WEIGHT)


@pytest.fixture(scope="module")
def place(leg):
    """Variables away from the minimum, within bounds."""
    _, effects, truth, effect_sizes = leg
    return jnp.concatenate(
        [jnp.asarray(truth * 1.05 + 0.01), jnp.asarray(0.7 * effect_sizes / effects.prior_sd)]
    )


def with_used(problem, used=USED, weight=WEIGHT):
    """The problem of a fit to these cycles."""
    plain = replace(problem.plain, moment_error=allowed_errors(problem.plain, used))
    return replace(problem, plain=plain, effect_size_weight=jnp.asarray(weight))


@pytest.mark.parametrize("used", [np.ones(4, dtype=bool), USED])
def test_the_gradient_is_exact(problem, place, used):
    """By every effect size, and in one direction of all variables; with a prior of the effect sizes."""
    own = with_used(problem, used, 0.3)
    found = own.linearized_at(place)
    np.testing.assert_allclose(found.cost, own.value_at(place), rtol=1e-12)
    count = own.plain.variables.count
    directions = [np.eye(len(place))[number] for number in range(count, len(place))]
    directions.append(np.random.default_rng(0).normal(size=len(place)))
    for direction in directions:
        step = 1e-5 * jnp.asarray(direction)
        rise = (own.value_at(place + step) - own.value_at(place - step)) / 2e-5
        np.testing.assert_allclose(2.0 * found.gradient @ direction, rise, rtol=1e-6, atol=1e-9)


def test_second_derivatives_are_those_of_moments_and_priors(problem, leg, place):
    """Where the residual is zero and the derivatives were computed, finite differences show nothing else."""
    plain, effects, truth, effect_sizes = leg
    own = with_used(joint_problem(plain, effects, truth, effect_sizes, WEIGHT), weight=0.3)
    at = jnp.concatenate([jnp.asarray(truth), jnp.asarray(effect_sizes / effects.prior_sd)])
    found = own.linearized_at(at)
    direction = np.random.default_rng(1).normal(size=len(at))
    # All residuals are zero there except those of effect sizes and priors, which are linear.
    ends = [own.linearized_at(at + sign * 1e-5 * jnp.asarray(direction)).gradient for sign in (1.0, -1.0)]
    product = found.gauss_newton @ direction
    np.testing.assert_allclose(
        product, (ends[0] - ends[1]) / 2e-5, rtol=0, atol=1e-6 * float(np.abs(product).max())
    )


def test_effect_sizes_are_recovered(problem, leg):
    _, effects, truth, effect_sizes = leg
    found = fit_jointly(problem, np.concatenate([truth, np.zeros(effects.count)]), solver=FINE)
    np.testing.assert_allclose(found.effect_sizes, effect_sizes, rtol=0.02)
    np.testing.assert_allclose(found.calibrated, truth, atol=0.01)
    assert found.cost < 1e-6


def test_a_large_weight_keeps_effect_sizes_small(problem, leg):
    _, effects, truth, effect_sizes = leg
    dear = replace(problem, effect_size_weight=jnp.asarray(1e4))
    found = fit_jointly(dear, np.concatenate([truth, np.zeros(effects.count)]), solver=FINE)
    assert np.abs(found.effect_sizes / effect_sizes).max() < 0.01


def test_unused_cycles_do_not_change_the_fit(problem, leg):
    """Not by a bit; used cycles do."""
    _, effects, truth, _ = leg
    start = np.concatenate([truth, np.zeros(effects.count)])
    first = fit_jointly(problem, start, USED)
    for place, same in ((1, True), (2, False)):
        measured = problem.plain.measured.at[place].add(30.0)
        other = fit_jointly(replace(problem, plain=replace(problem.plain, measured=measured)), start, USED)
        assert (np.array_equal(other.variables, first.variables) and other.cost == first.cost) is same


def test_unused_moments_leave_the_expansion_finite(problem, place):
    """Cost, gradient and curvature."""
    own = with_used(problem)
    found = own.linearized_at(place)
    for part in (found.cost, found.gradient, found.gauss_newton, found.remainder):
        assert np.isfinite(part).all()
    rows = np.asarray(own.plain.row_scale()).reshape(own.plain.measured.shape)
    assert (rows[1] == 0.0).all()
    nothing = replace(own, plain=replace(own.plain, moment_error=np.full((4, 1, 1), np.inf)))
    only = nothing.linearized_at(place)
    assert np.isfinite(only.gauss_newton).all()
    assert only.cost < found.cost


def test_used_cycles_have_the_weight_of_all(problem, place):
    """Otherwise penalties would be twice as strong in a fit to half of the cycles."""
    errors = allowed_errors(problem.plain, USED)
    np.testing.assert_allclose(
        errors.ravel(), [MOMENT_ERROR * np.sqrt(0.75)] * 1 + [np.inf] + [errors[2, 0, 0]] * 2
    )
    everything = (1.0 / allowed_errors(problem.plain, None) ** 2).sum()
    np.testing.assert_allclose((1.0 / errors**2).sum(), everything)
    with pytest.raises(ValueError, match="at least one cycle"):
        allowed_errors(problem.plain, ~np.ones(4, dtype=bool))


def test_without_effects_it_is_the_plain_calibration(leg, place):
    """To the last digit, as fits of both are compared."""
    plain, _, truth, _ = leg
    nothing = joint_problem(plain, Effects(()), truth, np.zeros(0), 0.0)
    at = place[: plain.variables.count]
    assert nothing.value_at(at) == plain.value_at(at)
    np.testing.assert_array_equal(nothing.lower, plain.lower)
    np.testing.assert_array_equal(nothing.upper, plain.upper)
    found, expected = nothing.linearized_at(at), plain.linearized_at(at)
    for name in ("cost", "gradient", "gauss_newton", "remainder"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_effects_that_alter_no_single_muscle_share_compiled_programs():
    """Otherwise a diagnosis would spend most of its time compiling."""
    plain, _, truth, _ = damped_leg()
    _, context = small_recording_and_context()
    for number, id in enumerate(
        ("passive_joint_moment", "emg_crosstalk", "force_sharing", "speed_dependent_delay")
    ):
        effects = effects_of(context, (id,))
        problem = joint_problem(plain, effects, truth, np.zeros(effects.count), WEIGHT)
        start = jnp.concatenate([jnp.asarray(truth), jnp.zeros(effects.count)])
        with counted_programs() as asked:
            problem.linearized_at(start)
            problem.value_at(start)
        assert number == 0 or not {"jit(_expand)", "jit(_value)"} & set(asked), id


def test_bounds_of_effect_sizes_are_in_prior_deviations(problem, leg):
    plain, effects, *_ = leg
    count = plain.variables.count
    np.testing.assert_allclose(problem.lower[count:] * effects.prior_sd, effects.lower)
    np.testing.assert_allclose(problem.upper[count:] * effects.prior_sd, effects.upper)
    np.testing.assert_array_equal(problem.lower[:count], plain.lower)
