"""Hard limits and the proximity penalty on muscle paths that a calibration changes.

Free polynomials have limits after Meyer et al. 2017 (doi:10.1371/journal.pone.0179698): moment arms keep the
sign that they have in the nominal model, and normalised fiber lengths stay in their working range. Free wraps
are limited to feasible wrap parameters, and a penalty keeps paths from discontinuities of their length.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.penalties import Limit, MusclePenalty, flatten, normalized_length
from wrapjax.geometry.paths import PathState
from wrapjax.model.forward import MuscleState
from wrapjax.model.parameters import ModelParameters

#: Working range of normalised fiber length (the NMSM Pipeline's).
FIBER_LENGTH_RANGE = (0.3, 1.3)
_PROXIMITY_NAME = "proximity"
#: Names of penalties that depend on free paths, absent where all paths are held.
PATH_PENALTIES = (_PROXIMITY_NAME,)
#: Allowable error of the proximity to a discontinuity of length, root mean square over muscles and frames.
PROXIMITY = 2.0
# Unit of the limits on moment arms, m, which makes them comparable to those on normalised fiber lengths.
_ARM_UNIT = 0.01
# Initial weight of a limit, which the solver increases as needed.
_FIRST_WEIGHT = 100.0
#: Feasibility score that wraps must reach. The score is zero at the boundary between the classes and one at
#: the margin of the classifier. The limit is above zero because an optimiser tends to points where the
#: classifier is wrong.
FEASIBILITY_MARGIN = 0.5
# Initial weight of the limit on the feasibility score, which has another scale than normalised lengths.
_FIRST_SCORE_WEIGHT = 1.0


def path_limits(nominal: PathState) -> tuple[Limit, ...]:
    """Build the hard limits on free polynomials: range of normalised fiber lengths, sign of moment arms.

    Moment arms that change sign or are zero in the nominal model have no limit.

    Parameters
    ----------
    nominal
        Nominal paths of all muscles over the calibration cycles.

    Returns
    -------
    tuple of Limit
        ``longest_fiber`` and ``shortest_fiber`` (normalised length), ``moment_arm_sign`` (cm).
    """
    muscles, trials, frames = nominal.length.shape
    arms = np.asarray(nominal.moment_arm)
    positive, negative = (arms > 0.0).all(axis=(1, 3)), (arms < 0.0).all(axis=(1, 3))
    sign = np.broadcast_to((positive.astype(float) - negative)[:, None, :, None], arms.shape)
    expected_sign = jnp.asarray(sign.reshape(muscles, -1))
    shortest, longest = FIBER_LENGTH_RANGE
    ones, no_shift = jnp.ones((muscles, 1)), jnp.zeros((muscles, trials * frames))
    weight = jnp.full(no_shift.shape, _FIRST_WEIGHT)
    return (
        Limit("longest_fiber", normalized_length, flatten, ones, longest * ones, no_shift, weight),
        Limit("shortest_fiber", normalized_length, flatten, -ones, -shortest * ones, no_shift, weight),
        Limit(
            "moment_arm_sign",
            _moment_arm,
            flatten,
            -expected_sign / _ARM_UNIT,
            jnp.where(expected_sign == 0.0, 1.0, 0.0),
            jnp.zeros(expected_sign.shape),
            jnp.full(expected_sign.shape, _FIRST_WEIGHT),
        ),
    )


def feasibility_limits(nominal: PathState) -> tuple[Limit, ...]:
    """Build the hard limit on the infeasibility of wrap parameters.

    The feasibility score of ones wrap must reach `FEASIBILITY_MARGIN`, or its nominal value where that is
    smaller.

    Parameters
    ----------
    nominal
        Nominal paths of all muscles over the calibration cycles.

    Returns
    -------
    tuple of Limit
        ``infeasibility`` (score); empty for paths without a feasibility classifier.
    """
    if nominal.infeasibility is None:
        return ()
    most = jnp.maximum(nominal.infeasibility, -FEASIBILITY_MARGIN)
    none, first = jnp.zeros(most.shape), jnp.full(most.shape, _FIRST_SCORE_WEIGHT)
    ones = jnp.ones((most.shape[0], 1))
    return (Limit("infeasibility", _infeasibility, flatten, ones, most, none, first),)


def _infeasibility(parameters: ModelParameters, state: MuscleState) -> Float[Array, " wrap"]:
    assert state.path.infeasibility is not None
    return state.path.infeasibility


def proximity_penalty(muscles: int) -> MusclePenalty:
    """Build the penalty on the proximity of paths to discontinuities of their length.

    The proximity tends to infinity at a discontinuity, so that the penalty acts as a barrier. Unlike a limit
    it has a gradient away from the discontinuity, so that the solver need not reach ones of many
    discontinuities first. With free wraps, fiber lengths and signs of moment arms have no hard limits:
    feasible wrap parameters keep paths physiological, and fiber lengths are penalised as in NGA.

    Parameters
    ----------
    muscles
        Number of muscles.
    """
    return MusclePenalty(_PROXIMITY_NAME, _proximity, flatten, jnp.zeros((muscles, 1)), PROXIMITY)


def _proximity(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial frame"]:
    assert state.path.proximity is not None
    return state.path.proximity


def _moment_arm(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial coordinate frame"]:
    return state.path.moment_arm
