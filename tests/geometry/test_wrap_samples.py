"""Tests of samples of wrap parameters and of their bounds."""

from types import SimpleNamespace

import numpy as np
import pytest

from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.wrapping import NOMINAL
from wrapjax.geometry.surrogates import wrap_bounds
from wrapjax.geometry.surrogates.training_samples import plan_samples
from wrapjax.geometry.surrogates.wrap_bounds import parameter_box

WRAPS = {
    "psoas": ("brim",),
    "gaslat": ("lateral_shank", "condyles"),
    "gasmed": ("medial_shank", "condyles"),
    "vasti": ("femur",),
}
TRANSLATIONS = {"brim": 0.004, "condyles": 0.01, "femur": 0.01, "lateral_shank": 0.01, "medial_shank": 0.002}


@pytest.fixture(scope="module")
def plans():
    return plan_samples(WRAPS, TRANSLATIONS, seed=3)


def test_samples_fill_their_boxes(plans):
    for plan, count in zip(plans, (1000, 250), strict=True):
        for wrap, samples in plan.together.moved.items():
            lower, upper = parameter_box(TRANSLATIONS[wrap])
            scaled = (samples - lower) / (upper - lower)
            assert scaled.shape == (count, 6) and (scaled > -1e-12).all() and (scaled < 1.0 + 1e-12).all()
            # Every tenth of every axis has about a tenth of the samples.
            shares = [np.histogram(column, 10, (0.0, 1.0))[0] / count for column in scaled.T]
            assert np.abs(np.array(shares) - 0.1).max() < 0.02


def test_validation_samples_differ_from_training_samples(plans):
    training, validation = (plan.together.moved["brim"] for plan in plans)
    nearest = np.abs(validation[:, None] - training[None]).max(axis=2).min(axis=1)
    assert nearest.min() > 1e-5


def test_parameters_of_wraps_of_one_muscle_are_uncorrelated(plans):
    parameters = plans[0].together.parameters(WRAPS["gaslat"])
    correlation = np.corrcoef(parameters.reshape(1000, 12).T)
    assert np.abs(correlation - np.eye(12)).max() < 0.12


def test_wraps_of_muscles_with_several_are_also_changed_alone(plans):
    """The samples of a wrap are the same in all sets, so that muscles which share it are comparable."""
    for plan in plans:
        for muscle in ("gaslat", "gasmed"):
            for place, wrap in enumerate(WRAPS[muscle]):
                samples = plan.samples_for(muscle, wrap, WRAPS[muscle])
                parameters = samples.parameters(WRAPS[muscle])
                np.testing.assert_array_equal(parameters[:, place], plan.together.moved[wrap])
                assert (parameters[:, 1 - place] == NOMINAL).all()
        assert len(plan.alone) == 2
        assert plan.samples_for("psoas", "brim", WRAPS["psoas"]) is plan.together


@pytest.mark.parametrize(
    "reach, expected",
    [
        (0.5, 0.02),
        (0.016, 0.02),
        (0.0125, 0.015),
        (0.008, 0.01),
        (0.004, 0.0075),
        (0.003, 0.005),
        (1e-4, 0.005),
    ],
)
def test_translation_bound_depends_on_the_share_of_usable_samples(monkeypatch, reach, expected):
    """Samples are usable if they translate along x by at most ``reach``, so that a box's share is known."""
    monkeypatch.setattr(
        wrap_bounds,
        "usable_for_all_muscles",
        lambda engine, posed, wrap, samples: np.abs(samples[:, 0]) <= reach,
    )
    engine = object.__new__(ExactPaths)
    brim = SimpleNamespace(name="brim", kind="WrapCylinder", active=True)
    engine.model = SimpleNamespace(wrap=lambda name: brim, wraps=(brim,))
    assert wrap_bounds.translation_bounds(engine, {}, ["brim"]) == {"brim": expected}
