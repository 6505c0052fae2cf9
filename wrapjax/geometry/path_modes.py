"""Modes of a polynomial path: combinations of its coefficients that are penalised alike.

After Meyer et al. 2017 (doi:10.1371/journal.pone.0179698): lengths and moment arms stay near the nominal ones
in mean and in shape, measured against their range over the recorded cycles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.paths import PathState

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
