"""Moments find hidden cylinders where they can tell a moment arm from a muscle's gain.

Data of the model's own form, without noise: a unit test of PGA, not an accuracy. A moment arm about a
coordinate counts as told apart if moment noise of `NOISE` would leave it, by Laplace with everything
else that is free, a standard deviation below a tenth of how far the nominal arm is from the true one.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.api.exact import exact_geometry
from wrapjax.api.preparation import method_freedom, prepare
from wrapjax.api.wrap_recovery import told_apart, true_moment_arms
from wrapjax.calibrate import ProjectedLM, moment_arm_deviation
from wrapjax.subject import read_subject
from wrapjax.virtual import Series, read_truth, write_virtual_subject
from wrapjax.virtual.truth import parameter_names

#: N m; about what remains of the moments' error where everything is true but the engine's last digits.
NOISE = 0.003
#: With penalties weak from the start the nearest minimum is a poor one: they are weakened in steps.
MOMENT_ERRORS = (2.5, 0.5, 0.1, 0.02, 0.005)


def errors_of_arms(folder, cycles, seed, known=()):
    """Calibrate a virtual subject; give arms' errors before and after, and their deviation (m).

    All lead with ``muscle coordinate``, for muscles that touch a cylinder. Parameters that are ``known``
    are held at the truth.
    """
    series = (Series(0.8, cycles, 0), Series(1.2, cycles, 0))
    write_virtual_subject(folder, seed=seed, emg_noise=0.0, moment_noise=0.0, series=series, wrap_spread=0.6)
    subject, truth = read_subject(folder), read_truth(folder)
    geometry = exact_geometry(subject)
    freedom = method_freedom("PGA", subject, geometry).without(known)
    problem = prepare(subject, "PGA", geometry, freedom)
    values = {name: jnp.asarray(getattr(truth, name)) for name in known}
    base = dataclasses.replace(problem.variables.base, **values)
    problem = dataclasses.replace(problem, variables=dataclasses.replace(problem.variables, base=base))
    variables = problem.variables.start()
    for moment_error in MOMENT_ERRORS:
        step = dataclasses.replace(problem, moment_error=np.array(moment_error))
        variables = jnp.asarray(ProjectedLM().solve(step, variables).variables)
    moving = freedom.moving_paths
    changes = problem.variables.unpack(variables).path_changes
    true = true_moment_arms(subject, truth)
    before, after = (
        np.abs(np.asarray(path.moment_arm) - true)[moving].mean(axis=(1, 3))
        for path in (problem.recording.path.nominal, problem.recording.path.at(changes))
    )
    return before, after, moment_arm_deviation(problem, variables, NOISE)[moving].mean(axis=(1, 3))


def test_cylinders_are_found_beside_gains(tmp_path):
    """EMG scales and all cylinders are free, the rest is known."""
    known = [name for name in parameter_names() if name != "emg_scale"]
    before, after, deviation = errors_of_arms(tmp_path / "subject", 1, 3, known)
    told = told_apart(before, deviation)
    assert told.sum() >= 10
    assert after[told].mean() < 0.4 * before[told].mean()


@pytest.mark.slow
def test_cylinders_are_found_beside_everything(tmp_path):
    """Twenty people: everything of the muscles is free, too."""
    falls = []
    for seed in range(20):
        before, after, deviation = errors_of_arms(tmp_path / str(seed), 3, seed)
        told = told_apart(before, deviation)
        assert told.any(), f"subject {seed}"
        falls.append(1.0 - after[told].mean() / before[told].mean())
    print("fall of moment-arm errors, by subject:", np.round(falls, 2))
    assert min(falls) >= 0.6
