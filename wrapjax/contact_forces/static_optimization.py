"""Static optimization of the activations of muscles without an electrode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

#: Residual moment (N m) that costs as much as one fully active muscle. EMG-driven models have moment errors
#: of 5 to 10 N m: with a smaller value, undriven muscles would compensate the errors of the driven ones. A
#: judgement, not a measurement; README.md states how much contact forces depend on it.
RESIDUAL_SCALE = 10.0


@dataclass(frozen=True)
class SharedMoments:
    """Result of static optimization.

    Parameters
    ----------
    activation
        Activation of each muscle, 0 to 1.
    residual
        Requested moments less those of the muscles, N m.
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
    """Distribute joint moments among muscles with the least sum of squared activations.

    Each frame is optimized separately, without activation dynamics, by minimizing

        sum over muscles of a^2  +  sum over coordinates of (residual / residual_scale)^2

    over activations ``a`` from 0 to 1, where ``residual = missing - sum of moment_arm a active_force``. The
    criterion is that of Crowninshield & Brand 1981 (doi:10.1016/0021-9290(81)90035-X) with activations
    instead of stresses and exponent two. Residual moments replace equality constraints, like the reserve
    actuators of OpenSim's static optimization, so that there is always a unique solution. The bounded linear
    least-squares problem is solved exactly by SciPy.

    Parameters
    ----------
    missing
        Moments to distribute, N m: measured moments less those of the driven muscles.
    moment_arm
        Moment arms ``-dL/dq``, m.
    active_force
        Active tendon force at full activation, N; not negative.
    residual_scale
        Residual moment that costs as much as one fully active muscle, N m. With a very small value, residuals
        remain only where muscles are too weak.

    Returns
    -------
    SharedMoments
        Activations and residual moments; without muscles, all moments are residual.

    Examples
    --------
    Two equal muscles, each able to give 10 N m, share 10 N m equally:

    >>> import numpy as np
    >>> arm, force = np.full((2, 1, 1), 0.1), np.full((2, 1), 100.0)
    >>> shared = share_moments(np.full((1, 1), 10.0), arm, force, residual_scale=1e-3)
    >>> shared.activation.round(3).tolist()
    [[0.5], [0.5]]
    """
    muscles, frames = active_force.shape
    activation = np.zeros((muscles, frames))
    strength = moment_arm * active_force[:, None]
    for frame in range(frames if muscles else 0):
        # Upper rows: scaled residual moments; lower rows: activations.
        rows = np.concatenate([strength[:, :, frame].T / residual_scale, np.eye(muscles)])
        targets = np.concatenate([missing[:, frame] / residual_scale, np.zeros(muscles)])
        solution = lsq_linear(rows, targets, bounds=(0.0, 1.0), method="bvls", tol=1e-12)
        activation[:, frame] = np.clip(solution.x, 0.0, 1.0)
    return SharedMoments(activation, missing - np.einsum("mcf,mf->cf", strength, activation))
