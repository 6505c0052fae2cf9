"""Tests of the two-level surrogate: fit of the inner level, feasibility limits, derivatives of paths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.geometry.exact_paths.wrapping import NOMINAL
from wrapjax.geometry.paths import PathState
from wrapjax.geometry.surrogates.feasibility import Feasibility
from wrapjax.geometry.surrogates.surrogate import monomial_exponents, monomials
from wrapjax.geometry.surrogates.two_level import InnerLevel, fit_inner_level, two_level_paths

HALF_RANGE = np.array([[0.01, 0.01, 0.01, 0.35, 0.35, 0.2], [0.005, 0.005, 0.005, 0.35, 0.35, 0.2]])
TERMS = 4


def cubic(changes, weights):
    """Sum of all monomials of degree 1 to 3 of each wrap's scaled changes, computed one by one."""
    total = 0.0
    for place, half in enumerate(HALF_RANGE):
        scaled = changes[place] / half
        for row, powers in enumerate(monomial_exponents(6, 3)[1:]):
            total = total + weights[place, row] * np.prod(scaled**powers)
    return total


def test_fit_recovers_cubic_polynomials():
    generator = np.random.default_rng(1)
    weights = generator.normal(size=(2, 83, TERMS))
    changes = generator.uniform(-1.0, 1.0, size=(400, 2, 6)) * HALF_RANGE
    coefficients = np.array([cubic(one, weights) for one in changes])
    coefficients[::10] = 1.0  # not physiological, excluded from the fit
    used = np.arange(400) % 10 > 0
    found = fit_inner_level(changes, HALF_RANGE, coefficients, used, np.eye(TERMS))
    np.testing.assert_allclose(found, weights, atol=1e-9)


def test_ridge_regression_of_few_samples_predicts_better_than_least_squares():
    generator, half_range = np.random.default_rng(4), HALF_RANGE[:1]

    def design(changes):
        exponents = jnp.asarray(monomial_exponents(6, 3)[1:])
        return np.asarray(monomials(exponents, jnp.asarray(changes[:, 0] / half_range)))

    changes = generator.uniform(-1.0, 1.0, size=(510, 1, 6)) * half_range
    # A kink, which no cubic polynomial can represent.
    kinked = np.maximum(design(changes) @ generator.normal(size=(83, TERMS)), 0.0)
    seen, unseen = np.arange(510) < 110, np.arange(510) >= 110
    found = fit_inner_level(changes, half_range, kinked, seen, np.eye(TERMS))[0]
    least_squares = np.linalg.lstsq(design(changes[seen]), kinked[seen], rcond=None)[0]
    ridge_error, least_squares_error = (
        np.sqrt(np.mean((design(changes[unseen]) @ own - kinked[unseen]) ** 2))
        for own in (found, least_squares)
    )
    assert ridge_error < 0.8 * least_squares_error


def test_nominal_wraps_give_the_nominal_coefficients_exactly():
    weights = jnp.asarray(np.random.default_rng(2).normal(size=(3, 2, 83, TERMS)))
    level = InnerLevel(weights, jnp.asarray(np.tile(HALF_RANGE, (3, 1, 1))))
    assert (level(jnp.zeros((3, 12))) == 0.0).all()


def limit(seed):
    generator = np.random.default_rng(seed)
    count = 3 + seed
    return Feasibility(
        support=jnp.asarray(generator.uniform(-1.0, 1.0, (count, 6))),
        weights=jnp.asarray(generator.normal(size=count)),
        offset=jnp.asarray(-0.3),
        gamma=jnp.asarray(0.5),
        center=jnp.asarray(NOMINAL),
        half_range=jnp.asarray(HALF_RANGE[0]),
        slope=jnp.asarray(-1.0),
        intercept=jnp.asarray(0.0),
    )


@pytest.fixture(scope="module")
def paths():
    """Four muscles, of which the second and the last depend on two wraps each."""
    generator = np.random.default_rng(3)

    def state(*lead):
        shapes = ((2, 5), (2, 5), (2, 3, 5))
        return PathState(*(jnp.asarray(generator.normal(size=(*lead, *shape))) for shape in shapes))

    inner = InnerLevel(
        jnp.asarray(0.1 * generator.normal(size=(2, 2, 83, TERMS))),
        jnp.asarray(np.tile(HALF_RANGE, (2, 1, 1))),
    )
    limits = [(1, 0, limit(1)), (1, 1, limit(2)), (3, 1, limit(3))]
    return two_level_paths(state(4), [1, 3], inner, state(2, TERMS), limits)


@pytest.fixture(scope="module")
def changes():
    return jnp.asarray(np.random.default_rng(4).uniform(-0.7, 0.7, (4, 12)) * HALF_RANGE.ravel())


def test_muscles_without_free_wraps_do_not_change(paths, changes):
    moved = paths.at(changes)
    fixed = np.array([0, 2])
    for name in ("length", "velocity", "moment_arm"):
        now, before = getattr(moved, name), getattr(paths.nominal, name)
        np.testing.assert_array_equal(now[fixed], before[fixed])
        assert (np.abs(now - before)[np.array([1, 3])] > 0.0).all()


def test_each_limit_depends_on_its_own_wrap(paths, changes):
    excess = paths.at(changes).infeasibility
    for muscle, place, feasibility in ((1, 0, limit(1)), (1, 1, limit(2)), (3, 1, limit(3))):
        own = changes[muscle].reshape(2, 6)[place] + NOMINAL
        np.testing.assert_allclose(excess[muscle, place], feasibility.excess(own), rtol=1e-13)
    assert (excess[np.array([0, 0, 2, 2, 3]), np.array([0, 1, 0, 1, 0])] < 0.0).all()


def test_derivatives_and_curvature_equal_dense_derivatives(paths, changes):
    """Dense derivatives by all changes show that no muscle depends on another muscle's changes."""
    dense = jax.jit(jax.jacfwd(lambda at: paths.at(at)))(changes)
    found, derivatives = jax.jit(lambda at: paths.linearized(at))(changes)
    weights = jax.tree.map(lambda leaf: jnp.cos(jnp.arange(leaf.size)).reshape(leaf.shape), found)

    def total(changes):
        products = jax.tree.map(lambda one, weight: jnp.sum(one * weight), paths.at(changes), weights)
        return jax.tree.reduce(jnp.add, products)

    hessian = jax.jit(jax.hessian(total))(changes)
    curvature = jax.jit(lambda at: paths.curvature(at, weights, paths.linearized(at)))(changes)
    for muscle in range(4):
        for other in range(4):
            for own, full in zip(jax.tree.leaves(derivatives), jax.tree.leaves(dense), strict=True):
                by_other = np.moveaxis(np.asarray(full[muscle, ..., other, :]), -1, 0)
                expected = own[muscle] if other == muscle else np.zeros(by_other.shape)
                np.testing.assert_allclose(by_other, expected, atol=1e-9)
            expected = curvature[muscle] if other == muscle else np.zeros((12, 12))
            np.testing.assert_allclose(hessian[muscle, :, other], expected, rtol=1e-8, atol=1e-6)
