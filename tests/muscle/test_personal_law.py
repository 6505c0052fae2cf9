"""The continuous muscle law: the given law at zero, smooth, with the physical properties that curves need."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.muscle.activation import neural_activation
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.personal_law import (
    LAW_NAMES,
    LAW_PARAMETERS,
    PersonalCurves,
    given_law,
    personal_neural_activation,
    personal_shape,
)

CURVES = HILL_CURVES["paper"]
LENGTHS = jnp.linspace(0.4, 1.7, 53)
VELOCITIES = jnp.linspace(-1.0, 1.0, 53)
STEP = jnp.array([0.01, 0.013])


def law_with(**values) -> jnp.ndarray:
    law = np.zeros(len(LAW_NAMES))
    for name, value in values.items():
        law[LAW_NAMES.index(name)] = value
    return jnp.asarray(law)


def excitation():
    time = np.arange(140.0)
    burst = np.exp(-0.5 * ((time - 60.0) / 12.0) ** 2)
    return jnp.asarray(np.stack([0.02 + 0.6 * burst, 0.02 + 0.3 * burst]))


def test_zero_is_the_given_law():
    law = jnp.asarray(given_law(3)[0])
    curves = PersonalCurves(CURVES, law)
    np.testing.assert_array_equal(curves.active_force(LENGTHS), CURVES.active_force(LENGTHS))
    np.testing.assert_array_equal(curves.passive_force(LENGTHS), CURVES.passive_force(LENGTHS))
    np.testing.assert_array_equal(curves.force_velocity(VELOCITIES), CURVES.force_velocity(VELOCITIES))
    plain = neural_activation(excitation(), jnp.asarray(0.015), STEP)
    own = personal_neural_activation(excitation(), jnp.asarray(0.015), STEP, 4.0, law)
    np.testing.assert_allclose(own, plain, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(personal_shape(plain.clip(0.0), law), plain.clip(0.0))


@pytest.mark.parametrize("parameter", LAW_PARAMETERS, ids=LAW_NAMES)
def test_derivatives_by_each_parameter_agree_with_differences(parameter):
    def outputs(value):
        law = jnp.zeros(len(LAW_NAMES)).at[LAW_NAMES.index(parameter.name)].set(value)
        curves = PersonalCurves(CURVES, law)
        neural = personal_neural_activation(excitation(), jnp.asarray(0.015), STEP, 4.0, law)
        parts = (
            curves.active_force(LENGTHS),
            curves.passive_force(LENGTHS),
            curves.force_velocity(VELOCITIES),
            personal_shape(jnp.maximum(neural, 0.0), law).ravel(),
        )
        return jnp.concatenate(parts)

    at, h = 0.3 * parameter.upper, 1e-6
    slope = jax.jacfwd(outputs)(jnp.asarray(at))
    difference = (outputs(at + h) - outputs(at - h)) / (2.0 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=2e-7)
    assert np.abs(slope).max() > 1e-3


@pytest.mark.parametrize("place", range(len(LAW_PARAMETERS)), ids=LAW_NAMES)
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_curves_at_the_bounds_are_those_of_a_muscle(place, end):
    law = jnp.zeros(len(LAW_NAMES)).at[place].set(getattr(LAW_PARAMETERS[place], end))
    curves = PersonalCurves(CURVES, law)
    active, passive, velocity = (
        np.asarray(values)
        for values in (
            curves.active_force(LENGTHS),
            curves.passive_force(LENGTHS),
            curves.force_velocity(VELOCITIES),
        )
    )
    assert (active > -0.02).all() and active.max() < 1.05 and abs(LENGTHS[active.argmax()] - 1.0) < 0.25
    assert (np.diff(passive) >= 0.0).all() and (passive >= 0.0).all()
    assert (np.diff(velocity) > -1e-3).all()
    np.testing.assert_allclose(curves.force_velocity(jnp.zeros(1)), CURVES.force_velocity(jnp.zeros(1)))
    neural = np.asarray(personal_neural_activation(excitation(), jnp.asarray(0.015), STEP, 4.0, law))
    assert np.isfinite(neural).all() and neural.max() < 0.65 and neural.min() > -0.02


def test_slow_deactivation_prolongs_and_a_second_stage_delays_the_onset():
    # A step of excitation, and its end.
    steps = jnp.zeros((2, 120)).at[:, 20:60].set(0.6)

    def response(**values):
        law = law_with(**values)
        return np.asarray(personal_neural_activation(steps, jnp.asarray(0.03), STEP, 4.0, law))[0]

    plain, slow, staged = response(), response(deactivation_ratio=0.8), response(second_stage=1.0)
    assert (slow[62:80] > plain[62:80]).all()
    assert staged[20] < 0.5 * plain[20], "two stages rise from rest with a slope of zero"
    np.testing.assert_allclose(staged[58], plain[58], rtol=0.05)


def test_shape_keeps_rest_and_full_activation():
    ends = jnp.array([0.0, 1.0])
    for name in ("shape_exponent", "shape_saturation"):
        np.testing.assert_allclose(personal_shape(ends, law_with(**{name: 0.4})), ends, atol=1e-12)
    middle = personal_shape(jnp.array([0.4]), law_with(shape_saturation=1.0))
    np.testing.assert_allclose(middle, [0.8 / 1.4])
