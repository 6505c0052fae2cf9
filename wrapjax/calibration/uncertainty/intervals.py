"""Which parameters the moments can tell, and how well.

How far parameters may be from where calibration ended, in their own units.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.calibration.objective import Objective


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


#: A deviation that moments did not bring below this part of what it is without them counts as open.
IDENTIFIED_BELOW = 0.8


@dataclass(frozen=True)
class Spread:
    """How far each variable of a leg may be from where calibration ended, in its own unit.

    Parameters
    ----------
    labels, units
        ``soleus_l.emg_scale``; SI.
    value
        As calibrated.
    deviation, low, high
        Standard deviation, and the interval that holds 90 % of the draws: of a variable at a bound the
        one-sided interval from that bound.
    prior_deviation
        Standard deviation without the moments: by priors, penalties and bounds alone.
    identified
        Whether moments made the deviation smaller by more than a fifth.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    value: Float[np.ndarray, " variable"]
    deviation: Float[np.ndarray, " variable"]
    low: Float[np.ndarray, " variable"]
    high: Float[np.ndarray, " variable"]
    prior_deviation: Float[np.ndarray, " variable"]
    identified: Bool[np.ndarray, " variable"]


def summarize_draws(
    draws: Float[np.ndarray, "draw variable"],
    prior_draws: Float[np.ndarray, "_ variable"],
    value: Float[np.ndarray, " variable"],
    at_bound: Int[np.ndarray, " variable"],
    labels: tuple[str, ...],
    units: tuple[str, ...],
) -> Spread:
    """Summarize draws; all in the variables' own units, ``at_bound`` as of `Posterior`."""
    low, high = np.percentile(draws, [5.0, 95.0], axis=0)
    one_sided = np.percentile(draws, [10.0, 90.0], axis=0)
    low = np.where(at_bound == -1, value, np.where(at_bound == 1, one_sided[0], low))
    high = np.where(at_bound == 1, value, np.where(at_bound == -1, one_sided[1], high))
    deviation, before = draws.std(axis=0, ddof=1), prior_draws.std(axis=0, ddof=1)
    return Spread(
        labels=labels,
        units=units,
        value=value,
        deviation=deviation,
        low=low,
        high=high,
        prior_deviation=before,
        identified=(deviation < IDENTIFIED_BELOW * before) | (at_bound == 2),
    )


@dataclass(frozen=True)
class LegSpread:
    """The spread of a leg's parameters and of the moments that they predict.

    Parameters
    ----------
    way
        How it was found: ``laplace`` or ``bootstrap``.
    parameters
        Of each variable.
    draws
        Variables in the units of ``parameters``.
    converged
        How many draws came of a calibration that converged; all of them where none was calibrated.
    low, high
        Interval that holds 90 % of the modelled moments of the draws, N m: of the model, without the noise
        of a measurement.
    noise
        Standard deviation of moments about the model by coordinate, N m.
    independent_samples
        How many independent samples tell as much of the noise's size as all matched moments together.
    information
        Factor that made the moments' part of the cost minus twice the logarithm of a probability.
    """

    way: str
    parameters: Spread
    draws: Float[np.ndarray, "draw variable"] = field(repr=False)
    converged: int
    low: Float[np.ndarray, "trial coordinate frame"] = field(repr=False)
    high: Float[np.ndarray, "trial coordinate frame"] = field(repr=False)
    noise: Float[np.ndarray, " coordinate"]
    independent_samples: float
    information: float
