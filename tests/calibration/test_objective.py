"""Objective: derivatives by blocks equal dense ones, and the cost is the documented sum of terms."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.calibration.dense import dense_derivatives, dense_slopes
from tests.model.small import MODES, MUSCLES, small_limited_objective, small_objective
from wrapjax.calibration.objective import symmetric_product
from wrapjax.calibration.problem import crossing_variables
from wrapjax.geometry.paths import AdjustablePath
from wrapjax.model.alteration import tendon_alterations
from wrapjax.model.forward import muscle_states


@pytest.fixture(scope="module")
def problem():
    return small_objective()


@pytest.fixture(scope="module")
def point(problem):
    """Point within the bounds and away from the start, where penalties on changes are zero."""
    factor = np.random.default_rng(5).uniform(0.93, 1.07, problem.variables.count)
    return problem.variables.start() * jnp.asarray(factor)


def test_expansion_equals_dense_derivatives_of_all_residuals(problem, point):
    found = problem.linearized_at(point)
    rows, jacobian, hessian = dense_derivatives(problem, point)
    np.testing.assert_allclose(found.cost, rows @ rows, rtol=1e-13)
    np.testing.assert_allclose(found.gradient, jacobian.T @ rows, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.gauss_newton, jacobian.T @ jacobian, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.gauss_newton + found.remainder, hessian, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "shift",
    [
        pytest.param(0.0, id="some limits push", marks=pytest.mark.slow),
        pytest.param(0.4, id="most limits push"),
    ],
)
def test_expansion_with_paths_and_limits(shift):
    """Derivatives by paths, computed frame by frame, equal dense derivatives."""
    problem = small_limited_objective(seed=1)
    limits = tuple(dataclasses.replace(limit, shift=limit.shift + shift) for limit in problem.limits)
    problem = problem.with_limits(limits)
    generator = np.random.default_rng(6)
    point = problem.start(problem.initial) * jnp.asarray(
        generator.uniform(0.93, 1.07, problem.variables.count)
    )
    moved = np.array(["path_changes" in label for label in problem.variables.labels])
    assert moved.sum() == sum(MODES)
    point = point + jnp.asarray(moved * generator.normal(size=moved.size))
    excess = eqx.filter_jit(lambda problem, x: problem.excess(x))(problem, point)
    above = sum(int((one + limit.shift > 0.0).sum()) for one, limit in zip(excess, limits, strict=True))
    assert above > 5
    found = problem.linearized_at(point)
    rows, jacobian, hessian = dense_derivatives(problem, point)
    np.testing.assert_allclose(found.cost, problem.value_at(point), rtol=1e-13)
    np.testing.assert_allclose(found.gradient, jacobian.T @ rows, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.gauss_newton, jacobian.T @ jacobian, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(found.gauss_newton + found.remainder, hessian, rtol=1e-8, atol=1e-7)


@pytest.mark.slow
def test_expansion_with_paths_and_a_compliant_tendon():
    """With a compliant tendon the force in a frame depends on the path in earlier frames as well."""
    plain = small_limited_objective(seed=1)
    muscles = len(plain.initial.emg_scale)
    problem = dataclasses.replace(plain, alterations=tendon_alterations("compliant", muscles))
    generator = np.random.default_rng(6)
    point = problem.start(problem.initial) * jnp.asarray(
        generator.uniform(0.93, 1.07, problem.variables.count)
    )
    moved = np.array(["path_changes" in label for label in problem.variables.labels])
    point = point + jnp.asarray(moved * generator.normal(size=moved.size))
    found = problem.linearized_at(point)
    assert abs(found.cost - plain.value_at(point)) > 1e-3 * found.cost
    residuals = jax.jit(lambda x: problem.residuals(x))
    gradient = jax.jit(lambda x: jax.grad(problem.value)(x) / 2.0)
    np.testing.assert_allclose(found.gradient, gradient(point), rtol=1e-9, atol=1e-9)
    for direction in generator.normal(size=(3, point.size)):
        ahead, behind = (point + sign * 1e-5 * jnp.asarray(direction) for sign in (1.0, -1.0))
        along = (residuals(ahead) - residuals(behind)) / 2e-5
        np.testing.assert_allclose(direction @ found.gauss_newton @ direction, along @ along, rtol=1e-7)
        own = (found.gauss_newton + found.remainder) @ direction
        difference = (gradient(ahead) - gradient(behind)) / 2e-5
        np.testing.assert_allclose(own, difference, rtol=1e-4, atol=1e-5 * float(jnp.abs(own).max()))


def test_products_by_coordinate_equal_those_of_the_whole_jacobian():
    """Muscles that do not cross a coordinate are left out, but not those whose arm is zero at first."""
    plain = small_limited_objective(seed=1)
    path = plain.recording.path
    uncrossed, at_first_zero = (2, 1), (0, 1)
    nominal = path.nominal.moment_arm.at[uncrossed[0], :, uncrossed[1]].set(0.0)
    nominal = nominal.at[at_first_zero[0], :, at_first_zero[1]].set(0.0)
    changed = path.modes.moment_arm.at[uncrossed[0], :, :, uncrossed[1]].set(0.0)
    path = AdjustablePath(
        dataclasses.replace(path.nominal, moment_arm=nominal),
        dataclasses.replace(path.modes, moment_arm=changed),
    )
    plain = dataclasses.replace(plain, recording=dataclasses.replace(plain.recording, path=path))
    crossing = crossing_variables(path, plain.variables)
    labels = [{plain.variables.labels[place].split(".")[0] for place in own} for own in crossing]
    assert labels == [set(MUSCLES), set(MUSCLES[:2])]
    generator = np.random.default_rng(2)
    point = plain.start(plain.initial) + jnp.asarray(0.05 * generator.normal(size=plain.variables.count))
    found = dataclasses.replace(plain, crossing_variables=crossing).linearized_at(point)
    whole = plain.linearized_at(point)
    np.testing.assert_allclose(found.gauss_newton, whole.gauss_newton, rtol=1e-12, atol=1e-12)
    no_arms = dataclasses.replace(path.nominal, moment_arm=jnp.zeros_like(nominal))
    no_changes = dataclasses.replace(path.modes, moment_arm=jnp.zeros_like(changed))
    assert crossing_variables(AdjustablePath(no_arms, no_changes), plain.variables) == ((), ())
    # A coordinate that no muscle crosses contributes nothing.
    first_alone = dataclasses.replace(plain, crossing_variables=(crossing[0], ())).linearized_at(point)
    assert bool(jnp.isfinite(first_alone.gauss_newton).all())


@pytest.mark.parametrize("rows", [3, 299, 300, 731])
def test_symmetric_product_equals_the_product(rows):
    matrix = np.random.default_rng(rows).normal(size=(rows, 7))
    np.testing.assert_allclose(
        symmetric_product(jnp.asarray(matrix)), matrix @ matrix.T, rtol=1e-12, atol=1e-12
    )


def test_gradient_equals_finite_differences(problem, point):
    gradient = 2 * problem.linearized_at(point).gradient
    cost = jax.jit(lambda x: jnp.sum(problem.residuals(x) ** 2))
    step = 1e-6
    for place, direction in enumerate(jnp.eye(point.size)):
        difference = (cost(point + step * direction) - cost(point - step * direction)) / (2 * step)
        label = problem.variables.labels[place]
        np.testing.assert_allclose(gradient[place], difference, rtol=1e-5, atol=1e-6, err_msg=label)


def test_expansion_with_a_shared_parameter(problem, point):
    """Derivatives by a delay that two muscles share are sums."""
    variables = problem.variables
    shared_index = np.array(variables.index)
    shared_index[1, 0] = shared_index[0, 0]
    kept = np.array([place for place in range(variables.count) if place != variables.index[1, 0]])
    renumbered = np.searchsorted(kept, shared_index)
    layers = np.full((2, kept.size), renumbered.size)
    for place in range(kept.size):
        spots = np.flatnonzero(renumbered == place)
        layers[: len(spots), place] = spots
    shared = dataclasses.replace(
        variables,
        index=renumbered,
        places=layers,
        lower=variables.lower[kept],
        upper=variables.upper[kept],
        prior_mean=variables.prior_mean[kept],
        prior_precision=variables.prior_precision[kept],
        labels=tuple(variables.labels[place] for place in kept),
    )
    tied = dataclasses.replace(problem, variables=shared)
    at = point[kept]
    found = tied.linearized_at(at)
    rows, jacobian = dense_slopes(tied, at)
    np.testing.assert_allclose(found.gradient, jacobian.T @ rows, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.gauss_newton, jacobian.T @ jacobian, rtol=1e-10, atol=1e-10)


def test_terms_are_mean_squares_in_allowable_errors(problem, point):
    parameters = problem.variables.unpack(point)
    run = eqx.filter_jit(muscle_states)
    states = run(problem.curves, parameters, problem.recording)
    before = run(problem.curves, problem.variables.base, problem.recording)
    length, start = states.fiber.normalized_length, before.fiber.normalized_length
    overall = length.mean(axis=(1, 2)) - start.mean(axis=(1, 2))
    shape = (length - length.mean(axis=(1, 2), keepdims=True)).reshape(3, -1)
    shape_start = (start - start.mean(axis=(1, 2), keepdims=True)).reshape(3, -1)
    pair = parameters.emg_scale[:2] - parameters.emg_scale[:2].mean()
    delays = parameters.electromechanical_delay
    expected = {
        "joint_moment": np.mean(((states.moment.sum(axis=0) - problem.measured) / 2.5) ** 2),
        "normalized_fiber_length_mean": np.mean(((length - start).mean(axis=1) / 0.1) ** 2),
        "normalized_fiber_length_shape": np.mean(((shape - shape_start) / 0.1) ** 2),
        "passive_force": np.mean((states.fiber.passive_force / 50) ** 2),
        "grouped_fiber_length_mean": np.mean(((overall - overall.mean()) / 0.05) ** 2),
        "grouped_fiber_length_shape": np.mean(((shape - shape.mean(axis=0, keepdims=True)) / 0.05) ** 2),
        "grouped_emg_scale": np.mean((pair / 0.1) ** 2),
        "grouped_delay": np.mean(((delays[:2] - delays[:2].mean()) / 0.02) ** 2),
        "prior": np.mean(((delays - 0.05) / 0.05) ** 2)
        + np.mean(((parameters.activation_time_constant - 0.015) / 0.02) ** 2)
        + np.mean((parameters.activation_nonlinearity / 0.1) ** 2)
        + np.mean(((parameters.emg_scale - 0.3) / 0.2) ** 2)
        + np.mean(
            ((parameters.optimal_fiber_length - problem.variables.base.optimal_fiber_length) / 0.1) ** 2
        )
        + np.mean(((parameters.tendon_slack_length - problem.variables.base.tendon_slack_length) / 0.1) ** 2),
    }
    terms = eqx.filter_jit(lambda problem, at: problem.terms(at))(problem, parameters)
    found = {name: float(jnp.sum(rows**2)) for name, rows in terms.items()}
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-10, err_msg=name)
    np.testing.assert_allclose(problem.cost(parameters), sum(expected.values()), rtol=1e-12)


def test_cost_is_pure_under_grad_jit_and_vmap(problem, point):
    parameters = problem.variables.unpack(point)
    slopes = jax.jit(jax.grad(problem.cost))(parameters)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))
    many = jax.tree.map(lambda leaf: jnp.stack([leaf, 1.01 * leaf]), parameters)
    costs = jax.jit(jax.vmap(problem.cost))(many)
    np.testing.assert_allclose(costs[0], jax.jit(lambda at: problem.cost(at))(parameters), rtol=1e-12)


def test_moment_jacobian_equals_the_dense_one(problem, point):
    plain = jax.jit(jax.jacfwd(lambda x: problem.terms(problem.variables.unpack(x))["joint_moment"]))(point)
    np.testing.assert_allclose(eqx.filter_jit(problem.moment_jacobian)(point), plain, rtol=1e-10, atol=1e-12)


def test_variables_round_trip(problem, point):
    variables = problem.variables
    np.testing.assert_allclose(variables.pack(variables.unpack(point)), point, rtol=1e-14)
    assert variables.labels[3] == "soleus_l.emg_scale"
    assert (variables.start() >= variables.lower).all() and (variables.start() <= variables.upper).all()


def test_linearize_is_traced_once(problem, point):
    traced = eqx.filter_jit(eqx.debug.assert_max_traces(type(problem).linearize, max_traces=1))
    first = traced(problem, point)
    second = traced(dataclasses.replace(problem, measured=problem.measured + 1.0), 1.01 * point)
    assert first.cost != second.cost
