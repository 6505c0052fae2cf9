"""Penalties and limits on muscle paths that a calibration may change.

After Meyer et al. 2017 (doi:10.1371/journal.pone.0179698): lengths and moment arms stay near the
nominal ones in mean and in shape, measured against how far they range over the recorded cycles; moment
arms that keep their sign in the nominal model keep it; fibers stay in their working range.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.penalties import Limit, MusclePenalty, normalized_length, whole
from wrapjax.geometry.paths import PathState
from wrapjax.model.forward import MuscleState
from wrapjax.model.parameters import ModelParameters

#: Working range of normalised fiber length (the NMSM Pipeline's).
FIBER_LENGTH_RANGE = (0.3, 1.3)
_PROXIMITY_NAME = "proximity"
#: Names of penalties that paths are asked about, and that mean nothing where these are held.
PATH_PENALTIES = (_PROXIMITY_NAME,)
#: Allowable closeness to a jump in length, root mean square over muscles and frames.
PROXIMITY = 2.0
# Moment arms are limited in units of this (m), to be of the order of fiber lengths.
_ARM_UNIT = 0.01
# At first the excess of one unit costs this; the solver raises it as it needs.
_FIRST_WEIGHT = 100.0
#: How far cylinders stay within what was learned to be physiological: a score of one is the margin between
#: the classes. A calibration looks for the places where what was learned is wrong.
FEASIBILITY_MARGIN = 0.5
# A score of one is the width of the margin between the classes: far, where a fiber length of one is not.
_FIRST_SCORE_WEIGHT = 1.0


def path_limits(nominal: PathState) -> tuple[Limit, ...]:
    """Build the hard limits on free polynomials: fibers in working range, moment arms of the same sign.

    A moment arm that crosses zero in the nominal model, or that a muscle does not have, is exempt.

    Parameters
    ----------
    nominal
        Paths of all muscles over the calibration cycles.
    """
    muscles, trials, frames = nominal.length.shape
    arms = np.asarray(nominal.moment_arm)
    positive, negative = (arms > 0.0).all(axis=(1, 3)), (arms < 0.0).all(axis=(1, 3))
    sign = np.broadcast_to((positive.astype(float) - negative)[:, None, :, None], arms.shape)
    kept = jnp.asarray(sign.reshape(muscles, -1))
    shortest, longest = FIBER_LENGTH_RANGE
    each, no_shift = jnp.ones((muscles, 1)), jnp.zeros((muscles, trials * frames))
    weight = jnp.full(no_shift.shape, _FIRST_WEIGHT)
    return (
        Limit("longest_fiber", normalized_length, whole, each, longest * each, no_shift, weight),
        Limit("shortest_fiber", normalized_length, whole, -each, -shortest * each, no_shift, weight),
        Limit(
            "moment_arm_sign",
            _moment_arm,
            whole,
            -kept / _ARM_UNIT,
            jnp.where(kept == 0.0, 1.0, 0.0),
            jnp.zeros(kept.shape),
            jnp.full(kept.shape, _FIRST_WEIGHT),
        ),
    )


def feasibility_limits(nominal: PathState) -> tuple[Limit, ...]:
    """Hold cylinders well within where their paths are physiological, or to as near to it as nominal ones.

    There are none for paths that have not learned where that is.

    Parameters
    ----------
    nominal
        Paths of all muscles over the calibration cycles.
    """
    if nominal.infeasibility is None:
        return ()
    most = jnp.maximum(nominal.infeasibility, -FEASIBILITY_MARGIN)
    none, first = jnp.zeros(most.shape), jnp.full(most.shape, _FIRST_SCORE_WEIGHT)
    each = jnp.ones((most.shape[0], 1))
    return (Limit("infeasibility", _infeasibility, whole, each, most, none, first),)


def _infeasibility(parameters: ModelParameters, state: MuscleState) -> Float[Array, " wrap"]:
    assert state.path.infeasibility is not None
    return state.path.infeasibility


def proximity_penalty(muscles: int) -> MusclePenalty:
    """Keep paths round cylinders from where their length would jump.

    Closeness grows without bound there, so that no path ever gets over. It is seen from afar, unlike a
    limit: the solver need not run into each of many walls to learn of it. Fibers and signs of moment
    arms have no hard limits here: cylinders of possible place and size keep paths physiological, and
    fiber lengths are held as in NGA.
    """
    return MusclePenalty(_PROXIMITY_NAME, _proximity, whole, jnp.zeros((muscles, 1)), PROXIMITY)


def _proximity(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial frame"]:
    assert state.path.proximity is not None
    return state.path.proximity


def _moment_arm(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial coordinate frame"]:
    return state.path.moment_arm
