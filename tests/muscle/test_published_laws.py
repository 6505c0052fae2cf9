"""Published muscle laws and the nearest points of the family."""

import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.personal_law import LAW_NAMES, LAW_PARAMETERS, PersonalCurves, personal_shape
from wrapjax.muscle.published_laws import GIVEN_LAW, PUBLISHED_LAWS, nearest_law

LENGTHS, VELOCITIES = np.linspace(0.5, 1.5, 41), np.linspace(-0.9, 0.9, 41)


@pytest.mark.parametrize("curves", sorted(HILL_CURVES))
def test_the_given_law_is_zero(curves):
    np.testing.assert_array_equal(nearest_law(GIVEN_LAW, curves), 0.0)


def test_curves_have_the_landmarks_of_their_publications():
    thelen, de_groote = PUBLISHED_LAWS["thelen"], PUBLISHED_LAWS["de_groote"]
    # Thelen 2003: active curve of width 0.45, Af 0.25, plateau 1.4, strain 0.6 at the maximum force.
    half = 1.0 + np.sqrt(0.45 * np.log(2.0))
    np.testing.assert_allclose(thelen.active_force(np.array([1.0, half])), [1.0, 0.5])
    velocities = np.array([-1.0, -0.5, 0.0, 1e6])
    np.testing.assert_allclose(thelen.force_velocity(velocities), [0.0, 0.5 / 3.0, 1.0, 1.4], atol=1e-4)
    np.testing.assert_allclose(thelen.passive_force(np.array([0.8, 1.0, 1.6])), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(de_groote.force_velocity(np.array([-1.0, 0.0])), [0.0, 1.0], atol=0.02)
    np.testing.assert_allclose(PUBLISHED_LAWS["ceinms"].shape(np.array([0.0, 1.0])), [0.0, 1.0])


@pytest.mark.parametrize(
    ("name", "largest"), [("de_groote", 0.04), ("thelen", 0.07), ("ceinms", 0.01), (GIVEN_LAW, 1e-12)]
)
def test_the_nearest_point_reproduces_the_law(name, largest):
    law, values = PUBLISHED_LAWS[name], nearest_law(name)
    for parameter, value in zip(LAW_PARAMETERS, values, strict=True):
        assert parameter.lower <= value <= parameter.upper
    family = PersonalCurves(HILL_CURVES["paper"], jnp.asarray(values))
    found = [
        (family.active_force, law.active_force, LENGTHS),
        (family.force_velocity, law.force_velocity, VELOCITIES),
        (family.passive_force, law.passive_force, LENGTHS[LENGTHS > 1.0]),
        (lambda a: personal_shape(a, jnp.asarray(values)), law.shape, np.linspace(0.0, 1.0, 21)),
    ]
    for of_family, published, x in found:
        if published is not None:
            np.testing.assert_allclose(of_family(jnp.asarray(x)), published(x), atol=largest)


def test_published_dynamics_are_those_of_the_law():
    assert nearest_law("thelen")[LAW_NAMES.index("directional_rate")] == 1.0
    assert nearest_law("ceinms")[LAW_NAMES.index("directional_rate")] == 0.0


def test_an_unknown_law_is_refused():
    with pytest.raises(KeyError):
        nearest_law("millard")
