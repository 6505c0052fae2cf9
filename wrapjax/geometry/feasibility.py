"""Where in the box of its wrap parameters a surface makes physiological paths.

A support vector machine of cubic kernel tells physiological samples from others, and a sigmoid turns
its score into a probability, as in Ao, Fregly et al. This is what a calibration evaluates and
differentiates; how it is fitted is in `feasibility_fit`.

Learn from labeled samples where a surface makes physiological paths.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Bool, Float
from scipy.special import expit

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


#: What cross-validation chooses among: the penalty C of a sample on the wrong side, and the kernel's gamma,
#: which brings the product of two points of the box within 0.5, 1 or 2. A C of 1000 or a gamma of 1 was no
#: more accurate on 1000 samples, and took up to 30 s where classes overlap.
PENALTIES = (0.1, 1.0, 10.0, 100.0)
GAMMAS = (1.0 / 12.0, 1.0 / 6.0, 1.0 / 3.0)
FOLDS = 5


def fit_feasibility(
    samples: Float[np.ndarray, "sample wrap_parameter"],
    physiological: Bool[np.ndarray, " sample"],
    lower: Float[np.ndarray, " wrap_parameter"],
    upper: Float[np.ndarray, " wrap_parameter"],
    *,
    usable: Bool[np.ndarray, " sample"] | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> Feasibility | None:
    """Fit a support vector machine of cubic kernel, and the sigmoid that makes its score a probability.

    Both classes count alike, however rare one is. C and gamma are those of `PENALTIES` and `GAMMAS` by which
    machine and exact margins together have the highest balanced accuracy in stratified cross-validation; of
    equals the smallest C, then the smallest gamma. The sigmoid is fitted to the scores that cross-validation
    gave each sample while leaving it out: on samples that it was fitted to, a machine is surer than it
    should be.

    Parameters
    ----------
    samples
        Wrap parameters.
    physiological
        What each of them is.
    lower, upper
        The box that was sampled, which is scaled to [-1, 1].
    usable
        What the exact engine's margins allow; everything if not given.
    seed
        Decides which samples are left out together. The same seed gives the same bits.
    threads
        Of cross-validation; by default a few more than there are cores.

    Returns
    -------
    Feasibility or None
        None where a class has less than 2 % of the samples, or fewer samples than there are folds:
        nothing can be learned there. Which class that is, the labels say.

    Notes
    -----
    Takes about a second for 1000 samples, and some seconds where the classes overlap much.
    """
    if not np.all(lower < upper):
        raise ValueError(f"the box is empty: lower {lower}, upper {upper}")
    fewest = min(physiological.sum(), (~physiological).sum())
    if fewest < FOLDS or has_rare_class(physiological):
        return None
    center, half_range = 0.5 * (upper + lower), 0.5 * (upper - lower)
    scaled = (samples - center) / half_range
    penalty, gamma, scores = _cross_validated(
        scaled, physiological, np.ones_like(physiological) if usable is None else usable, seed, threads
    )
    machine = _machine(penalty, gamma).fit(scaled, ~physiological)
    slope, intercept = fit_sigmoid(scores, ~physiological)
    arrays = {
        "support": machine.support_vectors_,
        "weights": machine.dual_coef_[0],
        "offset": machine.intercept_[0],
        "gamma": gamma,
        "center": center,
        "half_range": half_range,
        "slope": slope,
        "intercept": intercept,
    }
    # Through NumPy: JAX takes a plain number for one of no type of its own.
    return Feasibility(**{name: jnp.asarray(np.asarray(values)) for name, values in arrays.items()})


def fit_sigmoid(
    scores: Float[np.ndarray, " sample"], positive: Bool[np.ndarray, " sample"]
) -> tuple[float, float]:
    """Find M and B of ``P = 1 / (1 + exp(M s + B))`` by maximum likelihood.

    After Platt (1999), a positive sample counts as one of probability ``(n + 1) / (n + 2)`` and a
    negative one as ``1 / (m + 2)``, n and m being how many there are. So M is finite, too, where
    scores separate the classes.

    Parameters
    ----------
    scores
        Decision values.
    positive
        Whether each sample is of the class that P is the probability of.

    Returns
    -------
    slope, intercept
        M and B; M is negative where higher scores mean positive.
    """
    positives, negatives = int(positive.sum()), int((~positive).sum())
    target = np.where(positive, (positives + 1.0) / (positives + 2.0), 1.0 / (negatives + 2.0))
    # Of the order of one, whatever the size of scores.
    scale = float(np.abs(scores).max())
    design = np.stack([scores / scale, np.ones_like(scores)], axis=1)

    def surprise(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        exponent = design @ parameters
        # -log P and -log(1 - P), without overflow.
        each = target * np.logaddexp(0.0, exponent) + (1.0 - target) * np.logaddexp(0.0, -exponent)
        return float(each.mean()), design.T @ (target - expit(-exponent)) / len(scores)

    def curvature(parameters: np.ndarray) -> np.ndarray:
        probability = expit(-(design @ parameters))
        return (design.T * (probability * (1.0 - probability))) @ design / len(scores)

    start = np.array([0.0, np.log((negatives + 1.0) / (positives + 1.0))])
    found = scipy.optimize.minimize(
        surprise, start, jac=True, hess=curvature, method="trust-exact", options={"gtol": 1e-13}
    )
    return float(found.x[0]) / scale, float(found.x[1])


def _cross_validated(
    scaled: Float[np.ndarray, "sample wrap_parameter"],
    physiological: Bool[np.ndarray, " sample"],
    usable: Bool[np.ndarray, " sample"],
    seed: int,
    threads: int | None,
) -> tuple[float, float, Float[np.ndarray, " sample"]]:
    """Choose C and gamma; return them and the score of each sample by the machine that left it out."""
    from sklearn.model_selection import StratifiedKFold

    folds = list(StratifiedKFold(FOLDS, shuffle=True, random_state=seed).split(scaled, physiological))
    grid = list(product(PENALTIES, GAMMAS))

    def of_others(choice: tuple[float, float]) -> Float[np.ndarray, " sample"]:
        scores = np.zeros(len(scaled))
        for others, left_out in folds:
            machine = _machine(*choice).fit(scaled[others], ~physiological[others])
            scores[left_out] = machine.decision_function(scaled[left_out])
        return scores

    best, chosen = -1.0, None
    with ThreadPoolExecutor(threads) as pool:  # libsvm lets go of the interpreter
        each = pool.map(of_others, grid)
    for (penalty, gamma), scores in zip(grid, each, strict=True):
        accuracy = balanced_accuracy(usable & (scores <= 0.0), physiological)
        if accuracy > best:
            best, chosen = accuracy, (penalty, gamma, scores)
    assert chosen is not None, "the grid is not empty"
    return chosen


def _machine(penalty: float, gamma: float) -> Any:
    from sklearn.svm import SVC

    return SVC(C=penalty, kernel="poly", degree=3, coef0=1.0, gamma=gamma, class_weight="balanced")
