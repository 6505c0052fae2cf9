"""Standard deviations of parameters and moment arms from the noise of the moments alone, without priors."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.objective import Objective


def laplace_deviation(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"], moment_noise: float
) -> Float[np.ndarray, "muscle parameter"]:
    """Compute standard deviations of the free parameters due to independent noise of the moments.

    The Laplace approximation without penalties and priors: deviations express what the moments determine. The
    width of its bounds serves as a variable's prior deviation, so that variables that the moments do not
    determine are as uncertain as their bounds allow.

    Parameters
    ----------
    problem
        Objective of the calibration.
    variables
        Point at which to linearise, solver units.
    moment_noise
        Standard deviation of every moment sample, N m.

    Returns
    -------
    Array
        Standard deviations in the units of the parameters; columns in the order of
        ``problem.variables.names``.
    """
    covariance = _covariance(problem, variables, moment_noise)
    deviation = np.sqrt(np.diag(covariance))
    return deviation[np.asarray(problem.variables.index)] * np.asarray(problem.variables.scale)


def moment_arm_deviation(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"], moment_noise: float
) -> Float[np.ndarray, "muscle trial coordinate frame"]:
    """Compute standard deviations of moment arms due to independent noise of the moments.

    A change of a moment arm may be compensated by another parameter, in particular an EMG scale. Where the
    moments cannot distinguish the two, the deviation is as large as the bounds allow.

    Parameters
    ----------
    problem, variables, moment_noise
        See `laplace_deviation`.

    Returns
    -------
    Array
        Standard deviations over the cycles of the problem, m; zero for paths that are held.
    """
    layout = problem.variables
    covariance = np.pad(_covariance(problem, variables, moment_noise), (0, 1))  # zero for held entries
    changes = layout.unpack(jnp.asarray(variables)).path_changes
    _, slopes = eqx.filter_jit(problem.recording.path.linearized)(changes)
    own = np.asarray(layout.index)[:, len(layout.names) :]
    scale = np.asarray(layout.scale)[:, len(layout.names) :]
    blocks = covariance[own[:, :, None], own[:, None, :]] * scale[:, :, None] * scale[:, None, :]
    arms = np.asarray(slopes.moment_arm)[:, : own.shape[1]]
    return np.sqrt(np.einsum("mktcf,mkl,mltcf->mtcf", arms, blocks, arms, optimize=True).clip(0.0))


def _covariance(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"], moment_noise: float
) -> Float[np.ndarray, "variable variable"]:
    """Compute the covariance of the variables, in solver units."""
    jacobian = eqx.filter_jit(problem.moment_jacobian)(jnp.asarray(variables))
    # Convert residuals, which are in allowable errors, to N m.
    slopes = (
        np.asarray(jacobian) * float(problem.moment_error) * np.sqrt(problem.measured.size) / moment_noise
    )
    width = np.asarray(problem.upper) - np.asarray(problem.lower)
    return np.linalg.inv(slopes.T @ slopes + np.diag(1.0 / width**2))
