"""Calibration recovers true parameters where moments determine them, and reports where they do not.

Data of the model's own form, without noise: a unit test of the solver, not an accuracy.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import wrapjax
from wrapjax.calibration.problem import build_objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.calibration.uncertainty.identifiability import laplace_deviation
from wrapjax.datasets.virtual_person.true_parameters import parameter_names
from wrapjax.datasets.virtual_person.virtual_subject import write_virtual_subject
from wrapjax.model.forward import joint_moments

#: Moment noise at which a parameter counts as identifiable if its standard deviation is below 1 %.
NOISE = 0.03


@pytest.fixture(scope="module")
def recovered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("virtual") / "subject"
    truth = write_virtual_subject(folder, seed=0, emg_noise=0.0, moment_noise=0.0)
    recorded = build_objective(wrapjax.load_subject(folder))
    base = recorded.variables.base
    values = {name: jnp.asarray(getattr(truth, name)) for name in parameter_names()}
    true = dataclasses.replace(base, **values)
    moments = eqx.filter_jit(joint_moments)(recorded.curves, true, recorded.recording)
    # Weak penalties from the start lead to a poor local minimum; they are weakened in steps.
    variables = recorded.variables.start()
    for moment_error in (2.5, 0.5, 0.1, 0.02, 0.005, 0.0025):
        problem = dataclasses.replace(recorded, measured=moments, moment_error=np.array(moment_error))
        solution = ProjectedLevenbergMarquardt().solve(problem, variables)
        assert solution.status.converged
        variables = jnp.asarray(solution.variables)
    found = problem.variables.unpack(variables)
    names = problem.variables.names
    return {
        "recorded": recorded.measured,
        "moments": moments,
        "modelled": eqx.filter_jit(joint_moments)(problem.curves, found, problem.recording),
        "names": names,
        "true": np.stack([np.asarray(getattr(true, name)) for name in names], axis=-1),
        "found": np.stack([np.asarray(getattr(found, name)) for name in names], axis=-1),
        "deviation": laplace_deviation(problem, variables, NOISE),
    }


def test_recorded_moments_are_those_of_the_true_parameters(recovered):
    """The folder has moments over paths of OpenSim, from which the surrogate deviates slightly."""
    error = np.abs(recovered["recorded"] - recovered["moments"])
    assert error.mean() < 0.02 and error.max() < 0.3


def test_moments_are_matched(recovered):
    assert np.abs(recovered["modelled"] - recovered["moments"]).max() < 0.01


def test_identifiable_parameters_are_recovered(recovered):
    true, found = recovered["true"], recovered["found"]
    identifiable = recovered["deviation"] < 0.01 * np.abs(true)
    assert identifiable.sum() >= 30
    assert (np.abs(found - true)[identifiable] <= 0.01 * np.abs(true)[identifiable]).all()


def test_parameters_that_are_not_identifiable_are_reported(recovered):
    """Moments do not determine the nonlinearity and time constant of weak or inactive muscles."""
    error = np.abs(recovered["found"] - recovered["true"])
    far = error > 0.05 * np.abs(recovered["true"])
    assert far.any()
    assert (recovered["deviation"][far] > 0.01 * np.abs(recovered["true"][far])).all()
