"""Tests of the feasibility of wrap parameters: score, probability, cross-validation and accuracy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from scipy.special import expit
from scipy.stats import qmc

from wrapjax.geometry.surrogates import feasibility
from wrapjax.geometry.surrogates.feasibility import (
    FOLDS,
    GAMMAS,
    PENALTIES,
    Feasibility,
    feasibility_quality,
    fit_feasibility,
    fit_sigmoid,
)

LOWER = np.array([-0.01, -0.01, -0.02, -0.35, -0.35, 0.8])
UPPER = np.array([0.01, 0.03, 0.01, 0.35, 0.35, 1.2])
CENTER, HALF_RANGE = 0.5 * (UPPER + LOWER), 0.5 * (UPPER - LOWER)


def samples_of(count, seed):
    return qmc.scale(qmc.Halton(6, seed=seed).random(count), LOWER, UPPER)


def physiological_of(samples, limit=0.3):
    """Synthetic criterion: not too far forward, and not rotated while the radius is large."""
    x = (samples - CENTER) / HALF_RANGE
    return (x[:, 0] + 0.3 * x[:, 3] ** 2 < limit) & (x[:, 5] * x[:, 4] + 0.2 * x[:, 1] < 0.5)


@pytest.fixture(scope="module")
def training():
    samples = samples_of(400, seed=1)
    return samples, physiological_of(samples)


@pytest.fixture(scope="module")
def fitted(training):
    return fit_feasibility(*training, LOWER, UPPER, seed=3)


@pytest.fixture(scope="module")
def validation():
    samples = samples_of(500, seed=2)
    return samples, physiological_of(samples)


def machine_of(training, gamma, penalty):
    """Support vector machine of scikit-learn, fitted separately."""
    from sklearn.svm import SVC

    samples, physiological = training
    machine = SVC(C=penalty, kernel="poly", degree=3, coef0=1.0, gamma=gamma, class_weight="balanced")
    return machine.fit((samples - CENTER) / HALF_RANGE, np.where(physiological, -1, 1))


def scores_of(feasibility, samples):
    return np.asarray(jax.vmap(feasibility.score)(jnp.asarray(samples)))


def test_score_is_scikit_learns_decision_function(fitted, training, validation):
    gamma = float(fitted.gamma)
    assert gamma in GAMMAS
    scores = scores_of(fitted, validation[0])
    differences = []
    for penalty in PENALTIES:
        machine = machine_of(training, gamma, penalty)
        decisions = machine.decision_function((validation[0] - CENTER) / HALF_RANGE)
        differences.append(np.abs(scores - decisions).max())
    assert min(differences) < 1e-10
    assert sorted(differences)[1] > 1e-3
    assert np.abs(scores).max() > 1.0


def test_chosen_constants_are_the_best_of_the_grid_in_cross_validation(fitted, training):
    from sklearn.metrics import balanced_accuracy_score
    from sklearn.model_selection import StratifiedKFold, cross_val_predict

    samples, physiological = training
    scaled = (samples - CENTER) / HALF_RANGE
    folds = StratifiedKFold(FOLDS, shuffle=True, random_state=3)
    accuracy = {
        (penalty, gamma): balanced_accuracy_score(
            physiological,
            cross_val_predict(feasibility._machine(penalty, gamma), scaled, physiological, cv=folds),
        )
        for penalty in PENALTIES
        for gamma in GAMMAS
    }
    penalty, gamma = max(accuracy, key=accuracy.get)
    assert gamma == float(fitted.gamma)
    np.testing.assert_array_equal(machine_of(training, gamma, penalty).dual_coef_[0], fitted.weights)
    assert len(set(accuracy.values())) > 5


def test_ties_go_to_the_smallest_constants(training):
    samples = training[0][np.abs(training[0][:, 0]) > 0.4 * HALF_RANGE[0]]
    clear = samples, samples[:, 0] < 0.0
    found = fit_feasibility(*clear, LOWER, UPPER)
    np.testing.assert_array_equal(found.weights, machine_of(clear, GAMMAS[0], PENALTIES[0]).dual_coef_[0])


def test_validation_samples_are_classified_accurately(fitted, validation):
    quality = feasibility_quality(fitted, *validation)
    # Chance gives 0.5 and 0.5.
    assert quality.balanced_accuracy > 0.9
    assert quality.false_physiological < 0.12
    physiological = validation[1]
    allowed = scores_of(fitted, validation[0]) <= 0.0
    assert quality.false_physiological == np.sum(allowed & ~physiological) / np.sum(~physiological)
    assert allowed[physiological].mean() > 0.9


@pytest.mark.parametrize("method", ["score", "probability", "excess"])
def test_gradient_equals_differences(fitted, method):
    function = getattr(fitted, method)
    for parameters in jnp.asarray(samples_of(5, seed=7)):
        gradient = jax.jit(jax.grad(function))(parameters)
        for number, step in enumerate(1e-5 * HALF_RANGE):
            change = step * jnp.eye(6)[number]
            difference = (function(parameters + change) - function(parameters - change)) / (2.0 * step)
            np.testing.assert_allclose(gradient[number], difference, rtol=1e-6, atol=1e-5)
    assert np.abs(gradient).max() > 0.1


def test_limit_of_probability_is_the_limit_of_score(fitted, validation):
    samples = jnp.asarray(validation[0])
    probability = np.asarray(jax.vmap(fitted.probability)(samples))
    score = scores_of(fitted, samples)
    np.testing.assert_allclose(
        probability, 1.0 / (1.0 + np.exp(fitted.slope * score + fitted.intercept)), rtol=1e-12
    )
    at_zero = 1.0 / (1.0 + np.exp(fitted.intercept))
    excess = np.asarray(jax.vmap(fitted.excess)(samples))
    np.testing.assert_array_equal(probability <= at_zero, excess <= 0.0)
    assert 0.1 < (excess <= 0.0).mean() < 0.9


def test_sigmoid_is_fitted_to_cross_validated_scores(training, fitted):
    from sklearn.model_selection import StratifiedKFold, cross_val_predict

    samples, physiological = training
    folds = StratifiedKFold(FOLDS, shuffle=True, random_state=3)
    scaled = (samples - CENTER) / HALF_RANGE
    sigmoids = []
    for penalty in PENALTIES:
        machine = feasibility._machine(penalty, float(fitted.gamma))
        scores = cross_val_predict(machine, scaled, ~physiological, cv=folds, method="decision_function")
        sigmoids.append(fit_sigmoid(scores, ~physiological))
    assert (float(fitted.slope), float(fitted.intercept)) in sigmoids
    overconfident, _ = fit_sigmoid(scores_of(fitted, samples), ~physiological)
    assert overconfident < 1.2 * fitted.slope


def test_probability_is_calibrated_on_validation_samples(fitted, validation):
    """Predicted probabilities equal frequencies in samples that the machine was not fitted to."""
    samples, physiological = validation
    probability = np.asarray(jax.vmap(fitted.probability)(jnp.asarray(samples)))
    assert abs(probability.mean() - (~physiological).mean()) < 0.05
    unsure = (probability > 0.2) & (probability < 0.8)
    assert unsure.sum() > 20
    assert abs(probability[unsure].mean() - (~physiological[unsure]).mean()) < 0.15


def overlapping(seed, count=300):
    random = np.random.default_rng(seed)
    positive = random.random(count) < 0.3
    return random.normal(np.where(positive, 0.8, -0.6), 1.0), positive


def separable(seed):
    scores, positive = overlapping(seed)
    return np.where(positive, 1.0 + np.abs(scores), -1.0 - np.abs(scores)), positive


@pytest.mark.parametrize("make", [overlapping, separable])
@pytest.mark.parametrize("size", [1.0, 1e4, 1e-3])
def test_sigmoid_maximizes_the_likelihood(make, size):
    scores, positive = make(0)
    slope, intercept = fit_sigmoid(scores * size, positive)
    n, m = positive.sum(), (~positive).sum()
    target = np.where(positive, (n + 1) / (n + 2), 1 / (m + 2))

    def negative_log_likelihood(parameters):
        probability = 1.0 / (1.0 + np.exp(parameters[0] * scores + parameters[1]))
        return -np.sum(target * np.log(probability) + (1 - target) * np.log(1 - probability))

    direct = scipy.optimize.minimize(
        negative_log_likelihood,
        [-1.0, 0.0],
        method="Nelder-Mead",
        options={"xatol": 1e-10, "fatol": 1e-13, "maxiter": 5000},
    )
    np.testing.assert_allclose([slope * size, intercept], direct.x, rtol=1e-5, atol=1e-5)
    assert slope < 0.0
    # The gradient of the likelihood is zero at its maximum.
    difference = target - expit(-(slope * scores * size + intercept))
    np.testing.assert_allclose([difference.sum(), difference @ scores], 0.0, atol=1e-8)


@pytest.mark.parametrize("rare", [False, True])
@pytest.mark.parametrize(
    ("share", "is_fitted"), [(0.0, False), (0.01, False), (0.0175, False), (0.02, True), (0.1, True)]
)
def test_a_rare_class_gives_no_machine(training, rare, share, is_fitted):
    samples, _ = training
    order = np.argsort(samples[:, 0])
    physiological = np.full(len(samples), not rare)
    physiological[order[: round(share * len(samples))]] = rare
    found = fit_feasibility(samples, physiological, LOWER, UPPER)
    assert isinstance(found, Feasibility) == is_fitted
    quality = feasibility_quality(found, samples, physiological)
    assert (quality.balanced_accuracy is not None) == is_fitted
    if share == 0.0:
        assert quality.false_physiological == (1.0 if rare else None)


def test_fewer_samples_of_a_class_than_folds_give_no_machine(training):
    samples, physiological = training[0][:40], np.arange(40) >= FOLDS
    assert fit_feasibility(samples, physiological, LOWER, UPPER) is not None
    physiological[0] = True
    assert fit_feasibility(samples, physiological, LOWER, UPPER) is None


def test_a_wrap_without_a_machine_allows_all_samples(validation):
    quality = feasibility_quality(None, *validation)
    assert (quality.balanced_accuracy, quality.false_physiological) == (0.5, 1.0)


def test_feasibility_does_not_depend_on_units(training, fitted, validation):
    units = np.array([1e3, 1e3, 1e3, 180.0 / np.pi, 180.0 / np.pi, 100.0])
    shift = np.array([3.0, 0.0, -1.0, 10.0, 0.0, -100.0])
    other = fit_feasibility(
        training[0] * units + shift, training[1], LOWER * units + shift, UPPER * units + shift, seed=3
    )
    np.testing.assert_allclose(
        scores_of(other, validation[0] * units + shift), scores_of(fitted, validation[0]), rtol=0, atol=1e-9
    )
    moved = feasibility_quality(other, validation[0] * units + shift, validation[1])
    assert moved == feasibility_quality(fitted, *validation)


def test_one_seed_gives_identical_results(training, fitted):
    again = fit_feasibility(*training, LOWER, UPPER, seed=3)
    for one, other in zip(jax.tree.leaves(fitted), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    shuffled = fit_feasibility(*training, LOWER, UPPER, seed=4)
    assert float(shuffled.slope) != float(fitted.slope)


def test_an_empty_box_is_an_error(training):
    with pytest.raises(ValueError, match="the box is empty"):
        fit_feasibility(*training, UPPER, LOWER)
