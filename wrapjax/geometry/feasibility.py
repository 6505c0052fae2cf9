"""Where in the box of its wrap parameters a surface makes physiological paths.

A support vector machine of cubic kernel tells physiological samples from others, and a sigmoid turns
its score into a probability, as in Ao, Fregly et al. This is what a calibration evaluates and
differentiates; how it is fitted is in `feasibility_fit`.
"""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

#: A class with a smaller share of the samples than this is too rare to be learned, or judged by.
RAREST_SHARE = 0.02


class Feasibility(eqx.Module):
    """The boundary between physiological and other wrap parameters of one surface.

    The score is ``s = sum_i weight_i (1 + gamma x_i . x)^3 + offset``, positive where parameters are not
    physiological. Parameters and support vectors ``x`` are scaled so that the sampled box is [-1, 1].
    """

    support: Float[Array, "support wrap_parameter"]
    #: Lagrange multipliers, positive for samples that are not physiological.
    weights: Float[Array, " support"]
    offset: Float[Array, ""]
    gamma: Float[Array, ""]
    #: Middle and half width of the sampled box, in the parameters' units.
    center: Float[Array, " wrap_parameter"]
    half_range: Float[Array, " wrap_parameter"]
    #: The sigmoid's M and B.
    slope: Float[Array, ""]
    intercept: Float[Array, ""]

    def score(self, parameters: Float[Array, " wrap_parameter"]) -> Float[Array, ""]:
        """Decision value of the support vector machine: positive where not physiological."""
        scaled = (parameters - self.center) / self.half_range
        return self.weights @ (1.0 + self.gamma * (self.support @ scaled)) ** 3 + self.offset

    def probability(self, parameters: Float[Array, " wrap_parameter"]) -> Float[Array, ""]:
        """Probability that parameters are not physiological, ``P = 1 / (1 + exp(M s + B))``."""
        return jax.nn.sigmoid(-(self.slope * self.score(parameters) + self.intercept))

    def excess(self, parameters: Float[Array, " wrap_parameter"]) -> Float[Array, ""]:
        """How far parameters are beyond the limit; at most zero where they are allowed.

        The limit is ``P <= P(s = 0)``. As P rises with s (M is negative wherever the machine knows
        better than chance), that is ``s <= 0``, whatever the sigmoid. The score is also the better
        constraint: far outside its slope is steep, where that of P vanishes.
        """
        return self.score(parameters)


@dataclass(frozen=True)
class FeasibilityQuality:
    """How well a surface's limit sorts samples that it was not fitted to.

    Parameters
    ----------
    balanced_accuracy
        Mean of the shares, of either class, that are sorted rightly; None where a class has less than
        2 % of the samples.
    false_physiological
        Share of the samples that are not physiological but allowed; None if all are physiological.
    """

    balanced_accuracy: float | None
    false_physiological: float | None


def feasibility_quality(
    feasibility: Feasibility | None,
    samples: Float[np.ndarray, "sample wrap_parameter"],
    physiological: Bool[np.ndarray, " sample"],
    usable: Bool[np.ndarray, " sample"] | None = None,
) -> FeasibilityQuality:
    """Judge what limits a surface by labeled samples: its learned limit and the exact margins together.

    Parameters
    ----------
    feasibility
        None for a surface without a limit, which allows everything.
    samples
        Wrap parameters, other ones than it was fitted to.
    physiological
        What they truly are.
    usable
        What the exact engine's margins allow; everything if not given.
    """
    allowed = np.ones_like(physiological) if usable is None else usable
    if feasibility is not None:
        allowed = allowed & (np.asarray(jax.vmap(feasibility.excess)(jnp.asarray(samples))) <= 0.0)
    return FeasibilityQuality(
        balanced_accuracy=None
        if has_rare_class(physiological)
        else balanced_accuracy(allowed, physiological),
        false_physiological=None if physiological.all() else float(allowed[~physiological].mean()),
    )


def has_rare_class(physiological: Bool[np.ndarray, " sample"]) -> bool:
    """Say whether less than 2 % of the samples are physiological, or less than 2 % are not."""
    share = float(np.mean(physiological))
    return min(share, 1.0 - share) < RAREST_SHARE


def balanced_accuracy(
    allowed: Bool[np.ndarray, " sample"], physiological: Bool[np.ndarray, " sample"]
) -> float:
    """Mean of the share of physiological samples allowed and the share of others not allowed."""
    return 0.5 * float(allowed[physiological].mean() + (~allowed[~physiological]).mean())
