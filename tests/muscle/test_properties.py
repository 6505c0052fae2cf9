"""Properties of the muscle model for all parameters: bounds, monotonicity, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from wrapjax.muscle.activation import muscle_activation, neural_activation
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.excitation import fit_emg_spline
from wrapjax.muscle.hill import rigid_tendon_fiber

# One shape for all tests: each new shape would be compiled again.
TRIALS, FRAMES = 2, 60
STEPS = np.array([0.010, 0.013])
TIME = STEPS[:, None] * np.arange(FRAMES) + np.array([[0.4], [-1.0]])
CURVES = pytest.mark.parametrize("curves", HILL_CURVES.values(), ids=HILL_CURVES.keys())
REPEATABLE = settings(max_examples=60, deadline=None, derandomize=True)

activate = jax.jit(neural_activation)
mix = jax.jit(muscle_activation)


def smooth(time: np.ndarray) -> np.ndarray:
    """Compute smooth envelopes of two channels, one per row."""
    return np.stack([0.5 + 0.4 * np.sin(9.0 * time), 0.3 + 0.2 * np.cos(5.0 * time + 1.0)], axis=1)


# ---- Activation dynamics

#: Largest overshoot of activation by the discretisation, where frames are longer than the time constant.
OVERSHOOT = 0.02


@REPEATABLE
@given(
    excitation=arrays(float, (TRIALS, FRAMES), elements=st.floats(0.0, 1.0)),
    constant=st.floats(0.0075, 0.035),
)
def test_activation_stays_within_its_bounds(excitation, constant):
    neural = activate(jnp.asarray(excitation), jnp.asarray(constant), jnp.asarray(STEPS))
    assert np.isfinite(neural).all()
    assert neural.min() >= -1e-12 and neural.max() <= 1.0 + OVERSHOOT


@REPEATABLE
@given(
    level=st.floats(0.0, 1.0),
    constant=st.floats(0.0075, 0.035),
)
def test_activation_converges_to_a_constant_excitation(level, constant):
    """Two seconds are 14 times the slowest time constant."""
    held = jnp.full((TRIALS, 200), level)
    neural = activate(held, jnp.asarray(constant), jnp.asarray(STEPS))
    np.testing.assert_allclose(neural[:, -1], level, atol=1e-4)


def test_activation_is_the_solution_of_its_differential_equation():
    """Compare with the adaptive integration of SciPy for a smooth burst, at short steps."""
    step, constant = 0.0005, 0.02
    time = step * np.arange(1200)
    burst = np.where(time < 0.01, 0.0, np.sin(np.pi * np.clip((time - 0.01) / 0.4, 0.0, 1.0)) ** 2)
    neural = activate(jnp.asarray(burst[None]), jnp.asarray(constant), jnp.asarray([step]))[0]

    def rate(t, a):
        e = np.interp(t, time, burst)
        return (0.75 / constant * e + 0.25 / constant) * (e - a)

    exact = solve_ivp(rate, (0.0, time[-1]), [0.0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=step)
    np.testing.assert_allclose(neural, exact.y[0], atol=2e-4)


def test_activation_rises_faster_than_it_falls():
    pulse = jnp.zeros((TRIALS, 200)).at[:, 2:100].set(1.0)
    neural = np.asarray(activate(pulse, jnp.asarray(0.03), jnp.asarray(STEPS)))[0]
    rise = np.argmax(neural > 0.63) - 2
    fall = np.argmax(neural[100:] < 0.37)
    # In frames of 10 ms, rounded up.
    assert rise == pytest.approx(3, abs=1) and fall == pytest.approx(12, abs=1)


# ---- Delay


@pytest.fixture(scope="module")
def spline():
    """Splines of both channels; the leading axis is ``channel``."""
    return fit_emg_spline(TIME, smooth(TIME))


@jax.jit
def shift(spline, delay):
    return jax.vmap(lambda channel: channel.at_delay(delay))(spline)


def test_zero_delay_gives_the_samples(spline):
    np.testing.assert_allclose(shift(spline, 0.0), np.moveaxis(smooth(TIME), 1, 0), rtol=0, atol=1e-13)


#: Delays, also of whole knot steps: there frames coincide with knots, and rounding selects one of two
#: cubics.
DELAYS = st.one_of(
    st.floats(0.0, 0.125),
    st.builds(lambda step, count: float(step * count), st.sampled_from(STEPS), st.integers(0, 9)),
)


def check_shift(found, delay: float) -> None:
    """Compare with SciPy's spline, and with the first value before the first sample."""
    for trial in range(TRIALS):
        samples = smooth(TIME)[trial]
        earlier = TIME[trial] - delay
        expected = CubicSpline(TIME[trial], samples, axis=-1)(np.maximum(earlier, TIME[trial, 0]))
        np.testing.assert_allclose(found[:, trial], expected, rtol=0, atol=1e-12)
        before = earlier < TIME[trial, 0] - 1e-9
        first = np.broadcast_to(samples[:, :1], (2, before.sum()))
        np.testing.assert_allclose(found[:, trial, before], first, rtol=0, atol=1e-13)


