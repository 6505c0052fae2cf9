"""Feasibility of wrap parameters: a support vector machine that separates physiological samples from others.

As in Ao, Fregly et al., the kernel is cubic, and a sigmoid (Platt 1999) converts the decision value to a
probability. `fit_feasibility` fits both to labeled samples. Calibrations evaluate and differentiate
`Feasibility.excess`.
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

#: Smallest share of the samples that a class must have for a fit, and for a balanced accuracy.
MIN_CLASS_SHARE = 0.02
#: Grid of the cross-validation: the penalty C of misclassified samples, and the kernel's gamma, for which the
#: kernel's product of two points of the box is at most 0.5, 1 or 2. A C of 1000 or a gamma of 1 was no more
#: accurate on 1000 samples, and took up to 30 s where classes overlap.
PENALTIES = (0.1, 1.0, 10.0, 100.0)
GAMMAS = (1.0 / 12.0, 1.0 / 6.0, 1.0 / 3.0)
#: Folds of the cross-validation.
FOLDS = 5


class Feasibility(eqx.Module):
    """Fitted boundary between physiological and other wrap parameters of one wrap.

    The score is ``s = sum_i weight_i (1 + gamma x_i . x)^3 + offset``, positive where parameters are not
    physiological. Parameters and support vectors ``x`` are scaled so that the sampled box is [-1, 1].
    """

    #: Support vectors ``x_i``, scaled.
    support: Float[Array, "support wrap_parameter"]
    #: Lagrange multipliers, positive for samples that are not physiological.
    weights: Float[Array, " support"]
    offset: Float[Array, ""]
    gamma: Float[Array, ""]
    #: Center and half width of the sampled box, in the parameters' units.
    center: Float[Array, " wrap_parameter"]
    half_range: Float[Array, " wrap_parameter"]
    #: Parameters M and B of the sigmoid.
    slope: Float[Array, ""]
    intercept: Float[Array, ""]

    def score(self, parameters: Float[Array, " wrap_parameter"]) -> Float[Array, ""]:
        """Decision value of the support vector machine, positive where parameters are not physiological."""
        scaled = (parameters - self.center) / self.half_range
        return self.weights @ (1.0 + self.gamma * (self.support @ scaled)) ** 3 + self.offset

    def probability(self, parameters: Float[Array, " wrap_parameter"]) -> Float[Array, ""]:
        """Probability that parameters are not physiological, ``P = 1 / (1 + exp(M s + B))``."""
        return jax.nn.sigmoid(-(self.slope * self.score(parameters) + self.intercept))

    def excess(self, parameters: Float[Array, " wrap_parameter"]) -> Float[Array, ""]:
        """Excess over the feasibility limit (dimensionless), at most zero where parameters are feasible.

        The limit is ``P <= P(s = 0)``. P increases with s, because M is negative for any machine that is
        better than chance. The limit is therefore the same as ``s <= 0``, independent of the sigmoid. The
        score is also the better constraint numerically: far outside the limit its gradient is large, while
        that of P vanishes.
        """
        return self.score(parameters)


@dataclass(frozen=True)
class FeasibilityQuality:
    """Accuracy of a wrap's feasibility limit on samples that it was not fitted to.

    Parameters
    ----------
    balanced_accuracy
        Mean of the shares of the two classes that are classified correctly; None if a class has less than
        2 % of the samples.
    false_physiological
        Share of the non-physiological samples that are feasible; None if all samples are physiological.
    """

    balanced_accuracy: float | None
    false_physiological: float | None


def feasibility_quality(
    feasibility: Feasibility | None,
    samples: Float[np.ndarray, "sample wrap_parameter"],
    physiological: Bool[np.ndarray, " sample"],
    usable: Bool[np.ndarray, " sample"] | None = None,
) -> FeasibilityQuality:
    """Compute the accuracy of a wrap's feasibility limit and exact margins on labeled samples.

    Parameters
    ----------
    feasibility
        Fitted feasibility; None for a wrap without a limit, for which all samples are feasible.
    samples
        Wrap parameters that the feasibility was not fitted to.
    physiological
        Label of each sample.
    usable
        Samples that the exact engine's margins allow; by default all.
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
    """Whether a class, physiological or not, has less than 2 % of the samples."""
    share = float(np.mean(physiological))
    return min(share, 1.0 - share) < MIN_CLASS_SHARE


