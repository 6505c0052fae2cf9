"""A synthetic leg with the context of its effects: six muscles with EMG, two without, four cycles."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from wrapjax.diagnosis.inputs.context import AtBound, Context, PathChanges
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import Recording
from wrapjax.model.parameters import initial_parameters
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.excitation import fit_emg_spline
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles

CURVES = HILL_CURVES["paper"]
MUSCLES = ("soleus_l", "gasmed_l", "gaslat_l", "tibant_l", "recfem_l", "semimem_l")
CHANNELS = ("Sol", "Gas", "TibAnt", "RecFem", "SemiMemb")
MUSCLE_CHANNELS = (0, 1, 1, 2, 3, 4)
OTHERS = ("iliacus_l", "psoas_l")
COORDINATES = ("hip_flexion_l", "knee_angle_l", "ankle_angle_l")
TRIALS = ("slow/01", "slow/02", "fast/01", "fast/02")
FRAMES, PADDING = 21, 6
#: Phases of the channels; soleus and tibialis anterior have each other's.
EXCHANGED = (0.85, 0.30, 0.32, 0.02, 0.93)

#: By muscle: moment arms (m) about the coordinates.
_ARMS = {
    "soleus_l": (0.0, 0.0, -0.05),
    "gasmed_l": (0.0, 0.02, -0.05),
    "gaslat_l": (0.0, 0.02, -0.045),
    "tibant_l": (0.0, 0.0, 0.04),
    "recfem_l": (0.04, -0.04, 0.0),
    "semimem_l": (-0.05, 0.03, 0.0),
    "iliacus_l": (0.04, 0.0, 0.0),
    "psoas_l": (0.035, 0.0, 0.0),
}
#: Largest force (N), fiber and slack length (m), pennation (rad).
_SIZES = {
    "soleus_l": (3500.0, 0.05, 0.25, 0.4),
    "gasmed_l": (1500.0, 0.06, 0.40, 0.2),
    "gaslat_l": (700.0, 0.06, 0.39, 0.1),
    "tibant_l": (900.0, 0.09, 0.23, 0.1),
    "recfem_l": (1200.0, 0.11, 0.35, 0.1),
    "semimem_l": (1200.0, 0.08, 0.36, 0.3),
    "iliacus_l": (1000.0, 0.10, 0.10, 0.1),
    "psoas_l": (1100.0, 0.12, 0.16, 0.1),
}


def _constants(muscles):
    arms = jnp.array([_ARMS[name] for name in muscles])
    force, fiber, slack, pennation = (
        jnp.array(column) for column in zip(*(_SIZES[name] for name in muscles), strict=True)
    )
    return arms, initial_parameters(force, fiber, slack, pennation)


def paths_at(muscles, angles, velocities) -> PathState:
    """Compute lengths that are nonlinear in each angle, with consistent moment arms and velocities."""
    arms, parameters = _constants(muscles)
    bend = 0.2 * arms
    rest = 1.0 * parameters.optimal_fiber_length + parameters.tendon_slack_length
    arm = arms[:, None, :, None] + bend[:, None, :, None] * jnp.sin(angles)[None]
    pull = arms[:, None, :, None] * angles[None] + bend[:, None, :, None] * (1.0 - jnp.cos(angles))[None]
    length = rest[:, None, None] - pull.sum(axis=2)
    return PathState(length, -(arm * velocities[None]).sum(axis=2), arm)


def _recorded_angles(step):
    phase = np.linspace(0.0, 2 * np.pi, FRAMES)
    duration = step * (FRAMES - 1)
    size = np.array([0.45, 0.5, 0.25])[None, :, None] * np.array([0.9, 0.95, 1.05, 1.1])[:, None, None]
    shift = np.array([0.3, 2.0, 4.0])[None, :, None]
    middle = np.array([0.2, 0.6, 0.0])[None, :, None]
    angles = middle + size * (np.sin(phase + shift) + 0.3 * np.sin(2 * phase))
    rate = 2 * np.pi / duration[:, None, None]
    return angles, size * rate * (np.cos(phase + shift) + 0.6 * np.cos(2 * phase))


def _paths_by_angle(angles, velocities) -> PathState:
    def along(direction):
        change = jnp.broadcast_to(direction[:, None], angles.shape)
        return jax.jvp(
            lambda angles: paths_at(MUSCLES, angles, velocities), (jnp.asarray(angles),), (change,)
        )[1]

    return jax.vmap(along, out_axes=1)(jnp.eye(angles.shape[1]))


def _pushed(pattern, effect_sizes):
    return jnp.tensordot(effect_sizes, pattern, axes=1)


def small_recording_and_context(peaks: tuple[float, ...] | None = None) -> tuple[Recording, Context]:
    """Make a recording, and a context with everything that any effect needs.

    Each channel is most active at one phase, as a share of the cycle: a random one if none is given. Channels
    that were exchanged need `EXCHANGED`.
    """
    generator = np.random.default_rng(0)
    step = np.array([0.012, 0.0121, 0.0095, 0.0093])
    time = step[:, None] * np.arange(-PADDING, FRAMES + PADDING)
    cycle = time / (step[:, None] * (FRAMES - 1))
    peak = generator.uniform(0.0, 1.0, (1, len(CHANNELS), 1))
    if peaks is not None:
        peak = np.array(peaks)[None, :, None]
    emg = 0.08 + 0.7 * np.exp(3.0 * (np.cos(2 * np.pi * (cycle[:, None] - peak)) - 1.0))
    emg = emg * generator.uniform(0.8, 1.0, (4, len(CHANNELS), 1))
    splines = jax.tree.map(lambda leaf: leaf[np.array(MUSCLE_CHANNELS)], fit_emg_spline(time, emg))
    angles, velocities = _recorded_angles(step)
    paths = paths_at(MUSCLES, angles, velocities)
    _, parameters = _constants(MUSCLES)
    _, of_others = _constants(OTHERS)
    # One change adds to the length of a muscle's path; the other scales the path.
    directions = PathState(
        jnp.stack([jnp.ones_like(paths.length), 0.1 * paths.length], axis=1),
        jnp.stack([jnp.zeros_like(paths.velocity), 0.1 * paths.velocity], axis=1),
        jnp.stack([jnp.zeros_like(paths.moment_arm), 0.1 * paths.moment_arm], axis=1),
    )
    changes = PathChanges(
        derivatives=directions,
        places=np.arange(12).reshape(6, 2),
        names=tuple(f"{muscle}.end_{number}" for muscle in MUSCLES for number in (1, 2)),
        units=("m", "1") * 6,
        prior_sd=(0.004, 0.1) * 6,
    )
    # The first two muscles share a wrap; four have none.
    wraps = PathChanges(
        derivatives=directions,
        places=np.array([[0, 1], [0, 1], [-1, -1], [-1, -1], [-1, -1], [-1, -1]]),
        names=("condyles.translation_x_m", "condyles.radius_factor"),
        units=("m", "1"),
        prior_sd=(0.004, 0.1),
    )
    by_angle = _paths_by_angle(angles, velocities)
    pattern = jnp.asarray(generator.normal(0.0, 1.0, (2, 4, 3, FRAMES)))
    context = Context(
        muscles=MUSCLES,
        channels=CHANNELS,
        muscle_channels=MUSCLE_CHANNELS,
        coordinates=COORDINATES,
        trials=TRIALS,
        recordings=tuple(name.split("/")[0] for name in TRIALS),
        uses=("calibration",) * len(TRIALS),
        angles=angles,
        velocities=velocities,
        step=step,
        speeds=np.array([0.5, 0.5, 0.8, 0.8]),
        order=np.linspace(0.0, 1.0, 4),
        padding=PADDING,
        parameters=parameters,
        paths=paths,
        envelopes=splines.coefficients,
        paretic=True,
        undriven_muscles=UndrivenMuscles(
            names=OTHERS,
            groups=(("hip_flexors", OTHERS),),
            curves=CURVES,
            parameters=of_others,
            path=paths_at(OTHERS, angles, velocities),
        ),
        paths_by_angle=by_angle,
        wraps=wraps,
        attachments=changes,
        at_bounds=(
            AtBound("soleus_l", "emg_scale", 1, 0.2, "1"),
            AtBound("tibant_l", "electromechanical_delay", -1, 0.05, "s"),
            AtBound("gasmed_l", "emg_scale", -1, 0.2, "1"),
        ),
        path_changes={
            "foot_deformation": {"forefoot": jax.tree.map(lambda leaf: leaf[:, 2:], by_angle)},
        },
        measured_changes={
            "cop_offset": {"": Partial(_pushed, 300.0 * pattern)},
            "foot_deformation": {
                "whole foot": Partial(_pushed, 50.0 * pattern[1:]),
                "forefoot": Partial(_pushed, 50.0 * pattern[:1]),
            },
        },
    )
    return Recording(splines, fixed_path(paths), PADDING), context
