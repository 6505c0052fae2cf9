"""Modes of a polynomial path: combinations of its coefficients with equal penalties.

After Meyer et al. 2017 (doi:10.1371/journal.pone.0179698), changes of lengths and moment arms are penalized
in their mean and in their shape, relative to the nominal range over the recorded cycles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.paths import PathState

# Allowable changes as fractions of the nominal range.
_LENGTH_MEAN, _LENGTH_SHAPE = 1.0, 0.25
_ARM_MEAN, _ARM_SHAPE = 0.5, 0.25
# Shapes of knee, ankle and subtalar moment arms are better known than those of the hip.
_DISTAL_ARM_SHAPE = 0.125
# Smallest range (m). Without it, a quantity that is almost constant could not change at all.
_LEAST_RANGE = 0.01
# Allowable change of a single coefficient, m. It constrains only combinations that the recorded cycles do not
# determine.
_COEFFICIENT = 3e-3
#: Allowable norm of a path's vector of modes, root mean square over muscles. Meyer et al. weigh a norm of one
#: like a moment error of 1 N m, which hardly lets paths change (errors fall by a seventh). This weaker weight
#: only prevents changes that do not reduce moment errors.
PATH_CHANGE = 15.0


def path_modes(
    nominal: PathState,
    by_coefficient: PathState,
    used: Bool[np.ndarray, "muscle term"],
    coordinates: Sequence[str],
) -> Float[np.ndarray, "muscle term mode"]:
    """Compute the modes of each path: principal axes of the penalty on changes of its coefficients.

    The penalties on a change of a path are squares of functions that are linear in the coefficients, and thus
    one quadratic form for each muscle. Modes are its principal axes, each scaled to a penalty of one. The
    penalty of any change is then the squared norm of its vector of modes, and the problem is well
    conditioned.

    Parameters
    ----------
    nominal
        Paths of all muscles over the calibration cycles.
    by_coefficient
        Change of the paths per unit (1 m) of each coefficient; the first axes of all leaves are ``muscle
        term``.
    used
        Coefficients that a muscle has.
    coordinates
        Names of the coordinates of the moment arms.

    Returns
    -------
    Array
        Coefficients of each mode, m. Modes that a muscle does not have come last and are zero.
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
        columns = np.flatnonzero(used[muscle])
        values, axes = np.linalg.eigh(form[muscle][np.ix_(columns, columns)])
        modes[muscle, columns, : len(columns)] = axes / np.sqrt(values)
    return modes


def _range(values: Float[Array, "muscle trial coordinate frame"]) -> Float[np.ndarray, "muscle coordinate"]:
    return np.maximum(np.ptp(np.asarray(values), axis=(1, 3)), _LEAST_RANGE)


def _mean_square_of_mean(
    by: Float[np.ndarray, "muscle term trial coordinate frame"],
    allowable: Float[np.ndarray, "muscle coordinate"],
) -> Float[np.ndarray, "muscle term term"]:
    """Compute the quadratic form of the squared mean over frames, summed over coordinates."""
    mean = by.mean(axis=(2, 4)) / allowable[:, None]
    return np.einsum("mkc,mlc->mkl", mean, mean)


def _mean_square_of_shape(
    by: Float[np.ndarray, "muscle term trial coordinate frame"],
    allowable: Float[np.ndarray, "muscle coordinate"],
) -> Float[np.ndarray, "muscle term term"]:
    """Compute the quadratic form of the variance over frames, summed over coordinates."""
    frames = by.shape[2] * by.shape[4]
    shape = (by - by.mean(axis=(2, 4), keepdims=True)) / allowable[:, None, None, :, None]
    flat = shape.reshape(*by.shape[:2], -1)
    return flat @ np.swapaxes(flat, 1, 2) / frames
