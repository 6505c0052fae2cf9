"""Tests of the polynomial surrogate: recovery of polynomials, elimination of terms, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.geometry.surrogates.surrogate import (
    fit_surrogate,
    monomial_exponents,
    monomial_gradients,
    monomials,
)
from wrapjax.geometry.surrogates.training_samples import (
    MINIMUM_ANGLE_RANGE,
    angle_ranges,
    fastest_cycle_poses,
    random_poses,
)

COORDINATES = ("hip_flexion_r", "hip_adduction_r", "knee_angle_r")
SPANNED = {"one": ("knee_angle_r",), "three": COORDINATES}


def true_length(poses):
    hip, adduction, knee = poses.T
    one = 0.3 - 0.04 * knee + 0.01 * knee**3
    three = 0.4 - 0.05 * hip + 0.02 * adduction * knee - 0.01 * hip**2 * adduction + 0.003 * knee**5
    return jnp.stack([one, three], axis=-1)


@pytest.fixture(scope="module")
def poses():
    return np.random.default_rng(0).uniform(-0.7, 0.9, size=(500, 3))


@pytest.fixture(scope="module")
def surrogate(poses):
    arms = -jax.vmap(jax.jacfwd(lambda pose: true_length(pose[None])[0]))(jnp.asarray(poses))
    return fit_surrogate(
        ("one", "three"),
        COORDINATES,
        SPANNED,
        poses,
        np.asarray(true_length(poses)),
        np.asarray(jnp.swapaxes(arms, 1, 2)),
    )


@pytest.mark.parametrize(("variables", "count"), [(1, 6), (2, 21), (3, 56), (4, 126)])
def test_number_of_candidate_terms(variables, count):
    exponents = monomial_exponents(variables, 5)
    assert exponents.shape == (count, variables)
    assert not exponents[0].any() and len({tuple(row) for row in exponents}) == count


def test_gradients_of_monomials_equal_differences_and_exist_at_zero():
    exponents = jnp.asarray(monomial_exponents(3, 5))
    points = jnp.asarray(np.random.default_rng(1).normal(size=(7, 3))).at[0].set(0.0)
    gradient = monomial_gradients(exponents, points)
    assert np.isfinite(gradient).all()
    for variable in range(3):
        step = 1e-6 * jnp.eye(3)[variable][None]
        difference = (monomials(exponents, points + step) - monomials(exponents, points - step)) / 2e-6
        np.testing.assert_allclose(gradient[variable], difference, rtol=1e-6, atol=1e-7)


def test_recovers_a_polynomial_with_few_terms(surrogate):
    fresh = np.random.default_rng(2).uniform(-0.7, 0.9, size=(4, 3, 25))
    path = surrogate(jnp.asarray(fresh), jnp.zeros_like(fresh))
    expected = true_length(np.moveaxis(fresh, 1, -1).reshape(-1, 3)).reshape(4, 25, 2)
    np.testing.assert_allclose(jnp.moveaxis(path.length, 0, -1), expected, rtol=0, atol=3e-7)
    # Centering converts each power to a sum of lower ones, yet most of the 56 candidates are eliminated.
    assert surrogate.used.sum(axis=1)[0] <= 4 and surrogate.used.sum(axis=1)[1] <= 20


def test_names_of_terms_are_their_factors(surrogate):
    names = surrogate.term_names()
    assert [len(own) for own in names] == surrogate.used.sum(axis=1).tolist()
    assert names[0][:2] == ("1", "knee_angle_r") and "knee_angle_r^3" in names[0]
    assert "hip_flexion_r^2*hip_adduction_r" in names[1]
    pose = np.random.default_rng(8).uniform(-0.7, 0.9, 3)
    scaled = (pose - np.asarray(surrogate.center)) / np.asarray(surrogate.half_range)
    values = dict(zip(COORDINATES, scaled, strict=True))
    length = surrogate(jnp.asarray(pose)[None, :, None], jnp.zeros((1, 3, 1))).length[:, 0, 0]
    for row, own in enumerate(names):
        factors = [[factor.partition("^") for factor in name.split("*") if name != "1"] for name in own]
        terms = [np.prod([values[name] ** int(power or 1) for name, _, power in one]) for one in factors]
        coefficients = np.asarray(surrogate.coefficients)[row, : len(own)]
        np.testing.assert_allclose(coefficients @ np.array(terms), length[row], rtol=1e-12)


def test_moment_arm_is_minus_the_derivative_of_length(surrogate):
    pose = jnp.asarray(np.random.default_rng(3).uniform(-0.5, 0.5, size=(1, 3, 1)))
    path = surrogate(pose, jnp.zeros_like(pose))
    slope = jax.jacfwd(lambda q: surrogate(q, jnp.zeros_like(q)).length)(pose)[:, 0, 0, 0, :, 0]
    np.testing.assert_allclose(path.moment_arm[:, 0, :, 0], -slope, rtol=0, atol=1e-14)
    assert path.moment_arm[0, 0, 0, 0] == 0.0, "a coordinate that is not spanned has no moment arm"


def test_velocity_is_the_rate_of_length(surrogate):
    time = jnp.linspace(0.0, 1.0, 4001)
    angles = jnp.stack([0.4 * jnp.sin(3 * time), 0.2 * jnp.cos(2 * time), 0.5 * time])[None]
    rates = jnp.stack([1.2 * jnp.cos(3 * time), -0.4 * jnp.sin(2 * time), 0.5 + 0.0 * time])[None]
    path = surrogate(angles, rates)
    difference = np.gradient(np.asarray(path.length), np.asarray(time), axis=-1, edge_order=2)
    np.testing.assert_allclose(path.velocity, difference, rtol=0, atol=1e-6)


def test_random_poses_are_within_the_angle_ranges_of_their_frame():
    time = np.linspace(0, 2 * np.pi, 101)
    angles = np.stack([[np.sin(time), np.cos(time)], [np.sin(time) + 0.3, np.cos(time)]])
    lower, upper = angle_ranges(angles)
    assert np.allclose(upper[1] - lower[1], MINIMUM_ANGLE_RANGE), "a range of zero is widened"
    poses = random_poses(angles, 400, np.random.default_rng(0))
    frame = np.repeat(np.arange(100), 4)
    assert (poses >= lower[:, frame].T).all() and (poses <= upper[:, frame].T).all()
    assert np.ptp(poses[:4, 0]) > 0.01, "poses of one frame differ"


def test_poses_of_the_fastest_cycle_lack_its_last_frame():
    angles = np.arange(2 * 3 * 101, dtype=float).reshape(2, 3, 101)
    np.testing.assert_array_equal(fastest_cycle_poses(angles, np.array([1.2, 1.0])), angles[1, :, :-1].T)
