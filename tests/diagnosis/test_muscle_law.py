"""The muscle law of the person: recovered from moments, held by its prior, free in the score test."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.subject import CURVES, small_recording_and_context
from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.fits.muscle_law import fit_muscle_law
from wrapjax.diagnosis.inputs.priors import PUBLISHED_SPREAD, with_published_priors
from wrapjax.model.forward import joint_moments
from wrapjax.model.freedom import nga_freedom
from wrapjax.model.variables import LAW_OWNER, free_variables
from wrapjax.muscle.personal_law import LAW_NAMES, LAW_PARAMETERS, given_law

#: Law of the simulated person: slower deactivation, more eccentric force, stiffer passive fibers.
TRUE = {"deactivation_ratio": 0.5, "lengthening_plateau": 0.4, "passive_force": 0.6}


@pytest.fixture(scope="module")
def leg():
    recording, context = small_recording_and_context()
    base = context.parameters
    freedom = nga_freedom(base)
    law = given_law(len(context.muscles))
    for name, value in TRUE.items():
        law[:, LAW_NAMES.index(name)] = value
    measured = joint_moments(CURVES, replace(base, law=jnp.asarray(law)), recording)
    problem = Objective(
        curves=CURVES,
        recording=recording,
        measured=measured,
        variables=free_variables(base, freedom, context.muscles),
        penalties=(),
        limits=(),
        moment_error=np.array(0.01),
    )
    return problem, base, freedom, context


@pytest.fixture(scope="module")
def fitted(leg):
    problem, base, freedom, context = leg
    return fit_muscle_law(problem, base, freedom, context.muscles)


def test_the_fit_explains_moments_of_another_law(leg, fitted):
    problem, given, _, _ = leg

    def error(parameters):
        return float(np.sqrt(np.sum(np.asarray(problem.terms(parameters)["joint_moment"]) ** 2)))

    assert error(fitted.held.parameters(jnp.asarray(fitted.variables))) < 0.1 * error(given)
    assert fitted.law["deactivation_ratio"] > 0.1
    assert set(fitted.law) == set(LAW_NAMES)


def test_the_held_law_predicts_what_the_free_one_does(fitted):
    free = fitted.free.parameters(jnp.asarray(fitted.with_free_law(fitted.variables)))
    held = fitted.held.parameters(jnp.asarray(fitted.variables))
    np.testing.assert_allclose(free.law, held.law, atol=1e-12)
    np.testing.assert_allclose(free.emg_scale, held.emg_scale, atol=1e-12)
    labels = fitted.free.variables.labels
    assert labels[: len(fitted.variables)] == fitted.held.variables.labels
    assert labels[len(fitted.variables) :] == tuple(f"{LAW_OWNER}.{name}" for name in LAW_NAMES)


def test_derivatives_by_the_shared_law_agree_with_differences(fitted):
    problem, at = fitted.free, fitted.with_free_law(fitted.variables)
    expansion, jacobian = problem.expand(jnp.asarray(at))
    first, h = len(fitted.variables), 1e-6
    errors = jax.jit(lambda x: problem.terms(problem.parameters(x))["joint_moment"])
    value = jax.jit(lambda x: problem.value(x))
    for place in range(first, len(at)):
        step = np.zeros(len(at))
        step[place] = h
        high, low = (np.asarray(errors(at + sign * step)) for sign in (1.0, -1.0))
        difference = (high - low) / (2.0 * h)
        np.testing.assert_allclose(jacobian[:, place], difference, atol=1e-5 * np.abs(jacobian).max())
        slope = (value(at + step) - value(at - step)) / (2.0 * h)
        assert 2.0 * expansion.gradient[place] == pytest.approx(float(slope), rel=1e-3, abs=1e-4)


def test_priors_are_the_published_spread(leg):
    _, base, freedom, _ = leg
    priors = {one.name: one for one in with_published_priors(freedom).parameters}
    np.testing.assert_allclose(priors["optimal_fiber_length"].prior_sd, 0.15 * base.optimal_fiber_length)
    np.testing.assert_allclose(priors["tendon_slack_length"].prior_sd, 0.04 * base.tendon_slack_length)
    np.testing.assert_allclose(priors["electromechanical_delay"].prior_sd, 0.025)
    usual = {one.name: one.prior_sd for one in freedom.parameters}
    assert all((priors[name].prior_sd <= usual[name]).all() for name in usual)
    assert all(one.source for one in PUBLISHED_SPREAD.values())
    assert all(one.source and one.lower <= 0.0 <= one.upper for one in LAW_PARAMETERS)
