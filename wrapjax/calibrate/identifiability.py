"""Which parameters the moments can tell, and how well."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibrate.objective import Objective


def laplace_deviation(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"], moment_noise: float
) -> Float[np.ndarray, "muscle parameter"]:
    """Standard deviation that independent moment noise gives each free parameter, by Laplace.

    Penalties and priors are left out: what counts is what the moments say. The width of its bounds
    stands in as a variable's prior deviation, so that one that the moments cannot see comes out as
    uncertain as its bounds allow.

    Parameters
    ----------
    problem
        The calibrated objective.
    variables
        Where to judge, in solver units.
    moment_noise
        Standard deviation of every moment sample, N m.

    Returns
    -------
    Array
        In each parameter's own unit; columns in the order of ``problem.variables.names``.
    """
    covariance = _covariance(problem, variables, moment_noise)
    deviation = np.sqrt(np.diag(covariance))
    return deviation[np.asarray(problem.variables.index)] * np.asarray(problem.variables.scale)


def moment_arm_deviation(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"], moment_noise: float
) -> Float[np.ndarray, "muscle trial coordinate frame"]:
    """Standard deviation (m) that moment noise gives each moment arm where paths may move, by Laplace.

    What an arm gains another parameter may lose again: an EMG scale above all. Where the moments cannot
    tell the two apart, this is as large as the arm's bounds allow. Zero for paths that are held.

    Parameters
    ----------
    problem, variables, moment_noise
        As of `laplace_deviation`; arms are over the problem's cycles.
    """
    layout = problem.variables
    covariance = np.pad(_covariance(problem, variables, moment_noise), (0, 1))  # nothing held varies
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
    """Covariance of the variables, in solver units."""
    jacobian = eqx.filter_jit(problem.moment_jacobian)(jnp.asarray(variables))
    # Back from residuals in allowable errors to N m.
    slopes = (
        np.asarray(jacobian) * float(problem.moment_error) * np.sqrt(problem.measured.size) / moment_noise
    )
    width = np.asarray(problem.upper) - np.asarray(problem.lower)
    return np.linalg.inv(slopes.T @ slopes + np.diag(1.0 / width**2))