@REPEATABLE
@given(delay=DELAYS)
def test_delay_evaluates_the_spline_at_earlier_times(spline, delay):
    check_shift(np.asarray(shift(spline, delay)), delay)


def test_delay_longer_than_the_recording_holds_the_first_value(spline):
    first = np.broadcast_to(np.moveaxis(smooth(TIME), 1, 0)[..., :1], (2, TRIALS, FRAMES))
    np.testing.assert_allclose(shift(spline, 5.0), first, rtol=0, atol=1e-13)


@REPEATABLE
@given(delay=st.floats(0.001, 0.12))
def test_delay_is_differentiable(spline, delay):
    """The derivative by the delay is minus the derivative in time."""
    _, slope = jax.jvp(lambda own: shift(spline, own), (delay,), (1.0,))
    for trial in range(TRIALS):
        earlier = TIME[trial] - delay
        inside = earlier > TIME[trial, 0] + 1e-9
        expected = -CubicSpline(TIME[trial], smooth(TIME)[trial], axis=-1)(earlier, 1)
        np.testing.assert_allclose(np.asarray(slope)[:, trial, inside], expected[:, inside], atol=1e-10)


# ---- Nonlinearity


@pytest.mark.parametrize("nonlinearity", [0.0, 0.1, 0.35])
def test_nonlinearity_maps_zero_and_one_to_themselves(nonlinearity):
    """The rational fit deviates by 2e-7."""
    ends = mix(jnp.array([0.0, 1.0]), jnp.asarray(nonlinearity))
    np.testing.assert_allclose(ends, [0.0, 1.0], atol=1e-6)


@REPEATABLE
@given(nonlinearity=st.floats(0.0, 0.35))
def test_nonlinearity_is_monotone_and_not_below_the_identity(nonlinearity):
    neural = jnp.linspace(0.0, 1.0, 501)
    activation = np.asarray(mix(neural, jnp.asarray(nonlinearity)))
    assert (np.diff(activation) > 0.0).all()
    assert (activation >= np.asarray(neural) - 1e-6).all() and (activation <= 1.0 + 1e-6).all()


def test_zero_nonlinearity_is_the_identity():
    neural = jnp.linspace(0.0, 1.0, 11)
    np.testing.assert_array_equal(mix(neural, jnp.asarray(0.0)), neural)


# ---- Hill curves


@CURVES
def test_active_force_is_largest_near_optimal_length(curves):
    length = np.linspace(0.0, 2.0, 2001)
    force = np.asarray(curves.active_force(jnp.asarray(length)))
    assert force[1000] == pytest.approx(1.0, abs=1e-2)
    assert force.max() == pytest.approx(1.0, abs=1e-2)
    assert abs(length[force.argmax()] - 1.0) < 0.05
    # No active force at lengths without overlap of the filaments.
    assert (force >= 0.0).all() and force[0] < 0.1 and force[-1] < 0.05


@CURVES
def test_force_velocity_is_monotone_between_its_known_points(curves):
    velocity = jnp.linspace(-1.0, 1.0, 401)
    factor = np.asarray(curves.force_velocity(velocity))
    assert (np.diff(factor) > 0.0).all()
    assert factor[0] == pytest.approx(0.0, abs=2e-3)  # no force at the fastest shortening
    assert factor[200] == pytest.approx(1.0, abs=2e-3)  # isometric
    assert 1.3 < factor[-1] < 1.6  # lengthening


@CURVES
def test_passive_force_increases(curves):
    length = jnp.linspace(0.2, 2.0, 901)
    force = np.asarray(curves.passive_force(length))
    assert (np.diff(force) > 0.0).all()
    assert force[0] < 1e-5
    assert np.asarray(curves.passive_force(jnp.asarray(1.4))) == pytest.approx(0.28, abs=0.01)


