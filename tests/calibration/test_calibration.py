"""Python interface of ``calibrate`` and ``objective``, and inputs of the model."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.calibration.calibration import calibrate
from wrapjax.calibration.problem import build_objective, objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.errors import InputError
from wrapjax.model.freedom import nga_freedom
from wrapjax.path_sources.model_inputs import group_indices, model_parameters, recording, surrogate_paths
from wrapjax.path_sources.path_fitting import fit


@pytest.fixture(scope="session")
def cost(person, paths):
    return objective(person, "NGA", paths)


@pytest.fixture(scope="session")
def start(person):
    return model_parameters(person)


def test_objective_is_the_minimised_cost(cost, start, calibrated):
    result = calibrated.result
    assert float(cost(result.parameters)) == pytest.approx(result.solution.cost, rel=1e-12)
    assert sum(result.cost_by_term.values()) == pytest.approx(result.solution.cost, rel=1e-12)
    assert float(cost(start)) == pytest.approx(result.solution.history[0].cost, rel=1e-12)
    assert result.solution.cost < float(cost(start))


def test_gradient_of_the_objective_equals_finite_differences(cost, start):
    leaves, structure = jax.tree.flatten(start)
    keys = jax.random.split(jax.random.key(3), len(leaves))
    direction = structure.unflatten(
        leaf * jax.random.normal(key, leaf.shape) for leaf, key in zip(leaves, keys, strict=True)
    )
    gradient = jax.grad(cost)(start)
    slope = sum(jnp.vdot(*pair) for pair in zip(*map(jax.tree.leaves, (gradient, direction)), strict=True))
    step = 1e-5
    sides = [
        cost(jax.tree.map(lambda leaf, along, sign=sign: leaf + sign * step * along, start, direction))
        for sign in (1.0, -1.0)
    ]
    assert float(slope) == pytest.approx(float((sides[0] - sides[1]) / (2 * step)), rel=1e-6)


def test_objective_can_be_mapped_over_parameter_trees(cost, start):
    several = jax.tree.map(lambda leaf: jnp.stack([leaf, 1.01 * leaf]), start)
    both = jax.jit(jax.vmap(cost))(several)
    one_by_one = [cost(jax.tree.map(lambda leaf, row=row: leaf[row], several)) for row in range(2)]
    np.testing.assert_allclose(both, one_by_one, rtol=1e-12)


def test_result_is_consistent(calibrated, person):
    result, trials = calibrated.result, person.trials
    assert calibrated.status.converged and calibrated.subject is person
    assert result.trials == trials.names and result.uses == trials.uses
    np.testing.assert_array_equal(result.measured, trials.moments)
    # Validation cycles are modelled as well; two of three cycles were matched.
    assert result.modelled.shape == (3, 2, 101) and result.n_residuals == 2 * 2 * 101
    np.testing.assert_allclose(result.modelled, np.sum(result.states.moment, axis=0), rtol=1e-12)
    np.testing.assert_allclose(result.initial_modelled, np.sum(result.initial_states.moment, axis=0))
    freed = {parameter.name: parameter for parameter in result.freedom.parameters}
    stuck = set()
    for name, parameter in freed.items():
        values = np.asarray(getattr(result.parameters, name))
        assert (values >= parameter.lower * (1 - 1e-14)).all()
        assert (values <= parameter.upper * (1 + 1e-14)).all()
        for muscle, *row in zip(result.muscles, values, parameter.lower, parameter.upper, strict=True):
            if any(np.isclose(row[0], bound, rtol=1e-14, atol=0.0) for bound in row[1:]):
                stuck.add(f"{muscle}.{name}")
    assert stuck == set(result.at_bounds)
    for name in set(vars(result.parameters)) - set(freed):
        np.testing.assert_array_equal(getattr(result.parameters, name), getattr(result.initial, name))


def test_results_are_immutable(calibrated):
    with pytest.raises(dataclasses.FrozenInstanceError):
        calibrated.result = None
    with pytest.raises(dataclasses.FrozenInstanceError):
        calibrated.result.method = "PGA"


def test_validation_cycles_do_not_affect_the_calibration(person, paths, calibrated):
    """Changed moments of validation cycles give the same calibration."""
    wild = np.where(np.array(person.trials.uses)[:, None, None] == "validation", 1e3, person.trials.moments)
    other = dataclasses.replace(person, trials=dataclasses.replace(person.trials, moments=wild))
    again = calibrate(other, "NGA", paths, starts=1)
    np.testing.assert_array_equal(again.result.solution.variables, calibrated.result.solution.variables)


def test_custom_freedom(person, paths, start):
    freedom = nga_freedom(start).without(["emg_scale", "tendon_slack_length"])
    variables = build_objective(person, "NGA", paths, freedom).variables
    assert variables.count == 8
    moved = variables.unpack(jnp.asarray(variables.upper))
    for name in ("emg_scale", "tendon_slack_length"):
        np.testing.assert_array_equal(getattr(moved, name), getattr(start, name))


def test_callback_is_called_every_iteration(person, paths):
    seen = []
    solver = AugmentedLagrangian(ProjectedLevenbergMarquardt(max_iterations=2))
    result = calibrate(
        person,
        "NGA",
        paths,
        solver=solver,
        starts=2,
        callback=lambda start, iteration, state: seen.append((start, iteration)),
    ).result
    for start, outcome in enumerate(result.outcomes):
        assert tuple(one for number, one in seen if number == start) == outcome.solution.history
        assert [one.number for one in outcome.solution.history] == [0, 1, 2]


def test_missing_calibration_trials_are_refused(person, paths):
    """Reading refuses such a folder, but a script can select no trial."""
    other = dataclasses.replace(person, trials=person.trials.used_for("validation"))
    with pytest.raises(InputError, match='no trial is marked use = "calibration"'):
        build_objective(other, "NGA", paths)


def test_unknown_method(person, paths):
    with pytest.raises(ValueError, match=re.escape("unknown method 'XGA': expected one of NGA")):
        calibrate(person, "XGA", paths)


@pytest.mark.parametrize("call", [calibrate, build_objective])
def test_unknown_curves(person, paths, call):
    with pytest.raises(ValueError, match=r"there are no curves 'papier'; there are paper, opensim"):
        call(person, "NGA", paths, curves="papier")


@pytest.mark.parametrize("call", [fit, calibrate, objective])
def test_single_precision_is_refused(person, call):
    with jax.enable_x64(False), pytest.raises(RuntimeError, match=r"64 bits.*set_up_jax"):
        call(person)


# ---- Inputs of the model


def test_paths_are_in_the_order_of_the_subject(person, paths):
    """The fit may have another order of muscles and coordinates."""
    usual = surrogate_paths(paths.surrogate, person, person.trials)
    turned = dataclasses.replace(
        person,
        muscles=type(person.muscles)(
            **{
                name: value[::-1] if name == "names" else np.asarray(value)[::-1]
                for name, value in vars(person.muscles).items()
            }
        ),
        trials=dataclasses.replace(person.trials, moment_coordinates=person.trials.moment_coordinates[::-1]),
    )
    other = surrogate_paths(paths.surrogate, turned, turned.trials)
    np.testing.assert_array_equal(other.nominal.length, usual.nominal.length[::-1])
    np.testing.assert_array_equal(other.nominal.velocity, usual.nominal.velocity[::-1])
    np.testing.assert_array_equal(other.nominal.moment_arm, usual.nominal.moment_arm[::-1, :, ::-1])


def test_moment_arms_are_zero_about_coordinates_that_no_muscle_spans(person, paths):
    trials = dataclasses.replace(
        person.trials,
        coordinates=(*person.trials.coordinates, "subtalar_angle_l"),
        moment_coordinates=("subtalar_angle_l", "knee_angle_l"),
        angles=np.concatenate([person.trials.angles, np.ones((3, 1, 101))], axis=1),
        angular_velocities=np.concatenate([person.trials.angular_velocities, np.ones((3, 1, 101))], axis=1),
    )
    usual = surrogate_paths(paths.surrogate, person, person.trials)
    other = surrogate_paths(paths.surrogate, person, trials)
    assert (other.nominal.moment_arm[:, :, 0] == 0.0).all()
    np.testing.assert_array_equal(other.nominal.moment_arm[:, :, 1], usual.nominal.moment_arm[:, :, 1])


def test_every_muscle_has_the_envelope_of_its_channel(person, paths):
    path = surrogate_paths(paths.surrogate, person, person.trials)
    crossed = dataclasses.replace(person, muscle_channels=(1, 0))
    usual, other = (recording(one, person.trials, path) for one in (person, crossed))
    trials = person.trials
    for row, channel in enumerate(person.muscle_channels):
        found = usual.emg.coefficients[row, :, -1]  # the value at each knot but the last
        np.testing.assert_allclose(found, trials.emg[:, channel, :-1], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(other.emg.coefficients, usual.emg.coefficients[::-1])
    assert usual.padding == trials.padding > 0


def test_groups_are_converted_to_indices():
    assert group_indices((("b", "c"), ("a", "c")), ("a", "b", "c")) == ((1, 2), (0, 2))
    assert group_indices((), ("a",)) == ()
