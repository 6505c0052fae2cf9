"""A synthetic leg whose moments were computed with two effects, for joint fits."""

import jax.numpy as jnp
import numpy as np

from tests.diagnosis.subject import CURVES, small_recording_and_context
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.model.freedom import nga_freedom
from wrapjax.model.variables import free_variables

#: Two effects of different kind: one adds moments, the other alters the activation of each muscle.
TOGETHER = ("joint_damping", "emg_nonlinearity")
#: Weight of a squared prior standard deviation in the cost: negligible.
WEIGHT = 1e-9
#: Solver with tight tolerances, for data without noise.
FINE = ProjectedLevenbergMarquardt(gtol=1e-8, ftol=1e-12, max_iterations=200)


def effects_of(context, ids=TOGETHER) -> Effects:
    return Effects(tuple(CATALOGUE[id].build(context) for id in ids))


def damped_leg():
    """Make a calibration, its effects, and the variables and effect sizes of its moments.

    Calibrated parameters are at their prior means, so that only the effects change the cost.
    """
    recording, context = small_recording_and_context()
    effects = effects_of(context)
    base = context.parameters
    variables = free_variables(base, nga_freedom(base), context.muscles)
    known = np.asarray(variables.prior_precision) > 0.0
    true_variables = np.where(known, variables.prior_mean, variables.start())
    effect_sizes = np.resize([1.5, 0.8, 0.5, 0.6], effects.count) * effects.prior_sd
    measured = predicted_moments(
        CURVES, variables.unpack(jnp.asarray(true_variables)), recording, effects, jnp.asarray(effect_sizes)
    )
    problem = Objective(
        curves=CURVES,
        recording=recording,
        measured=jnp.asarray(np.asarray(measured)),
        variables=variables,
        penalties=(),
        limits=(),
    )
    return problem, effects, true_variables, effect_sizes
