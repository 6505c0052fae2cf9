"""What a calibration expected of its variables before it saw a moment."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibrate import Objective


def expectations(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"]
) -> tuple[Float[np.ndarray, "variable sum"], Float[np.ndarray, " variable"]]:
    """Read what a calibration expects of its variables off all that it minimises but the moment error.

    Penalties are means over muscles of squares in allowable errors. As many times as much, an allowable
    error is one standard deviation of one muscle's quantity. Without them fibers would be free to be
    absurdly long, and any effect could hide in that.

    Returns
    -------
    spread, away
        A root of the prior covariance of the variables, and how far these are from where they are
        expected, both in solver units.
    """
    muscles = len(problem.variables.index)
    kept = replace(problem, moment_error=np.array(np.inf), alterations=())
    own = kept.linearized_at(jnp.asarray(variables))
    # Nothing is expected beyond its bounds; that also holds what no penalty sees.
    width = np.asarray(problem.upper) - np.asarray(problem.lower)
    precision = muscles * np.asarray(own.gauss_newton) + np.diag(1.0 / width**2)
    covariance = np.linalg.inv(precision)
    away = covariance @ (muscles * np.asarray(own.gradient))
    return np.linalg.cholesky(0.5 * (covariance + covariance.T)), away
