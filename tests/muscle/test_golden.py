"""The muscle model reproduces reference outputs of the NMSM Pipeline from the same inputs, to rounding."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.muscle.activation import muscle_activation, neural_activation
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.hill import rigid_tendon_fiber


@pytest.fixture(scope="module")
def golden(golden_folder):
    return {name: jnp.asarray(value) for name, value in np.load(golden_folder / "forward_model.npz").items()}


def over_muscles(function, *arrays_and_axes):
    arrays, axes = arrays_and_axes[::2], arrays_and_axes[1::2]
    return jax.vmap(function, in_axes=axes, out_axes=1)(*arrays)


def fibers(golden, curves):
    def of_muscle(activation, length, velocity, force, fiber, slack, pennation):
        return rigid_tendon_fiber(
            HILL_CURVES[curves],
            activation,
            length,
            velocity,
            max_isometric_force=force,
            optimal_fiber_length=fiber,
            tendon_slack_length=slack,
            pennation_angle=pennation,
            max_fiber_velocity=jnp.asarray(10.0),
        )

    return over_muscles(
        of_muscle,
        golden["activation"], 1,
        golden["muscle_tendon_length_m"], 1,
        golden["muscle_tendon_velocity_m_s"], 1,
        golden["max_isometric_force_N"], 0,
        golden["optimal_fiber_length_m"], 0,
        golden["tendon_slack_length_m"], 0,
        golden["pennation_rad"], 0,
    )  # fmt: skip


def moments(golden, state):
    return jnp.einsum("tcmf,tmf->tcf", golden["moment_arm_m"], state.tendon_force)


def test_activation_dynamics(golden):
    time = golden["emg_time_s"]
    step = (time[:, -1] - time[:, 0]) / (time.shape[1] - 1)
    padding = (time.shape[1] - 101) // 2
    neural = over_muscles(
        lambda excitation, constant: neural_activation(excitation, constant, step),
        golden["excitation"], 1,
        golden["activation_time_constant_s"], 0,
    )  # fmt: skip
    trimmed = jnp.maximum(neural[..., padding:-padding], 0.0)
    np.testing.assert_allclose(trimmed, golden["neural_activation"], rtol=0, atol=1e-12)


def test_activation_nonlinearity(golden):
    activation = over_muscles(
        muscle_activation, golden["neural_activation"], 1, golden["activation_nonlinearity"], 0
    )
    np.testing.assert_allclose(activation, golden["activation"], rtol=0, atol=1e-12)


def test_fiber_kinematics_and_passive_force(golden):
    state = fibers(golden, "paper")
    np.testing.assert_allclose(state.normalized_length, golden["normalized_fiber_length"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        state.normalized_velocity, golden["normalized_fiber_velocity"], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(state.passive_force, golden["passive_force_N"], rtol=1e-12, atol=1e-10)


def test_joint_moments(golden):
    np.testing.assert_allclose(
        moments(golden, fibers(golden, "paper")), golden["model_moment_Nm"], rtol=0, atol=1e-10
    )


def test_the_two_sets_of_curves_differ_slightly(golden):
    difference = jnp.abs(moments(golden, fibers(golden, "opensim")) - golden["model_moment_Nm"]).max()
    assert 1e-3 < difference < 0.06
