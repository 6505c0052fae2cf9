"""Joint objective of two legs: shared variables, derivatives, limits and solutions of each leg."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.calibration.dense import dense_derivatives
from tests.model.small import small_limited_objective, small_objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.two_legs import join_leg_objectives, leg_solution

LEFT = ("soleus_l", "gasmed_l", "tibant_l")
#: The last muscle exists in the right leg alone.
RIGHT = ("soleus_r", "gasmed_r", "tibpost_r")
COMMON = 2
#: Shared parameters.
SHARED = (
    "activation_time_constant",
    "activation_nonlinearity",
    "optimal_fiber_length",
    "tendon_slack_length",
)


def on_the_right(problem):
    """Return the same leg with the muscle names of the right side."""
    names = dict(zip(LEFT, RIGHT, strict=True))
    labels = [label.split(".") for label in problem.variables.labels]
    renamed = tuple(f"{names[muscle]}.{name}" for muscle, name in labels)
    return replace(problem, variables=replace(problem.variables, labels=renamed))


@pytest.fixture(scope="module")
def joint():
    return join_leg_objectives(small_objective(0), on_the_right(small_objective(5)))


@pytest.fixture(scope="module")
def limited():
    """Two legs with hard limits and multipliers."""
    legs = [small_limited_objective(0), on_the_right(small_limited_objective(5))]
    for number, leg in enumerate(legs):
        generator = np.random.default_rng(number)
        legs[number] = leg.with_limits(
            tuple(
                replace(
                    limit,
                    shift=jnp.asarray(generator.uniform(0.5, 1.0, limit.shift.shape)),
                    weight=jnp.full_like(limit.weight, 2.0 + number),
                )
                for limit in leg.limits
            )
        )
    return join_leg_objectives(*legs)


def somewhere(problem, seed=2):
    generator = np.random.default_rng(seed)
    start = problem.start(problem.initial)
    return start * jnp.asarray(generator.uniform(0.95, 1.05, start.size)) + jnp.asarray(
        generator.normal(0.0, 0.01, start.size)
    )


def test_only_the_listed_parameters_are_shared(joint):
    own = [set(place.tolist()) for place in joint.places]
    assert len(own[0]) == len(own[1]) == len(joint.legs[0].lower)
    assert own[0] | own[1] == set(range(len(joint.lower)))
    labels = [leg.variables.labels for leg in joint.legs]
    shared = {
        (labels[0][joint.places[0].tolist().index(place)], labels[1][joint.places[1].tolist().index(place)])
        for place in own[0] & own[1]
    }
    expected = {
        (f"{left}.{name}", f"{right}.{name}")
        for left, right in zip(LEFT[:COMMON], RIGHT[:COMMON], strict=True)
        for name in SHARED
    }
    assert shared == expected


def test_expansion_equals_finite_differences_of_all_residuals(joint):
    """Along lines that change shared and separate variables of both legs."""
    point = somewhere(joint)
    found, rows = joint.linearized_at(point), jax.jit(lambda x: joint.residuals(x))
    np.testing.assert_allclose(found.cost, rows(point) @ rows(point), rtol=1e-12)
    np.testing.assert_allclose(found.cost, joint.value_at(point), rtol=1e-12)
    lines = np.random.default_rng(4).normal(size=(4, point.size))
    ends = [(point + 1e-6 * line, point - 1e-6 * line) for line in lines]
    pushed = np.array([(rows(ahead) - rows(behind)) / 2e-6 for ahead, behind in ends])
    np.testing.assert_allclose(lines @ found.gradient, pushed @ rows(point), rtol=1e-6)
    np.testing.assert_allclose(lines @ found.gauss_newton @ lines.T, pushed @ pushed.T, rtol=1e-6)
    bent = [(joint.linearized_at(a).gradient - joint.linearized_at(b).gradient) / 2e-6 for a, b in ends]
    curved = lines @ (found.gauss_newton + found.remainder)
    np.testing.assert_allclose(curved, bent, rtol=1e-5, atol=1e-5 * np.abs(curved).max())


@pytest.mark.slow  # the test before is quicker; each leg's own expansion is held against dense derivatives
@pytest.mark.parametrize("legs", ["joint", "limited"])
def test_expansion_equals_dense_derivatives(legs, request):
    problem = request.getfixturevalue(legs)
    point = somewhere(problem)
    found = problem.linearized_at(point)
    rows, jacobian, hessian = dense_derivatives(problem, point)
    np.testing.assert_allclose(found.cost, rows @ rows, rtol=1e-12)
    np.testing.assert_allclose(found.cost, problem.value_at(point), rtol=1e-12)
    np.testing.assert_allclose(found.gradient, jacobian.T @ rows, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.gauss_newton, jacobian.T @ jacobian, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.gauss_newton + found.remainder, hessian, rtol=1e-8, atol=1e-7)


def test_limits_are_those_of_both_legs_in_order(limited):
    point = somewhere(limited)
    parts = [leg.excess(point[place]) for leg, place in zip(limited.legs, limited.places, strict=True)]
    found = limited.excess(point)
    assert len(found) == len(limited.limits) == len(parts[0]) + len(parts[1])
    for ours, theirs in zip(found, parts[0] + parts[1], strict=True):
        np.testing.assert_array_equal(ours, theirs)
    moved = limited.with_limits(tuple(replace(limit, shift=2.0 * limit.shift) for limit in limited.limits))
    for leg, before in zip(moved.legs, limited.legs, strict=True):
        for new, old in zip(leg.limits, before.limits, strict=True):
            np.testing.assert_array_equal(new.shift, 2.0 * old.shift)


def test_variables_and_trees_round_trip(joint):
    point = jnp.clip(somewhere(joint), joint.lower, joint.upper)
    trees = joint.parameters(point)
    np.testing.assert_allclose(joint.start(trees), point, rtol=1e-14)
    for name in ("electromechanical_delay", "emg_scale"):
        assert not np.allclose(*(getattr(tree, name)[:COMMON] for tree in trees))


def test_shared_bounds_are_the_intersection():
    left, right = small_objective(0), on_the_right(small_objective(5))
    place = left.variables.labels.index("soleus_l.tendon_slack_length")
    own = left.variables.labels.index("soleus_l.emg_scale")

    def within(leg, lower, upper):
        bounds = np.array(leg.lower), np.array(leg.upper)
        for at in (place, own):
            bounds[0][at], bounds[1][at] = lower, upper
        return replace(leg, variables=replace(leg.variables, lower=bounds[0], upper=bounds[1]))

    joint = join_leg_objectives(within(left, 0.7, 1.2), within(right, 0.8, 1.3))
    assert (joint.lower[place], joint.upper[place]) == (0.8, 1.2)
    assert (joint.lower[own], joint.upper[own]) == (0.7, 1.2)
    assert joint.lower[joint.places[1][own]] == 0.8
    with pytest.raises(ValueError, match=r"soleus_r\.tendon_slack_length"):
        join_leg_objectives(within(left, 0.7, 0.8), within(right, 0.9, 1.3))


def test_solution_of_one_leg(limited):
    solver = AugmentedLagrangian()
    joint = join_leg_objectives(*(small_limited_objective(0), on_the_right(small_limited_objective(5))))
    solution = solver.solve(joint, joint.start(joint.initial))
    assert solution.status.converged
    assert solution.max_violation <= solver.ctol
    parts = [leg_solution(solution, leg) for leg in range(2)]
    assert sum(part.cost for part in parts) == pytest.approx(solution.cost, rel=1e-12)
    trees = joint.parameters(jnp.asarray(solution.variables))
    pushing = 0
    for part, leg, tree in zip(parts, joint.legs, trees, strict=True):
        assert part.problem.variables.labels == leg.variables.labels
        np.testing.assert_allclose(part.variables, leg.variables.pack(tree), rtol=1e-14)
        assert part.linearization.gauss_newton.shape == 2 * part.variables.shape
        # At the optimum nothing within bounds pulls on a leg's variables.
        inside = (part.variables > leg.lower) & (part.variables < leg.upper)
        assert np.abs(part.linearization.gradient[inside]).max() < 1e-4
        assert list(part.multipliers) == [limit.name for limit in leg.limits]
        pushing += sum(int((values > 0.0).sum()) for values in part.multipliers.values())
    given = {id(limit): 2.0 * np.asarray(limit.weight * limit.shift) for limit in solution.problem.limits}
    assert pushing == sum(int((values > 0.0).sum()) for values in given.values()) > 0
