"""Forward model: independence of muscles and cycles; bounds and priors of freedoms."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.model.small import FRAMES, MUSCLES, PADDING, small_parameters, small_recording
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import Recording, joint_moments, muscle_state_along, muscle_states
from wrapjax.model.freedom import Freedom, FreedParameter, nga_freedom
from wrapjax.model.parameters import QUANTITIES, ModelParameters
from wrapjax.model.variables import free_variables
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.excitation import EmgSpline

CURVES = HILL_CURVES["paper"]
run_all = eqx.filter_jit(muscle_states)
run_one = eqx.filter_jit(muscle_state_along)
moments_of_all = eqx.filter_jit(joint_moments)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return small_recording()


@pytest.fixture(scope="module")
def parameters() -> ModelParameters:
    """Build parameters that differ between muscles, so that an interchange is detected."""
    factor = np.random.default_rng(7).uniform(0.9, 1.1, size=3)
    return jax.tree.map(lambda leaf: leaf * factor.reshape(3, *[1] * (leaf.ndim - 1)), small_parameters())


@pytest.fixture(scope="module")
def states(parameters, recording):
    return run_all(CURVES, parameters, recording)


def muscle(tree, row: int):
    return jax.tree.map(lambda leaf: leaf[row], tree)


def trials(recording: Recording, order) -> Recording:
    """Select cycles in any order; the trial axis is the second of every leaf."""
    emg, path = jax.tree.map(lambda leaf: leaf[:, np.asarray(order)], (recording.emg, recording.path.nominal))
    return Recording(emg, fixed_path(path), recording.padding)


def assert_trees_close(found, expected, rtol=1e-12, atol=1e-12):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol)


# ---- Axes


def test_shapes(states):
    shape = (len(MUSCLES), 2, FRAMES)
    assert states.excitation.shape == states.activation.shape == states.fiber.tendon_force.shape == shape
    assert states.moment.shape == (len(MUSCLES), 2, 2, FRAMES)


def test_all_muscles_at_once_equal_one_after_another(parameters, recording, states):
    for row in range(len(MUSCLES)):
        path, emg = muscle(recording.path.nominal, row), muscle(recording.emg, row)
        alone = run_one(path, CURVES, muscle(parameters, row), emg, PADDING)
        assert_trees_close(muscle(states, row), alone)


def test_a_muscle_depends_on_its_own_parameters_alone(parameters, recording, states):
    changed = jax.tree.map(lambda leaf: leaf.at[1].multiply(1.05), parameters)
    other = run_all(CURVES, changed, recording)
    difference = np.abs(np.asarray(other.moment - states.moment)).max(axis=(1, 2, 3))
    assert difference[1] > 0.1 and difference[0] == difference[2] == 0.0


def test_moment_is_arm_times_force_summed_over_muscles(parameters, recording, states):
    moment = np.zeros((2, 2, FRAMES))
    for row in range(len(MUSCLES)):
        for coordinate in range(2):
            arm = np.asarray(recording.path.nominal.moment_arm)[row, :, coordinate]
            moment[:, coordinate] += arm * np.asarray(states.fiber.tendon_force)[row]
    found = moments_of_all(CURVES, parameters, recording)
    np.testing.assert_allclose(found, moment, rtol=1e-12, atol=1e-10)


def test_cycles_in_another_order_give_the_same_in_that_order(parameters, recording, states):
    swapped = run_all(CURVES, parameters, trials(recording, [1, 0]))
    assert_trees_close(swapped, jax.tree.map(lambda leaf: leaf[:, ::-1], states))


def test_a_cycle_is_not_influenced_by_others(parameters, recording, states):
    for trial in range(2):
        alone = run_all(CURVES, parameters, trials(recording, [trial]))
        assert_trees_close(alone, jax.tree.map(lambda leaf, row=trial: leaf[:, [row]], states))


def test_vmap_over_cycles_equals_the_batch(parameters, recording, states):
    """The model of a cycle does not depend on the batch."""

    def one_cycle(emg: EmgSpline, path: PathState):
        emg, path = jax.tree.map(lambda leaf: leaf[:, None], (emg, path))
        single = Recording(emg, fixed_path(path), PADDING)
        return jax.tree.map(lambda leaf: leaf[:, 0], muscle_states(CURVES, parameters, single))

    mapped = jax.jit(jax.vmap(one_cycle, in_axes=1, out_axes=1))(recording.emg, recording.path.nominal)
    assert_trees_close(mapped, states)


def test_vmap_over_parameters_equals_a_loop(parameters, recording):
    """Several parameter trees at once."""
    several = jax.tree.map(lambda leaf: jnp.stack([leaf, 1.02 * leaf, 0.98 * leaf]), parameters)
    mapped = eqx.filter_jit(eqx.filter_vmap(joint_moments, in_axes=(None, 0, None)))(
        CURVES, several, recording
    )
    for row in range(3):
        alone = moments_of_all(CURVES, muscle(several, row), recording)
        np.testing.assert_allclose(mapped[row], alone, rtol=1e-11, atol=1e-10)


def test_chosen_frames_have_the_states_of_all_frames(parameters, recording, states):
    """Activation has its history where single frames alone are evaluated."""
    frames = np.array([0, 2, 5, FRAMES - 1])
    chosen = run_all(CURVES, parameters, recording.at_frames(frames))
    assert_trees_close(chosen, jax.tree.map(lambda leaf: leaf[..., frames], states))


def test_padding_is_trimmed_after_the_dynamics(parameters, recording, states):
    """The activation in the first frame of a cycle depends on the EMG before it."""
    before = np.arange(FRAMES + 2 * PADDING - 1) < PADDING
    silent = jnp.where(before, 0.0, np.asarray(recording.emg.coefficients))
    rested = eqx.tree_at(lambda tree: tree.emg.coefficients, recording, silent)
    without = run_all(CURVES, parameters, rested)
    assert (np.asarray(states.activation - without.activation)[:, :, 0] > 0.01).all()


def test_scale_and_delay_act_on_excitation(parameters, recording, states):
    """Half the scale gives half the excitation; a delay of one knot shifts it by a frame."""
    half = eqx.tree_at(lambda tree: tree.emg_scale, parameters, 0.5 * parameters.emg_scale)
    excitation = run_all(CURVES, half, recording).excitation
    np.testing.assert_allclose(excitation, 0.5 * states.excitation, rtol=1e-13)
    first = trials(recording, [0])
    knot = first.emg.step[:, 0]
    undelayed, delayed = (
        run_all(
            CURVES, eqx.tree_at(lambda tree: tree.electromechanical_delay, parameters, count * knot), first
        ).excitation
        for count in (0.0, 1.0)
    )
    np.testing.assert_allclose(delayed[..., 1:], undelayed[..., :-1], rtol=0, atol=1e-13)


# ---- Freedoms


def test_every_parameter_has_a_unit_and_a_meaning():
    singles = {field.name for field in dataclasses.fields(ModelParameters)}
    singles -= {"path_changes", "synergy_weights", "law"}
    assert set(QUANTITIES) == singles
    assert all(quantity.unit and quantity.meaning for quantity in QUANTITIES.values())


def bounds(freedom: Freedom) -> dict[str, tuple[list[float], list[float]]]:
    return {entry.name: (entry.lower.tolist(), entry.upper.tolist()) for entry in freedom.parameters}


def test_bounds_of_nga_are_as_documented():
    found = bounds(nga_freedom(small_parameters()))
    assert list(found) == [
        "electromechanical_delay",
        "activation_time_constant",
        "activation_nonlinearity",
        "emg_scale",
        "optimal_fiber_length",
        "tendon_slack_length",
    ]
    assert found["electromechanical_delay"] == ([0.0] * 3, [0.125] * 3)
    assert found["activation_time_constant"] == ([0.0075] * 3, [0.035] * 3)
    assert found["activation_nonlinearity"] == ([0.0] * 3, [0.35] * 3)
    assert found["emg_scale"] == ([0.05] * 3, [1.0] * 3)
    for name in ("optimal_fiber_length", "tendon_slack_length"):
        own = np.asarray(getattr(small_parameters(), name))
        np.testing.assert_allclose(found[name], [0.6 * own, 1.4 * own], rtol=1e-14)


def test_bounds_do_not_follow_the_parameters():
    """Two successive calibrations, each changing lengths by 40 %, must not add up to 96 %."""
    reference = small_parameters()
    freedom = nga_freedom(reference)
    moved = eqx.tree_at(
        lambda tree: tree.optimal_fiber_length, reference, 1.4 * reference.optimal_fiber_length
    )
    first, second = (free_variables(base, freedom, MUSCLES) for base in (reference, moved))
    np.testing.assert_array_equal(first.lower, second.lower)
    np.testing.assert_array_equal(first.upper, second.upper)
    np.testing.assert_array_equal(first.prior_mean, second.prior_mean)
    # The start is on its bound, and the same variable has the same length in both.
    length = second.unpack(jnp.asarray(second.upper)).optimal_fiber_length
    np.testing.assert_allclose(length, 1.4 * reference.optimal_fiber_length, rtol=1e-14)
    np.testing.assert_allclose(second.unpack(second.start()).optimal_fiber_length, length, rtol=1e-14)


def test_bounds_depend_on_lengths_of_the_reference_alone():
    reference = small_parameters()
    others = ("electromechanical_delay", "activation_time_constant", "emg_scale", "activation_nonlinearity")
    changed = eqx.tree_at(
        lambda tree: [getattr(tree, name) for name in others], reference, replace=[0.3 * jnp.ones(3)] * 4
    )
    assert bounds(nga_freedom(changed)) == bounds(nga_freedom(reference))


def test_start_outside_its_bounds_is_clipped():
    reference = small_parameters()
    outside = eqx.tree_at(
        lambda tree: [tree.emg_scale, tree.electromechanical_delay],
        reference,
        replace=[jnp.array([5.0, 0.5, -1.0]), jnp.array([0.3, 0.05, 0.05])],
    )
    variables = free_variables(outside, nga_freedom(reference), MUSCLES)
    started = variables.unpack(variables.start())
    np.testing.assert_allclose(started.emg_scale, [1.0, 0.5, 0.05], rtol=1e-14)
    np.testing.assert_allclose(started.electromechanical_delay, [0.125, 0.05, 0.05], rtol=1e-14)


def test_parameters_that_are_held_keep_their_values():
    base = small_parameters()
    variables = free_variables(base, nga_freedom(base).without(["tendon_slack_length"]), MUSCLES)
    assert variables.count == 15 and not any("slack" in label for label in variables.labels)
    moved = variables.unpack(jnp.asarray(variables.upper))
    for name in ("tendon_slack_length", "max_isometric_force", "pennation_angle", "max_fiber_velocity"):
        np.testing.assert_array_equal(getattr(moved, name), getattr(base, name))
    assert (moved.emg_scale == 1.0).all()


def freed(name: str = "emg_scale", lower: float = 0.0, upper: float = 1.0) -> FreedParameter:
    ones = np.ones(3)
    return FreedParameter(name, lower * ones, upper * ones, ones, 0.5 * ones, ones)


def test_unknown_parameter_is_refused():
    with pytest.raises(ValueError, match=r"'emg_scales' is no model parameter; there are .*emg_scale"):
        freed("emg_scales")


def test_bounds_in_the_wrong_order_are_refused():
    with pytest.raises(ValueError, match="emg_scale: a lower bound is above its upper bound"):
        freed(lower=1.0, upper=0.0)


def test_infinite_deviation_means_no_prior():
    base = small_parameters()
    variables = free_variables(base, nga_freedom(base, delay_sd=np.inf), MUSCLES)
    free = np.array([label.endswith("delay") for label in variables.labels])
    assert (variables.prior_precision[free] == 0.0).all() and (variables.prior_precision[~free] > 0.0).all()


def test_prior_is_in_the_units_of_the_solver():
    """A parameter one deviation from its mean has a precision-weighted difference of one."""
    base = small_parameters()
    variables = free_variables(base, nga_freedom(base), MUSCLES)
    late = eqx.tree_at(lambda tree: tree.electromechanical_delay, base, 0.1 * jnp.ones(3))  # 50 +- 50 ms
    distance = (variables.pack(late) - variables.prior_mean) * variables.prior_precision
    delays = np.array([label.endswith("delay") for label in variables.labels])
    np.testing.assert_allclose(distance[delays], 1.0, rtol=1e-13)
