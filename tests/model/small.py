"""Small synthetic model with smooth signals: three muscles, two coordinates, two cycles."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.path_penalties import path_limits
from wrapjax.calibration.penalties import pipeline_penalties
from wrapjax.geometry.paths import AdjustablePath, PathState, fixed_path
from wrapjax.model.forward import Recording, muscle_states
from wrapjax.model.freedom import nga_freedom, with_paths
from wrapjax.model.parameters import initial_parameters
from wrapjax.model.variables import free_variables
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.excitation import fit_emg_spline

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
    variables = free_variables(base, nga_freedom(base), MUSCLES)
    states = eqx.filter_jit(muscle_states)(HILL_CURVES["paper"], base, recording)
    truth = variables.start() * jnp.asarray(
        np.random.default_rng(seed + 1).uniform(0.9, 1.1, variables.count)
    )
    true_states = eqx.filter_jit(muscle_states)(HILL_CURVES["paper"], variables.unpack(truth), recording)
    noise = jax.random.normal(jax.random.key(seed), true_states.moment.shape[1:])
    return Objective(
        curves=HILL_CURVES["paper"],
        recording=recording,
        measured=true_states.moment.sum(axis=0) + noise,
        variables=variables,
        penalties=pipeline_penalties(states, [[0, 1]], [[0, 1, 2]]),
        limits=(),
    )


#: Number of path modes of each muscle; the arrays are padded.
MODES = (3, 2, 0)


def small_adjustable_recording(seed: int = 0) -> Recording:
    """Build the small recording with free paths, with a different number of modes for each muscle."""
    fixed = small_recording(seed)
    nominal = fixed.path.nominal
    generator = np.random.default_rng(seed + 7)
    phase = generator.uniform(0.0, 2.0 * np.pi, (3, max(MODES), 2, 1))
    time = np.linspace(0.0, 0.25, FRAMES)
    own = (np.arange(max(MODES))[None] < np.array(MODES)[:, None]).astype(float)[..., None, None]
    length = 0.004 * own * np.sin(20.0 * time + phase)
    velocity = 0.08 * own * np.cos(20.0 * time + phase)
    level = generator.uniform(-1.0, 1.0, (3, max(MODES), 1, 2, 1))
    arm = 0.01 * own[..., None] * (level + 0.3 * np.cos(20.0 * time + phase)[..., None, :])
    modes = PathState(*(jnp.asarray(array) for array in (length, velocity, arm)))
    return eqx.tree_at(lambda recording: recording.path, fixed, AdjustablePath(nominal, modes))


def small_limited_objective(seed: int = 0) -> Objective:
    """Build an objective whose moments need paths beyond their limits: reversed arms and long fibers."""
    recording = small_adjustable_recording(seed)
    base = eqx.tree_at(lambda tree: tree.path_changes, small_parameters(), jnp.zeros((3, max(MODES))))
    free = np.arange(max(MODES))[None] < np.array(MODES)[:, None]
    freedom = with_paths(nga_freedom(base), "SGA", free, prior_sd=10.0)
    variables = free_variables(base, freedom, MUSCLES)
    curves = HILL_CURVES["paper"]
    states = eqx.filter_jit(muscle_states)(curves, base, recording)
    changes = 6.0 * np.random.default_rng(seed + 3).choice([-1.0, 1.0], (3, max(MODES))) * free
    true = eqx.tree_at(lambda tree: tree.path_changes, base, jnp.asarray(changes))
    true_states = eqx.filter_jit(muscle_states)(curves, true, recording)
    return Objective(
        curves=curves,
        recording=recording,
        measured=true_states.moment.sum(axis=0),
        variables=variables,
        penalties=pipeline_penalties(states, [[0, 1]], [[0, 1, 2]]),
        limits=path_limits(recording.path.nominal),
    )
