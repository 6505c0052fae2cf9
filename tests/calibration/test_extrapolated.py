"""Excitation of muscles without an electrode by synergy commands: values and derivatives."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from tests.calibration.dense import dense_derivatives
from tests.model.small import PADDING, small_objective
from tests.model.small_extrapolated import COMMANDS, small_extrapolated_objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.model.forward import muscle_states
from wrapjax.muscle.excitation import smooth_unit_clip

EXCITATIONS = {
    "each its own": {"gasmed_l": ("gasmed_l",), "tibant_l": ("tibant_l",)},
    "one in common": {"calf": ("soleus_l", "gasmed_l")},
}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(EXCITATIONS["each its own"], id="each its own", marks=pytest.mark.slow),
        pytest.param(EXCITATIONS["one in common"], id="one in common"),
    ],
)
def problem(request):
    return small_extrapolated_objective(request.param)


@pytest.fixture(scope="module")
def point(problem):
    """Point away from the start, within the bounds, with different weights."""
    generator = np.random.default_rng(5)
    factor = generator.uniform(0.93, 1.07, problem.variables.count)
    weights = np.array([".synergy_" in label for label in problem.variables.labels])
    shift = np.where(weights, generator.uniform(0.1, 0.9, weights.size), 0.0)
    return problem.variables.start() * jnp.asarray(factor) + jnp.asarray(shift)


def test_expansion_equals_dense_derivatives(problem, point):
    found = problem.linearized_at(point)
    rows, jacobian, hessian = dense_derivatives(problem, point)
    weights = np.array([".synergy_" in label for label in problem.variables.labels])
    assert np.abs(jacobian.T @ rows)[weights].min() > 1e-4
    np.testing.assert_allclose(found.cost, rows @ rows, rtol=1e-13)
    np.testing.assert_allclose(found.gradient, jacobian.T @ rows, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.gauss_newton, jacobian.T @ jacobian, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.gauss_newton + found.remainder, hessian, rtol=1e-9, atol=1e-9)


def test_gradient_equals_finite_differences(problem, point):
    gradient = 2 * problem.linearized_at(point).gradient
    cost = problem.value_at
    step = 1e-6
    for place, label in enumerate(problem.variables.labels):
        if ".synergy_" in label:
            direction = jnp.zeros(point.size).at[place].set(step)
            difference = (cost(point + direction) - cost(point - direction)) / (2 * step)
            np.testing.assert_allclose(gradient[place], difference, rtol=1e-5, atol=1e-6, err_msg=label)


def test_variables_round_trip(problem, point):
    variables = problem.variables
    tree = variables.unpack(point)
    np.testing.assert_allclose(variables.pack(tree), point, rtol=1e-14)
    measured = np.asarray(problem.recording.emg.commands.share[:, 0]) == 0.0
    np.testing.assert_array_equal(np.asarray(tree.synergy_weights)[measured], 0.0)


def test_muscles_of_one_excitation_share_its_weights():
    problem = small_extrapolated_objective(EXCITATIONS["one in common"])
    labels = [label for label in problem.variables.labels if ".synergy_" in label]
    assert labels == ["calf.synergy_weight_1", "calf.synergy_weight_2", "calf.synergy_offset"]
    moved = problem.variables.start().at[-COMMANDS:].set(jnp.array([0.3, -0.2, 0.4]))
    np.testing.assert_array_equal(
        problem.variables.unpack(moved).synergy_weights, [[0.3, -0.2, 0.4]] * 2 + [[0.0, 0.0, 0.0]]
    )


def test_envelope_is_the_limited_sum_of_commands():
    problem = small_extrapolated_objective(EXCITATIONS["each its own"])
    weights = jnp.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.4], [3.0, 0.0, 0.0]])
    still = dataclasses.replace(
        problem.initial, synergy_weights=weights, electromechanical_delay=jnp.zeros(3), emg_scale=jnp.ones(3)
    )
    excitation = np.asarray(muscle_states(problem.curves, still, problem.recording).excitation)
    time = np.array([[0.010], [0.012]]) * np.arange(excitation.shape[-1])
    sums = [0.5 * 0.6 * np.sin(30 * time) + 0.3 * 0.4 * np.cos(17 * time) + 0.4, 1.8 * np.sin(30 * time)]
    np.testing.assert_allclose(excitation[1:], smooth_unit_clip(jnp.asarray(sums)), atol=1e-9)
    assert excitation.min() >= 0.0 and excitation.max() <= 1.0
    assert PADDING > 0 and (excitation[2] > 0.99).any() and (excitation[2] < 0.01).any()


def test_smooth_clip_is_the_identity_well_inside():
    inside = jnp.linspace(0.3, 0.7, 9)
    np.testing.assert_allclose(smooth_unit_clip(inside), inside, atol=2e-4)
    far = smooth_unit_clip(jnp.array([-1e3, -1.0, 2.0, 1e3]))
    np.testing.assert_allclose(far, [0.0, 0.0, 1.0, 1.0], atol=1e-9)


def test_muscles_with_a_channel_are_unchanged():
    """Their EMG equals that of their channel to the last bit."""
    plain = small_objective()
    problem = small_extrapolated_objective(EXCITATIONS["each its own"])
    weights = jnp.zeros((3, COMMANDS)).at[1:].set(0.4)
    tree = dataclasses.replace(problem.initial, synergy_weights=weights)
    with_commands = muscle_states(problem.curves, tree, problem.recording)
    without = muscle_states(plain.curves, plain.initial, plain.recording)
    np.testing.assert_array_equal(with_commands.moment[0], without.moment[0])


def test_only_activation_of_muscles_without_emg_is_penalised(problem, point):
    parameters = problem.variables.unpack(point)
    states = muscle_states(problem.curves, parameters, problem.recording)
    extrapolated = np.asarray(problem.recording.emg.commands.share[:, 0]) > 0.0
    expected = np.mean((np.asarray(states.activation)[extrapolated] / 0.3) ** 2)
    found = float(jnp.sum(problem.terms(parameters)["extrapolated_activation"] ** 2))
    assert found == pytest.approx(expected, rel=1e-12)


def test_a_simulated_excitation_is_recovered():
    """Noiseless moments determine the excitation of a muscle that commands drive."""
    problem = small_extrapolated_objective({"gasmed_l": ("gasmed_l",)})
    weights = jnp.zeros((3, COMMANDS)).at[1].set(jnp.array([0.5, 0.4, 0.45]))
    true = muscle_states(
        problem.curves, dataclasses.replace(problem.initial, synergy_weights=weights), problem.recording
    )
    problem = dataclasses.replace(problem, measured=true.moment.sum(axis=0))
    weak = dataclasses.replace(
        problem.initial, max_isometric_force=problem.initial.max_isometric_force.at[1].set(0.0)
    )
    without = dataclasses.replace(problem, variables=dataclasses.replace(problem.variables, base=weak))
    errors, excitations = [], []
    for one in (problem, without):
        solution = ProjectedLevenbergMarquardt().solve(one, one.variables.start())
        assert solution.status.converged
        found = muscle_states(one.curves, one.parameters(jnp.asarray(solution.variables)), one.recording)
        errors.append(float(jnp.abs(found.moment.sum(axis=0) - one.measured).mean()))
        excitations.append(np.asarray(found.excitation[1]))
    # The rest is due to priors.
    assert errors[0] < 0.4 * errors[1]
    assert np.corrcoef(excitations[0].ravel(), np.asarray(true.excitation[1]).ravel())[0, 1] > 0.95
