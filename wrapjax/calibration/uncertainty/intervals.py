"""Standard deviations and intervals of calibrated parameters, from draws or from a covariance."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

#: A parameter counts as identified if moments reduce its deviation below this fraction of that without them.
IDENTIFIED_BELOW = 0.8


@dataclass(frozen=True)
class Spread:
    """Uncertainty of each variable of a leg, in its own unit.

    Parameters
    ----------
    labels, units
        Names, as ``soleus_l.emg_scale``, and SI units.
    value
        Calibrated values.
    deviation
        Standard deviations.
    low, high
        90 % intervals of the draws; of a variable at a bound the one-sided interval from that bound.
    prior_deviation
        Standard deviations without the moments, from priors, penalties and bounds alone.
    identified
        Whether the moments reduce the deviation by more than a fifth.
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
    """Compute standard deviations and intervals from draws.

    Parameters
    ----------
    draws, prior_draws
        Draws with and without the moments, in the units of the variables.
    value
        Calibrated values, in the same units.
    at_bound
        Position of each variable relative to its bounds, see `Posterior`.
    labels, units
        Names and units of the variables.
    """
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
    """Uncertainty of the parameters and predicted moments of a leg.

    Parameters
    ----------
    way
        Method: ``laplace`` or ``bootstrap``.
    parameters
        Standard deviations and intervals of the variables.
    draws
        Draws of the variables, in the units of ``parameters``.
    converged
        Number of draws whose calibration converged; all draws of ``laplace``.
    low, high
        90 % interval of the modelled moments of the draws, N m, without measurement noise.
    noise
        Standard deviation of the measured about the modelled moments by coordinate, N m.
    independent_samples
        Number of independent samples with the same information on the variance of the noise as all matched
        moments.
    information
        Factor that turns the moment term of the cost into minus twice a log likelihood.
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
