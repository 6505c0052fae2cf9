"""A small model made of smooth made-up signals: three muscles, two coordinates, two cycles."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from wrapjax.calibrate import Objective, pipeline_penalties
from wrapjax.geometry import PathState, fixed_path
from wrapjax.model import Recording, free_variables, initial_parameters, muscle_states, nga
from wrapjax.muscle import HILL_CURVES, fit_emg_spline

MUSCLES = ("soleus_l", "gasmed_l", "tibant_l")
FRAMES, PADDING = 21, 6


def small_recording(seed: int = 0) -> Recording:
    generator = np.random.default_rng(seed)
    step = np.array([[0.010], [0.012]])
    time = step * np.arange(-PADDING, FRAMES + PADDING)
    phase = generator.uniform(0, 2 * np.pi, size=(2, 3, 1))
    emg = 0.5 + 0.45 * np.sin(25 * time[:, None] + phase)
    inside = time[:, PADDING:-PADDING][None]
    wave = np.sin(20 * inside + np.arange(3)[:, None, None])
    length = 0.35 + 0.01 * wave
    velocity = 0.2 * np.cos(20 * inside + np.arange(3)[:, None, None])
    arm = (
        0.04
        * np.array([[-1.0, 0.2], [-0.8, 1.0], [1.0, 0.3]])[:, None, :, None]
        * (1 + 0.1 * wave[:, :, None])
    )
    path = PathState(*(jnp.asarray(array) for array in (length, velocity, arm)))
    return Recording(emg=fit_emg_spline(time, emg), path=fixed_path(path), padding=PADDING)


def small_parameters():
    return initial_parameters(
        max_isometric_force=jnp.array([3000.0, 1500.0, 900.0]),
        optimal_fiber_length=jnp.array([0.05, 0.06, 0.09]),
        tendon_slack_length=jnp.array([0.30, 0.29, 0.26]),
        pennation_angle=jnp.array([0.4, 0.2, 0.1]),
    )


def small_objective(seed: int = 0) -> Objective:
    recording, base = small_recording(seed), small_parameters()
    variables = free_variables(base, nga(base), MUSCLES)
    states = eqx.filter_jit(muscle_states)(HILL_CURVES["paper"], base, recording)
    truth = variables.start() * jnp.asarray(
        np.random.default_rng(seed + 1).uniform(0.9, 1.1, variables.count)
    )
    true_states = muscle_states(HILL_CURVES["paper"], variables.unpack(truth), recording)
    noise = jax.random.normal(jax.random.key(seed), true_states.moment.shape[1:])
    return Objective(
        curves=HILL_CURVES["paper"],
        recording=recording,
        measured=true_states.moment.sum(axis=0) + noise,
        variables=variables,
        penalties=pipeline_penalties(states, [[0, 1]], [[0, 1, 2]]),
        limits=(),
    )
