"""What a null hypothesis makes of residuals and of effects' signatures: all that a score takes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float

from wrapjax.diagnosis.effects.effect import resized
from wrapjax.diagnosis.null_covariance import Matrix

Signature = Float[np.ndarray, "parameter row"]


@dataclass(frozen=True)
class Candidate:
    """An effect as a score test sees it.

    Parameters
    ----------
    id
        Of the effect.
    variants
        Signatures of each of its shapes, N m a unit of each amount.
    prior_sd
        Of its amounts.
    one_sided
        Which of them cannot be negative.
    parts
        Numbers of the amounts that belong together: as a rule one part is amiss and the others are not. None
        where all go together.
    limit
        Largest amounts at which the effect still makes sense.
    """

    id: str
    variants: tuple[Signature, ...]
    prior_sd: Float[np.ndarray, " parameter"]
    one_sided: Bool[np.ndarray, " parameter"]
    parts: tuple[tuple[int, ...], ...] = ()
    limit: Float[np.ndarray, " parameter"] | float = np.inf

    def expected(self, size: float) -> Float[np.ndarray, " parameter"]:
        """Standard deviations of amounts that are so many times as large, within limits."""
        return resized(self.prior_sd, size, self.limit)

    @property
    def hypotheses(self) -> tuple[tuple[tuple[int, ...], float], ...]:
        """Which amounts are not zero, and how plausible that was: half for all, half for one part alone."""
        everything = tuple(range(len(self.prior_sd)))
        if len(self.parts) < 2:
            return ((everything, 1.0),)
        return ((everything, 0.5), *((part, 0.5 / len(self.parts)) for part in self.parts))

    def log_prior(self, part: tuple[int, ...]) -> float:
        """Logarithm of how plausible one shape with these amounts was."""
        return float(np.log(dict(self.hypotheses)[part] / len(self.variants)))


@dataclass(frozen=True)
class Null:
    """One null hypothesis: a covariance, and how plausible it was before."""

    covariance: Matrix
    log_prior: float = 0.0


@dataclass(frozen=True)
class Projection:
    """What one null hypothesis makes of residuals and signatures: all that a score takes of them.

    Amounts are those of all shapes of all candidates, one after the other.

    Parameters
    ----------
    weight
        Logarithm of how plausible the null is with each residual, but for a constant.
    slope, information
        s and I.
    """

    weight: Float[np.ndarray, " sample"]
    slope: Float[np.ndarray, "sample amount"]
    information: Float[np.ndarray, "amount amount"]

    def allowing(self, spread: Float[np.ndarray, " amount"]) -> Projection:
        """Let the null have all amounts with these standard deviations (Woodbury's identity)."""
        own = np.flatnonzero(spread)
        root = self.information[:, own] * spread[own]
        inner = np.eye(len(own)) + spread[own, None] * root[own]
        factor = scipy.linalg.cholesky(inner, lower=True, check_finite=False)
        taken = scipy.linalg.solve_triangular(
            factor, np.vstack([root, self.slope[:, own] * spread[own]]).T, lower=True, check_finite=False
        ).T
        of_amounts, of_samples = np.split(taken, [len(root)])
        return Projection(
            self.weight + 0.5 * np.sum(of_samples**2, axis=1) - np.sum(np.log(np.diag(factor))),
            self.slope - of_samples @ of_amounts.T,
            self.information - of_amounts @ of_amounts.T,
        )


def project(
    residuals: Float[np.ndarray, "sample row"], null: Null, candidates: Sequence[Candidate]
) -> Projection:
    """Look at residuals and signatures through a null's covariance."""
    shapes = [signature for candidate in candidates for signature in candidate.variants]
    stacked = np.concatenate([*shapes, np.zeros((0, residuals.shape[1]))])
    factor = scipy.linalg.cholesky(null.covariance, lower=True, check_finite=False)
    seen = scipy.linalg.solve_triangular(factor, residuals.T, lower=True, check_finite=False)
    # All signatures at once: one by one they would wait for the factor to come from memory.
    white = scipy.linalg.solve_triangular(factor, stacked.T, lower=True, check_finite=False)
    weight = null.log_prior - 0.5 * np.sum(seen**2, axis=0) - np.sum(np.log(np.diag(factor)))
    return Projection(weight, seen.T @ white, white.T @ white)
