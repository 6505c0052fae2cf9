"""Objective of the initial lengths: passive moments, operating ranges, and derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.calibration.initial_lengths import InitialLengthObjective, LengthErrors
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.model.parameters import initial_parameters
from wrapjax.muscle.curves import HILL_CURVES

MUSCLES = 3
#: Ratios of the true lengths to the model's.
TRUE = np.array([[1.12, 0.9, 1.05], [0.97, 1.03, 1.01]])


@pytest.fixture(scope="module")
def problem():
    """Three muscles, two of which act about both of two joints; noiseless moments of the true lengths."""
    parameters = initial_parameters(
        jnp.array([3000.0, 1500.0, 900.0]),
        jnp.array([0.05, 0.06, 0.09]),
        jnp.array([0.30, 0.29, 0.26]),
        jnp.array([0.4, 0.2, 0.1]),
    )
    own = [TRUE[0] * parameters.optimal_fiber_length, TRUE[1] * parameters.tendon_slack_length]
    middle = np.asarray(own[1] + own[0] * jnp.cos(parameters.pennation_angle))[:, None]
    # Passive samples have a larger range than walking, one joint after the other.
    sweep = np.linspace(-1.0, 1.0, 60)
    both = np.concatenate([sweep, np.zeros(60)]), np.concatenate([np.zeros(60), sweep])
    arm = np.array([[-0.04, 0.0], [-0.035, 0.03], [0.04, 0.02]])
    angle = np.stack(both)
    length = middle + 0.2 * np.asarray(own[0])[:, None] - 0.5 * arm @ angle
    walking = middle - 0.15 * np.asarray(own[0])[:, None] * (1.0 + np.sin(np.linspace(0, 6.0, 101)))
    moment_arm = np.repeat(arm[:, :, None], length.shape[1], axis=2)
    problem = InitialLengthObjective(
        curves=HILL_CURVES["paper"],
        parameters=parameters,
        walking=jnp.asarray(walking),
        length=jnp.asarray(length),
        moment_arm=jnp.asarray(moment_arm),
        moment=jnp.zeros(angle.shape),
        recorded=np.abs(angle) > 0.0,
        groups=((0, 1), (2,)),
    )
    true = problem.lengths(jnp.append(jnp.asarray(TRUE.ravel()), jnp.ones(2)))
    return dataclasses.replace(problem, moment=problem.passive_moments(true))


def test_true_lengths_are_recovered_where_moments_determine_them(problem):
    """The weights of the other terms are reduced in steps."""
    variables = problem.start()
    for weak in (1.0, 10.0, 100.0, 1e3, 1e4):
        errors = jax.tree.map(lambda error, by=weak: by * error, LengthErrors())
        errors = dataclasses.replace(errors, passive_moment=2.0)
        solution = ProjectedLevenbergMarquardt().solve(dataclasses.replace(problem, errors=errors), variables)
        assert solution.status.converged
        variables = jnp.asarray(solution.variables)
    np.testing.assert_allclose(variables[: 2 * MUSCLES], TRUE.ravel(), rtol=2e-3)


def test_default_weights_reduce_the_errors_of_moments_and_lengths(problem):
    solution = ProjectedLevenbergMarquardt().solve(problem, problem.start())
    assert solution.status.converged
    found = jnp.asarray(solution.variables)
    before, after = (
        np.abs(problem.passive_moments(problem.lengths(at)) - problem.moment)[problem.recorded].mean()
        for at in (problem.start(), found)
    )
    assert after < 0.5 * before
    assert np.abs(solution.variables[: 2 * MUSCLES] - TRUE.ravel()).max() < np.abs(TRUE - 1.0).max()


def test_terms_are_mean_squares_in_allowable_errors(problem):
    generator = np.random.default_rng(3)
    at = jnp.asarray(generator.uniform(0.9, 1.1, 8)).at[6:].set(jnp.array([1.05, 1.1]))
    parameters = problem.lengths(at)
    reach = parameters.optimal_fiber_length * jnp.cos(parameters.pennation_angle)
    length = np.asarray((problem.walking - parameters.tendon_slack_length[:, None]) / reach[:, None])
    mean = length.mean(axis=1)
    missed = np.asarray(problem.passive_moments(parameters) - problem.moment)[problem.recorded]
    expected = {
        "passive_moment": np.mean((missed / 2.0) ** 2),
        "fiber_ratio": np.mean(((at[:3] - 1.0) / 0.3) ** 2),
        "slack_ratio": np.mean((at[3:6] - 1.0) ** 2),
        "shortest": np.mean((np.maximum(0.6 - length.min(axis=1), 0.0) / 0.3) ** 2),
        "longest": np.mean(((length.max(axis=1) - np.array([1.05, 1.05, 1.1])) / 0.03) ** 2),
        "group_longest": np.mean((np.array([0.05, 0.1]) / 0.1) ** 2),
        "likeness": np.mean((np.array([mean[0] - mean[1], mean[1] - mean[0], 0.0]) / 2.0 / 0.1) ** 2),
    }
    found = {name: float(jnp.sum(rows**2)) for name, rows in problem.terms(at).items()}
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-10, err_msg=name)


def test_without_passive_moments_only_operating_ranges_matter(problem):
    bare = dataclasses.replace(problem, recorded=np.zeros_like(problem.recorded))
    assert not np.any(bare.terms(bare.start())["passive_moment"])
    solution = ProjectedLevenbergMarquardt().solve(bare, bare.start())
    longest = np.asarray(bare.normalized_lengths(bare.lengths(jnp.asarray(solution.variables)))).max(axis=1)
    np.testing.assert_allclose(longest, 1.0, atol=0.05)


def test_expansion_equals_finite_differences(problem):
    at = problem.start() * jnp.asarray(np.random.default_rng(1).uniform(0.95, 1.05, 8))
    found = problem.linearized_at(at)
    step = 1e-6
    for place, direction in enumerate(step * jnp.eye(8)):
        sides = [problem.value_at(at + sign * direction) for sign in (1, -1)]
        difference = float(sides[0] - sides[1]) / (2.0 * step)
        np.testing.assert_allclose(2.0 * found.gradient[place], difference, rtol=1e-5, atol=1e-6)
