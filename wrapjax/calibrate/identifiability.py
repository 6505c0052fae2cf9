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
    jacobian = eqx.filter_jit(problem.moment_jacobian)(jnp.asarray(variables))
    # Back from residuals in allowable errors to N m.
    slopes = (
        np.asarray(jacobian) * float(problem.moment_error) * np.sqrt(problem.measured.size) / moment_noise
    )
    width = np.asarray(problem.upper) - np.asarray(problem.lower)
    precision = slopes.T @ slopes + np.diag(1.0 / width**2)
    deviation = np.sqrt(np.diag(np.linalg.inv(precision)))
    return deviation[np.asarray(problem.variables.index)] * np.asarray(problem.variables.scale)
