"""Muscles without an electrode: how active the least effort that closes the joint moments makes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

#: Moment (N m) that is left unexplained as readily as one muscle is fully active. EMG-driven models miss
#: measured moments by 5 to 10 N m: to leave less would have other muscles undo what driven ones do wrong.
#: A judgement, not a measurement, and contact forces depend on it: README.md says by how much.
RESIDUAL_SCALE = 10.0


@dataclass(frozen=True)
class SharedMoments:
    """What static optimization found, frame by frame.

    Parameters
    ----------
    activation
        Of each muscle, from 0 to 1.
    residual
        What no muscle explains of each moment, N m: what was asked for less what the muscles give.
    """

    activation: Float[np.ndarray, "muscle frame"]
    residual: Float[np.ndarray, "coordinate frame"]


def share_moments(
    missing: Float[np.ndarray, "coordinate frame"],
    moment_arm: Float[np.ndarray, "muscle coordinate frame"],
    active_force: Float[np.ndarray, "muscle frame"],
    *,
    residual_scale: float = RESIDUAL_SCALE,
) -> SharedMoments:
    """Share moments among muscles so that the sum of squared activations is least.

    At every frame by itself, without dynamics of activation, it minimizes

        sum over muscles of a^2  +  sum over coordinates of (residual / residual_scale)^2

    over activations ``a`` from 0 to 1, where ``residual = missing - sum of arm a active``. The
    criterion is of the kind that Crowninshield & Brand 1981 (doi:10.1016/0021-9290(81)90035-X) proposed, with
    activations in place of stresses and the exponent two. Reserve moments take the place of
    equality constraints, as in OpenSim's static optimization, so that there is always one solution. It is a
    bounded linear least-squares problem, which SciPy solves exactly.

    Parameters
    ----------
    missing
        Moments that the muscles are to give, N m: measured ones less those of muscles that are driven.
    moment_arm
        ``-dL/dq``, m.
    active_force
        Force along the tendon at full activation, N; never negative.
    residual_scale
        Moment (N m) that weighs as much as one fully active muscle. Small enough, muscles give all that
        they can before anything is left.

    Returns
    -------
    SharedMoments
        Where there is no muscle, all is residual.

    Examples
    --------
    Two equal muscles, each able to give 10 N m, share 10 N m equally:

    >>> import numpy as np
    >>> arm, force = np.full((2, 1, 1), 0.1), np.full((2, 1), 100.0)
    >>> found = share_moments(np.full((1, 1), 10.0), arm, force, residual_scale=1e-3)
    >>> found.activation.round(3).tolist()
    [[0.5], [0.5]]
    """
    muscles, frames = active_force.shape
    activation = np.zeros((muscles, frames))
    strength = moment_arm * active_force[:, None]
    for frame in range(frames if muscles else 0):
        # Above, what moments miss; below, the activations themselves.
        rows = np.concatenate([strength[:, :, frame].T / residual_scale, np.eye(muscles)])
        aims = np.concatenate([missing[:, frame] / residual_scale, np.zeros(muscles)])
        found = lsq_linear(rows, aims, bounds=(0.0, 1.0), method="bvls", tol=1e-12)
        activation[:, frame] = np.clip(found.x, 0.0, 1.0)
    return SharedMoments(activation, missing - np.einsum("mcf,mf->cf", strength, activation))
