"""Compliant tendon: equilibrium with the fibers, derivatives, and the limit of a rigid tendon."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from wrapjax.muscle.compliant_tendon import (
    FIBER_DAMPING,
    compliant_tendon_fiber,
    increasing_root,
    tendon_strain_curve,
)
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.hill import FiberState, rigid_tendon_fiber

CURVES = HILL_CURVES["paper"]
#: Plantar flexors: the tendon is five times as long as the fibers.
SIZES = {
    "max_isometric_force": 3000.0,
    "optimal_fiber_length": 0.05,
    "tendon_slack_length": 0.25,
    "pennation_angle": 0.4,
    "max_fiber_velocity": 10.0,
}
DURATION = 1.0


def activation_at(time):
    return 0.35 + 0.3 * np.sin(2 * np.pi * time - 1.0)


def length_at(time):
    return 0.305 + 0.012 * np.sin(2 * np.pi * time)


def velocity_at(time):
    return 0.012 * 2 * np.pi * np.cos(2 * np.pi * time)


def sizes():
    return {name: jnp.asarray(value) for name, value in SIZES.items()}


def signals(frames: int):
    time = np.linspace(0.0, DURATION, frames)[None]
    return tuple(jnp.asarray(of(time)) for of in (activation_at, length_at, velocity_at))


def compliant(strain, frames: int = 81) -> FiberState:
    step = jnp.array([DURATION / (frames - 1)])
    return jax.jit(compliant_tendon_fiber)(CURVES, *signals(frames), step, jnp.asarray(strain), **sizes())


def hill_force(activation, length, velocity, stretch, rate) -> float:
    """Compute the fiber force in maximum isometric forces by the published equations."""
    cosine = np.cos(SIZES["pennation_angle"])
    reach = SIZES["optimal_fiber_length"] * cosine
    fiber = (length - SIZES["tendon_slack_length"] - stretch) / reach
    fastest = SIZES["max_fiber_velocity"] * reach
    shortening = (velocity - rate) / fastest
    height, center, width, growth = CURVES.active_bumps.T
    at_length = np.sum(height * np.exp(-0.5 * ((fiber - center) / (width + growth * fiber)) ** 2))
    d1, d2, d3, d4, d5, d6 = CURVES.velocity
    at_velocity = d1 + d2 * np.arctan(d3 + d4 * np.arctan(d5 + d6 * shortening))
    e1, e2, e3 = CURVES.passive
    passive = e1 * np.log1p(np.exp(e2 * (fiber - e3))) - FIBER_DAMPING * rate / fastest
    return cosine * (activation * at_length * at_velocity + passive)


def integrated(strain: float, times) -> np.ndarray:
    """Compute the tendon force by integration of the rate of stretch with SciPy."""

    def force_of(stretch):
        return np.expm1(stretch / (strain * SIZES["tendon_slack_length"]) * np.log(9.0)) / 8.0

    def rate(time, stretch):
        now = activation_at(time), length_at(time), velocity_at(time)
        return brentq(
            lambda rate: hill_force(*now, stretch[0], rate) - force_of(stretch[0]), -5.0, 5.0, xtol=1e-12
        )

    at_rest = activation_at(0.0), length_at(0.0), velocity_at(0.0)
    highest = strain * SIZES["tendon_slack_length"] * 1.3
    start = brentq(lambda x: hill_force(*at_rest, x, 0.0) - force_of(x), 0.0, highest, xtol=1e-14)
    solved = solve_ivp(rate, (0.0, DURATION), [start], "LSODA", times, rtol=1e-7, atol=1e-10)
    return SIZES["max_isometric_force"] * force_of(solved.y[0])


def test_force_satisfies_the_differential_equation():
    """The error is of second order in the step: half a newton at 12 ms, a quarter of that at 6 ms."""
    coarse, fine = (np.asarray(compliant(0.04, frames).tendon_force[0]) for frames in (81, 161))
    expected = integrated(0.04, np.linspace(0.0, DURATION, 81))
    rigid = np.asarray(compliant(0.0).tendon_force[0])
    errors = [np.abs(found - expected)[10:].max() for found in (coarse, fine[::2])]
    assert errors[0] < 1.0 < 200.0 < np.abs(rigid - expected).max()
    assert errors[1] < 0.3 * errors[0]


def test_fibers_and_tendon_carry_the_same_force():
    state = compliant(0.06)
    force = state.tendon_force[0] / SIZES["max_isometric_force"]
    stretch = 0.06 * SIZES["tendon_slack_length"] * tendon_strain_curve(force)
    reach = SIZES["optimal_fiber_length"] * np.cos(SIZES["pennation_angle"])
    left = length_at(np.linspace(0.0, DURATION, 81)) - SIZES["tendon_slack_length"] - stretch
    np.testing.assert_allclose(state.normalized_length[0], left / reach, rtol=1e-11)


def test_zero_strain_equals_the_rigid_tendon_to_the_last_bit():
    found = compliant_tendon_fiber(CURVES, *signals(21), jnp.array([0.05]), jnp.array(0.0), **sizes())
    rigid = rigid_tendon_fiber(CURVES, *signals(21), **sizes())
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(rigid), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("strain", [0.0, 0.05])
def test_first_and_second_derivatives_equal_finite_differences(strain):
    def force(strain):
        return jnp.sum(compliant(strain, 41).tendon_force ** 2) * 1e-6

    slope = jax.jit(jax.grad(force))
    step = 1e-5
    difference = (force(strain + step) - force(strain - step)) / (2 * step)
    np.testing.assert_allclose(slope(strain), difference, rtol=1e-5)
    curvature = jax.jit(jax.jacfwd(jax.jacfwd(force)))(strain)
    difference = (slope(strain + step) - slope(strain - step)) / (2 * step)
    np.testing.assert_allclose(curvature, difference, rtol=1e-4)


def test_root_is_found_and_differentiated_where_newton_alone_fails():
    """Newton steps for an arctangent leave the bracket far from its root."""
    ones = jnp.ones(3)
    zero = jnp.array([-3.0, 0.0, 40.0])

    def root(at):
        return increasing_root(
            lambda x: jnp.arctan(20.0 * (x - at)), 90.0 * ones, -100.0 * ones, 100.0 * ones
        )

    np.testing.assert_allclose(root(zero), zero, atol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(root)(zero), np.eye(3), atol=1e-12)


def test_extreme_inputs_give_finite_forces():
    """Inactive, slack, very long, and discontinuous inputs."""
    frames = 15
    generator = np.random.default_rng(0)
    activation = jnp.asarray(generator.choice([0.0, 1.0], (6, frames)))
    length = jnp.asarray(generator.uniform(0.2, 0.4, (6, frames)))
    velocity = jnp.asarray(generator.uniform(-1.0, 1.0, (6, frames)))
    step = jnp.full(6, 0.01)

    def force(strain):
        return compliant_tendon_fiber(
            CURVES, activation, length, velocity, step, strain, **sizes()
        ).tendon_force

    value, slope = jax.jvp(jax.jit(force), (jnp.array(0.1),), (jnp.array(1.0),))
    assert np.isfinite(value).all() and np.isfinite(slope).all()
