"""Derivatives of a calibration with effects at fixed sizes, by blocks of muscles."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.diagnosis.subject import CURVES, small_recording_and_context
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.penalties import pipeline_penalties
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.model.forward import muscle_states
from wrapjax.model.freedom import nga_freedom
from wrapjax.model.variables import free_variables

#: All kinds of effects that couple muscles, and two that act on single muscles.
TOGETHER = ("force_sharing", "passive_joint_moment", "speed_dependent_delay", "emg_crosstalk")
TOGETHER += ("activation_dependent_fiber_length", "emg_nonlinearity")


def with_effects(*ids: str) -> Objective:
    recording, context = small_recording_and_context()
    effects = Effects(tuple(CATALOGUE[id].build(context) for id in ids))
    base = context.parameters
    states = eqx.filter_jit(muscle_states)(CURVES, base, recording)
    return Objective(
        curves=CURVES,
        recording=recording,
        measured=0.8 * states.moment.sum(axis=0),
        variables=free_variables(base, nga_freedom(base), context.muscles),
        penalties=pipeline_penalties(states, [[1, 2]], [[0, 1, 2]]),
        limits=(),
        alterations=effects.alterations(jnp.asarray(0.4 * effects.prior_sd)),
    )


def test_blocks_of_muscles_give_the_jacobian_of_moments():
    """In one direction of all variables, against finite differences of the moments."""
    problem = with_effects(*TOGETHER)
    variables = problem.variables.start() * 1.07
    jacobian = eqx.filter_jit(lambda problem, x: problem.moment_jacobian(x))(problem, variables)
    moments = eqx.filter_jit(lambda problem, x: problem.terms(problem.parameters(x))["joint_moment"])
    direction = jnp.asarray(np.random.default_rng(0).normal(size=variables.size))
    above, below = (moments(problem, variables + step * direction) for step in (1e-6, -1e-6))
    slope = jacobian @ direction
    np.testing.assert_allclose(slope, (above - below) / 2e-6, rtol=0, atol=1e-6 * np.abs(slope).max())


@pytest.mark.slow
def test_blocks_of_muscles_give_gradient_and_hessian():
    """Against finite differences of the cost, which uses no blocks; with compliant tendons as well."""
    problem = with_effects(*TOGETHER, "tendon_compliance")
    variables = problem.variables.start() * 1.07
    direction = jnp.asarray(np.random.default_rng(0).normal(size=variables.size))
    step = 1e-6
    found = problem.linearized_at(variables)
    ends = [variables + sign * step * direction for sign in (1.0, -1.0)]
    np.testing.assert_allclose(found.cost, problem.value_at(variables), rtol=1e-12)
    rise = (problem.value_at(ends[0]) - problem.value_at(ends[1])) / (2 * step)
    np.testing.assert_allclose(2.0 * found.gradient @ direction, rise, rtol=1e-6)
    above, below = (problem.linearized_at(end).gradient for end in ends)
    product = (found.gauss_newton + found.remainder) @ direction
    scale = np.abs(product).max()
    np.testing.assert_allclose(product, (above - below) / (2 * step), rtol=0, atol=1e-6 * scale)


def test_free_paths_cannot_be_altered():
    """Force sharing makes one muscle's force depend on another's path, so that blocks would be wrong."""
    problem = with_effects("force_sharing")
    moving = dataclasses.replace(problem.variables, modes=1)
    with pytest.raises(ValueError, match="held paths"):
        dataclasses.replace(problem, variables=moving)