def balanced_accuracy(
    allowed: Bool[np.ndarray, " sample"], physiological: Bool[np.ndarray, " sample"]
) -> float:
    """Mean of the share of physiological samples that are allowed and the share of others that are not."""
    return 0.5 * float(allowed[physiological].mean() + (~allowed[~physiological]).mean())


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
    """Fit a support vector machine with a cubic kernel, and the sigmoid from its score to a probability.

    The two classes have equal total weight. C and gamma are those of `PENALTIES` and `GAMMAS` for which the
    machine, combined with the exact margins, has the highest balanced accuracy in stratified
    cross-validation; ties go to the smallest C, then the smallest gamma. The sigmoid is fitted to the
    cross-validated scores, because scores of samples that a machine was fitted to are overconfident.

    Parameters
    ----------
    samples
        Wrap parameters.
    physiological
        Label of each sample.
    lower, upper
        Bounds of the sampled box, which is scaled to [-1, 1].
    usable
        Samples that the exact engine's margins allow; by default all.
    seed
        Seed of the assignment of samples to folds. Results of one seed are identical to the last bit.
    threads
        Number of threads of the cross-validation; by default a few more than there are cores.

    Returns
    -------
    Feasibility or None
        None if a class has less than 2 % of the samples or fewer samples than there are folds, which is too
        few for a fit.

    Raises
    ------
    ValueError
        If the box is empty. Parameters that are held have equal bounds.

    Notes
    -----
    A fit takes about a second for 1000 samples, and some seconds where the classes overlap much.
    """
    if not np.all(lower <= upper):
        raise ValueError(f"the box is empty: lower {lower}, upper {upper}")
    fewest = min(physiological.sum(), (~physiological).sum())
    if fewest < FOLDS or has_rare_class(physiological):
        return None
    center, half_range = 0.5 * (upper + lower), 0.5 * (upper - lower)
    # Parameters that are held are at the center.
    half_range = np.where(half_range > 0.0, half_range, 1.0)
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
    # Converted by NumPy first, because JAX gives plain Python numbers a weak type.
    return Feasibility(**{name: jnp.asarray(np.asarray(values)) for name, values in arrays.items()})


def fit_sigmoid(
    scores: Float[np.ndarray, " sample"], positive: Bool[np.ndarray, " sample"]
) -> tuple[float, float]:
    """Fit M and B of ``P = 1 / (1 + exp(M s + B))`` by maximum likelihood.

    After Platt (1999), the target probability is ``(n + 1) / (n + 2)`` for the n positive samples and
    ``1 / (m + 2)`` for the m negative samples. M is therefore finite also where scores separate the classes.

    Parameters
    ----------
    scores
        Decision values.
    positive
        Whether each sample is of the class whose probability is P.

    Returns
    -------
    slope, intercept
        M and B; M is negative if positive samples have the higher scores.
    """
    positives, negatives = int(positive.sum()), int((~positive).sum())
    target = np.where(positive, (positives + 1.0) / (positives + 2.0), 1.0 / (negatives + 2.0))
    # Scores are scaled to the order of one.
    scale = float(np.abs(scores).max())
    design = np.stack([scores / scale, np.ones_like(scores)], axis=1)

    def negative_log_likelihood(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        exponent = design @ parameters
        # -log P and -log(1 - P), without overflow.
        each = target * np.logaddexp(0.0, exponent) + (1.0 - target) * np.logaddexp(0.0, -exponent)
        return float(each.mean()), design.T @ (target - expit(-exponent)) / len(scores)

    def curvature(parameters: np.ndarray) -> np.ndarray:
        probability = expit(-(design @ parameters))
        return (design.T * (probability * (1.0 - probability))) @ design / len(scores)

    start = np.array([0.0, np.log((negatives + 1.0) / (positives + 1.0))])
    found = scipy.optimize.minimize(
        negative_log_likelihood,
        start,
        jac=True,
        hess=curvature,
        method="trust-exact",
        options={"gtol": 1e-13},
    )
    return float(found.x[0]) / scale, float(found.x[1])


def _cross_validated(
    scaled: Float[np.ndarray, "sample wrap_parameter"],
    physiological: Bool[np.ndarray, " sample"],
    usable: Bool[np.ndarray, " sample"],
    seed: int,
    threads: int | None,
) -> tuple[float, float, Float[np.ndarray, " sample"]]:
    """Choose C and gamma by cross-validation; return them and the cross-validated score of each sample."""
    from sklearn.model_selection import StratifiedKFold

    folds = list(StratifiedKFold(FOLDS, shuffle=True, random_state=seed).split(scaled, physiological))
    grid = list(product(PENALTIES, GAMMAS))

    def held_out_scores(choice: tuple[float, float]) -> Float[np.ndarray, " sample"]:
        scores = np.zeros(len(scaled))
        for others, left_out in folds:
            machine = _machine(*choice).fit(scaled[others], ~physiological[others])
            scores[left_out] = machine.decision_function(scaled[left_out])
        return scores

    best, chosen = -1.0, None
    with ThreadPoolExecutor(threads) as pool:  # libsvm releases the interpreter's lock
        scores_of_grid = pool.map(held_out_scores, grid)
    for (penalty, gamma), scores in zip(grid, scores_of_grid, strict=True):
        accuracy = balanced_accuracy(usable & (scores <= 0.0), physiological)
        if accuracy > best:
            best, chosen = accuracy, (penalty, gamma, scores)
    assert chosen is not None, "the grid is not empty"
    return chosen


def _machine(penalty: float, gamma: float) -> Any:
    from sklearn.svm import SVC

    return SVC(C=penalty, kernel="poly", degree=3, coef0=1.0, gamma=gamma, class_weight="balanced")