@CURVES
@pytest.mark.parametrize("length", [50.0, 1e4, -50.0])
def test_passive_force_and_its_derivative_are_finite_at_extreme_lengths(curves, length):
    """Trial steps of a solver may give extreme lengths, where exp(600) would overflow."""
    force, slope = jax.value_and_grad(curves.passive_force)(length)
    assert np.isfinite(force) and np.isfinite(slope)
    e1, e2, e3 = curves.passive
    np.testing.assert_allclose(force, max(0.0, e1 * e2 * (length - e3)), rtol=1e-12, atol=1e-12)


# ---- Fiber

MUSCLE = {
    "max_isometric_force": 1500.0,
    "optimal_fiber_length": 0.06,
    "tendon_slack_length": 0.29,
    "pennation_angle": 0.3,
    "max_fiber_velocity": 10.0,
}
ACTIVATION = np.array([[0.0, 0.2, 0.5, 1.0], [0.3, 0.7, 0.1, 0.9]])
LENGTH = 0.29 + 0.06 * np.cos(0.3) * np.array([[0.6, 0.9, 1.0, 1.2], [1.4, 0.8, 1.1, 1.05]])
VELOCITY = np.array([[0.0, -0.2, 0.3, -0.05], [0.1, -0.4, 0.0, 0.2]])


def fiber(curves, parameters, activation=ACTIVATION, length=LENGTH, velocity=VELOCITY):
    inputs = (jnp.asarray(array) for array in (activation, length, velocity))
    values = {name: jnp.asarray(value) for name, value in parameters.items()}
    return rigid_tendon_fiber(curves, *inputs, **values)


def tendon_force(curves, parameters):
    return fiber(curves, parameters).tendon_force


@CURVES
@pytest.mark.parametrize("name", MUSCLE)
def test_derivatives_by_parameters_equal_finite_differences(curves, name):
    exact = jax.jacfwd(lambda parameters: tendon_force(curves, parameters))(MUSCLE)[name]
    step = 1e-6 * MUSCLE[name]
    above, below = (tendon_force(curves, MUSCLE | {name: MUSCLE[name] + change}) for change in (step, -step))
    assert np.abs(exact).max() > 0.0
    scale = np.abs(exact).max()
    np.testing.assert_allclose(exact, (above - below) / (2.0 * step), rtol=1e-6, atol=1e-7 * scale)


@CURVES
def test_derivatives_by_the_path_equal_finite_differences(curves):
    """Wrap parameters and joint angles affect the force through length and velocity."""

    def force(length, velocity):
        return fiber(curves, MUSCLE, length=length, velocity=velocity).tendon_force

    for place, step in ((0, 1e-7), (1, 1e-6)):
        point = [jnp.asarray(LENGTH), jnp.asarray(VELOCITY)]
        direction = [jnp.zeros_like(LENGTH), jnp.zeros_like(LENGTH)]
        direction[place] = jnp.ones_like(LENGTH)
        _, exact = jax.jvp(force, point, direction)
        sides = [
            force(*(value + sign * step * along for value, along in zip(point, direction, strict=True)))
            for sign in (1.0, -1.0)
        ]
        difference = (sides[0] - sides[1]) / (2.0 * step)
        np.testing.assert_allclose(exact, difference, rtol=1e-5, atol=1e-6 * np.abs(exact).max())


@CURVES
def test_force_at_optimal_length_and_full_activation(curves):
    """At zero velocity the force is F0 along the fibers, and its projection along the tendon."""
    projection = np.cos(MUSCLE["pennation_angle"])
    optimal = MUSCLE["tendon_slack_length"] + MUSCLE["optimal_fiber_length"] * projection
    one = np.ones((1, 1))
    state = fiber(curves, MUSCLE, one, optimal * one, 0.0 * one)
    np.testing.assert_allclose(state.normalized_length, 1.0, rtol=1e-12)
    np.testing.assert_allclose(state.active_force, MUSCLE["max_isometric_force"] * projection, rtol=1e-2)
    assert state.passive_force < 0.01 * state.active_force


@CURVES
def test_active_force_is_proportional_to_activation(curves):
    twice = fiber(curves, MUSCLE, 2.0 * ACTIVATION)
    once = fiber(curves, MUSCLE)
    np.testing.assert_allclose(twice.active_force, 2.0 * once.active_force, rtol=1e-14)
    np.testing.assert_array_equal(twice.passive_force, once.passive_force)
