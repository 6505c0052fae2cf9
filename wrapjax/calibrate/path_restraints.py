"""What holds muscle paths when their polynomials may change: modes, soft penalty and hard limits.

After Meyer et al. 2017 (doi:10.1371/journal.pone.0179698): lengths and moment arms stay near the
nominal ones in mean and in shape, measured against how far they range over the recorded cycles; moment
arms that keep their sign in the nominal model keep it; fibers stay in their working range.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.calibrate.penalties import Limit, MusclePenalty, normalized_length, whole
from wrapjax.geometry import PathState
from wrapjax.model import ModelParameters, MuscleState

#: Working range of normalised fiber length (the NMSM Pipeline's).
FIBER_LENGTH_RANGE = (0.3, 1.3)
# Allowable changes in parts of the nominal range.
_LENGTH_MEAN, _LENGTH_SHAPE = 1.0, 0.25
_ARM_MEAN, _ARM_SHAPE = 0.5, 0.25
# Shapes of knee, ankle and subtalar moment arms are known better than those of the hip.
_DISTAL_ARM_SHAPE = 0.125
# Ranges below this (m) count as this: what hardly varies could otherwise not move at all.
_LEAST_RANGE = 0.01
# Allowable change of a single coefficient, m. Weak: it only holds what the recorded cycles do not see.
_COEFFICIENT = 3e-3
#: Allowable length of a path's vector of modes, root mean square over muscles. Meyer et al. weigh a
#: length of one like a moment error of 1 N m, which holds paths where they are (errors fall by a seventh);
#: here it only keeps changes from being larger than the moments ask for.
PATH_CHANGE = 15.0
_CLOSENESS_NAME = "closeness"
#: Names of penalties that paths are asked about, and that mean nothing where these are held.
PATH_PENALTIES = (_CLOSENESS_NAME,)
#: Allowable closeness to a jump in length, root mean square over muscles and frames.
CLOSENESS = 2.0
# Moment arms are limited in units of this (m), to be of the order of fiber lengths.
_ARM_UNIT = 0.01
# At first the excess of one unit costs this; the solver raises it as it needs.
_FIRST_WEIGHT = 100.0
#: How far cylinders stay within what was learned to be physiological: a score of one is the margin between
#: the classes. A calibration looks for the places where what was learned is wrong.
CAUTION = 0.5
# A score of one is the width of the margin between the classes: far, where a fiber length of one is not.
_FIRST_SCORE_WEIGHT = 1.0


def path_modes(
    nominal: PathState,
    by_coefficient: PathState,
    used: Bool[np.ndarray, "muscle term"],
    coordinates: Sequence[str],
) -> Float[np.ndarray, "muscle term mode"]:
    """Find the modes of each path: combinations of its coefficients that are restrained alike.

    The soft penalties on a change of path, squares of what is linear in the coefficients, are one
    quadratic form a muscle. Its principal axes are the modes, each scaled to a penalty of one: then
    the penalty of any change is the squared length of its vector of modes, and the problem is as well
    scaled as can be.

    Parameters
    ----------
    nominal
        Paths of all muscles over the calibration cycles.
    by_coefficient
        What a unit (1 m) of each coefficient adds; leaves lead with ``muscle term``.
    used
        Which coefficients a muscle has.
    coordinates
        Names along the axis of the moment arms.

    Returns
    -------
    Array
        Coefficients of each mode in m; zero for modes that a muscle does not have, which are its last.
    """
    muscles, terms = used.shape
    length_range, arm_range = _range(nominal.length[:, :, None]), _range(nominal.moment_arm)
    distal = np.array([not name.startswith("hip") for name in coordinates])
    arm_shape = np.where(distal, _DISTAL_ARM_SHAPE, _ARM_SHAPE)[None]
    length, arm = np.asarray(by_coefficient.length)[:, :, :, None], np.asarray(by_coefficient.moment_arm)
    form = (
        _mean_square_of_mean(length, _LENGTH_MEAN * length_range)
        + _mean_square_of_shape(length, _LENGTH_SHAPE * length_range)
        + _mean_square_of_mean(arm, _ARM_MEAN * arm_range)
        + _mean_square_of_shape(arm, arm_shape * arm_range)
        + np.eye(terms) / _COEFFICIENT**2
    )
    modes = np.zeros((muscles, terms, terms))
    for muscle in range(muscles):
        own = np.flatnonzero(used[muscle])
        values, axes = np.linalg.eigh(form[muscle][np.ix_(own, own)])
        modes[muscle, own, : len(own)] = axes / np.sqrt(values)
    return modes


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
    most = jnp.maximum(nominal.infeasibility, -CAUTION)
    none, first = jnp.zeros(most.shape), jnp.full(most.shape, _FIRST_SCORE_WEIGHT)
    each = jnp.ones((most.shape[0], 1))
    return (Limit("infeasibility", _infeasibility, whole, each, most, none, first),)


def _infeasibility(parameters: ModelParameters, state: MuscleState) -> Float[Array, " wrap"]:
    assert state.path.infeasibility is not None
    return state.path.infeasibility


def closeness_penalty(muscles: int) -> MusclePenalty:
    """Keep paths round cylinders from where their length would jump.

    Closeness grows without bound there, so that no path ever gets over. It is seen from afar, unlike a
    limit: the solver need not run into each of many walls to learn of it. Fibers and signs of moment
    arms have no hard limits here: cylinders of possible place and size keep paths physiological, and
    fiber lengths are held as in NGA.
    """
    return MusclePenalty(_CLOSENESS_NAME, _closeness, whole, jnp.zeros((muscles, 1)), CLOSENESS)


def _closeness(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial frame"]:
    assert state.path.closeness is not None
    return state.path.closeness


def _moment_arm(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial coordinate frame"]:
    return state.path.moment_arm


def _range(values: Float[Array, "muscle trial coordinate frame"]) -> Float[np.ndarray, "muscle coordinate"]:
    return np.maximum(np.ptp(np.asarray(values), axis=(1, 3)), _LEAST_RANGE)


def _mean_square_of_mean(
    by: Float[np.ndarray, "muscle term trial coordinate frame"],
    allowable: Float[np.ndarray, "muscle coordinate"],
) -> Float[np.ndarray, "muscle term term"]:
    """Quadratic form of the squared mean over frames, summed over coordinates."""
    mean = by.mean(axis=(2, 4)) / allowable[:, None]
    return np.einsum("mkc,mlc->mkl", mean, mean)


def _mean_square_of_shape(
    by: Float[np.ndarray, "muscle term trial coordinate frame"],
    allowable: Float[np.ndarray, "muscle coordinate"],
) -> Float[np.ndarray, "muscle term term"]:
    """Quadratic form of the mean square about the mean, summed over coordinates."""
    frames = by.shape[2] * by.shape[4]
    shape = (by - by.mean(axis=(2, 4), keepdims=True)) / allowable[:, None, None, :, None]
    flat = shape.reshape(*by.shape[:2], -1)
    return flat @ np.swapaxes(flat, 1, 2) / frames
