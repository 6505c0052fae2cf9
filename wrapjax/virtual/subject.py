"""Write a virtual subject's folder: what a laboratory would record of a person, whose truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from wrapjax.files import new_folder, write_text
from wrapjax.geometry import PathState, fixed_path
from wrapjax.model import Recording, initial_parameters, joint_moments
from wrapjax.muscle import HILL_CURVES, fit_emg_spline
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.precision import require_float64
from wrapjax.subject import Storage, write_storage
from wrapjax.subject.cycles import cycle_times, padding_frames
from wrapjax.virtual.anatomy import BODY_MASS_KG, COORDINATES
from wrapjax.virtual.gait import CHANNELS, WalkingCycle, draw_cycle
from wrapjax.virtual.leg import build_leg_model
from wrapjax.virtual.muscles import MUSCLES
from wrapjax.virtual.truth import VirtualTruth, draw_truth, parameter_names

MODEL_FILE = "model.osim"
#: Frames of angles written before and after a cycle, so that a spline's derivative is good at its ends.
_MARGIN_FRAMES = 8
#: Standard deviation in frames of the bell that noise is smoothed with: halves the power at 3.5 / cycle,
#: where envelopes are cut off.
_NOISE_WIDTH = 3.8
#: Additive noise of a channel, in parts of the multiplicative one, where the envelope is at its highest.
_ADDITIVE_PART = 0.2


@dataclass(frozen=True)
class Series:
    """Cycles walked at one speed.

    Parameters
    ----------
    speed
        m/s.
    calibration, validation
        Number of cycles for either use.
    """

    speed: float
    calibration: int
    validation: int


#: Three cycles to calibrate with and one to validate at a slow and a natural speed.
DEFAULT_SERIES = (Series(0.8, 3, 1), Series(1.2, 3, 1))


def write_virtual_subject(
    folder: Path,
    *,
    seed: int = 0,
    emg_noise: float = 0.1,
    moment_noise: float = 1.0,
    series: Sequence[Series] = DEFAULT_SERIES,
    force: bool = False,
) -> VirtualTruth:
    """Make up a person, let them walk, and write what was recorded as a subject folder.

    The joint moments are those of the package's own forward model with the true parameters, on the muscle
    paths of OpenSim and the noise-free EMG. JAX must be in 64-bit mode.

    Parameters
    ----------
    folder
        Where to write; it appears when complete.
    seed
        Decides the person, the cycles and the noise. The same seed gives the same files.
    emg_noise
        Standard deviation of the noise that envelopes are multiplied with; a fifth of it is added.
    moment_noise
        Standard deviation of the noise added to the moments, N m. Both kinds are as smooth as envelopes.
    series
        Speeds and numbers of cycles.
    force
        Replace a folder that exists.

    Returns
    -------
    VirtualTruth
        What was written to ``truth.json``.
    """
    require_float64()
    person, walking, noise = (np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(3))
    truth = draw_truth(person)
    cycles = [
        draw_cycle(walking, entry.speed, start=1.0)
        for entry in series
        for _ in range(entry.calibration + entry.validation)
    ]
    limits = [(cycle.start, cycle.end) for cycle in cycles]
    emg_time = cycle_times(limits, padding_frames(limits))
    emg = np.array([cycle.emg(time) for cycle, time in zip(cycles, emg_time, strict=True)])
    emg /= emg.max(axis=(0, 2))[None, :, None]
    with new_folder(Path(folder), force=force) as temporary:
        build_leg_model(temporary / MODEL_FILE)
        moments = true_moments(truth, emg_time, emg, walked_paths(temporary / MODEL_FILE, cycles))
        moments = moments + moment_noise * _smooth_noise(noise, moments.shape)
        factor = np.exp(emg_noise * _smooth_noise(noise, emg.shape))
        emg = emg * factor + _ADDITIVE_PART * emg_noise * np.abs(_smooth_noise(noise, emg.shape))
        names = _trial_names(series)
        for name, cycle, rows in zip(names, cycles, zip(emg_time, emg, moments, strict=True), strict=True):
            _write_trial(temporary / "trials" / name, cycle, *rows)
        write_text(temporary / "subject.toml", _settings(Path(folder).name, names, cycles, series))
        truth.write(temporary)
    return truth


def walked_paths(model_file: Path, cycles: Sequence[WalkingCycle]) -> PathState:
    """Compute the muscles' paths over the cycles with OpenSim.

    Parameters
    ----------
    model_file
        The virtual leg.
    cycles
        How it walked.

    Returns
    -------
    PathState
        Of the muscles as `VirtualTruth` orders them; the rate is the derivative of the spline through the
        lengths.
    """
    muscles = tuple(name for channel in CHANNELS.values() for name in channel.scales)
    time = cycle_times([(cycle.start, cycle.end) for cycle in cycles], _MARGIN_FRAMES)
    angles = np.array([cycle.angles(row).T for cycle, row in zip(cycles, time, strict=True)])
    poses = angles.reshape(-1, len(COORDINATES))
    geometry = analyse_muscles(model_file, muscles, COORDINATES, poses, quiet=True)
    length = np.moveaxis(geometry.length.reshape(*time.shape, len(muscles)), -1, 0)
    rate = np.stack(
        [CubicSpline(time[trial], length[:, trial], axis=-1)(time[trial], 1) for trial in range(len(cycles))],
        axis=1,
    )
    arms = geometry.moment_arm.reshape(*time.shape, len(COORDINATES), len(muscles))
    inside = slice(_MARGIN_FRAMES, -_MARGIN_FRAMES)
    return PathState(
        length=jnp.asarray(length[..., inside]),
        velocity=jnp.asarray(rate[..., inside]),
        moment_arm=jnp.asarray(np.transpose(arms[:, inside], (3, 0, 2, 1))),
    )


def true_moments(
    truth: VirtualTruth,
    emg_time: Float[np.ndarray, "trial padded_frame"],
    emg: Float[np.ndarray, "trial channel padded_frame"],
    path: PathState,
) -> Float[np.ndarray, "trial coordinate frame"]:
    """Compute the joint moments (N m) of a person from noise-free EMG and the muscles' paths."""
    by_name = {muscle.name: muscle for muscle in MUSCLES}
    chosen = [by_name[name] for name in truth.muscles]
    columns = np.array(
        [
            (m.max_isometric_force, m.optimal_fiber_length, m.tendon_slack_length, m.pennation_angle)
            for m in chosen
        ]
    )
    start = initial_parameters(*jnp.asarray(columns.T))
    true_values = {name: jnp.asarray(getattr(truth, name)) for name in parameter_names()}
    parameters = type(start)(**{**vars(start), **true_values})
    channel_of = np.repeat(np.arange(len(CHANNELS)), [len(channel.scales) for channel in CHANNELS.values()])
    spline = fit_emg_spline(emg_time, emg[:, channel_of])
    padding = (emg_time.shape[1] - path.length.shape[-1]) // 2
    return np.asarray(
        joint_moments(HILL_CURVES["paper"], parameters, Recording(spline, fixed_path(path), padding))
    )


def _smooth_noise(generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Draw smooth noise along the last axis, of mean zero and standard deviation one."""
    white = generator.standard_normal(shape)
    # The smoothed variance of white noise is 1 / (2 sqrt(pi) width).
    return gaussian_filter1d(white, _NOISE_WIDTH, axis=-1, mode="wrap") * np.sqrt(
        2.0 * np.sqrt(np.pi) * _NOISE_WIDTH
    )


def _trial_names(series: Sequence[Series]) -> list[str]:
    return [
        f"walk_{entry.speed:g}".replace(".", "p") + f"_{order}"
        for entry in series
        for order in range(1, entry.calibration + entry.validation + 1)
    ]


def _write_trial(
    folder: Path,
    cycle: WalkingCycle,
    emg_time: Float[np.ndarray, " padded_frame"],
    emg: Float[np.ndarray, "channel padded_frame"],
    moments: Float[np.ndarray, "coordinate frame"],
) -> None:
    limits = [(cycle.start, cycle.end)]
    (wide,) = cycle_times(limits, _MARGIN_FRAMES)
    (time,) = cycle_times(limits)
    degrees = np.degrees(cycle.angles(wide)).T
    moment_columns = tuple(f"{name}_moment" for name in COORDINATES)
    write_storage(folder / "angles.sto", Storage("coordinates", COORDINATES, wide, degrees, in_degrees=True))
    write_storage(folder / "moments.sto", Storage("inverse dynamics", moment_columns, time, moments.T))
    write_storage(folder / "emg.sto", Storage("emg envelopes", tuple(CHANNELS), emg_time, emg.T))


def _settings(
    name: str, names: Sequence[str], cycles: Sequence[WalkingCycle], series: Sequence[Series]
) -> str:
    """Write the settings file's text."""
    uses = [
        use
        for entry in series
        for use in ["calibration"] * entry.calibration + ["validation"] * entry.validation
    ]
    quoted = ", ".join(f'"{coordinate}"' for coordinate in COORDINATES)
    lines = [
        "# A virtual person, made up by wrapjax. Their true parameters are in truth.json.",
        "[subject]",
        f'name = "{name}"',
        f"mass_kg = {BODY_MASS_KG}",
        'side = "r"',
        "",
        "[model]",
        f'file = "{MODEL_FILE}"',
        f"coordinates = [{quoted}]",
        "",
        "[emg]",
        'kind = "envelope"',
        "[emg.channels]",
    ]
    for electrode, channel in CHANNELS.items():
        driven = ", ".join(f'"{muscle}"' for muscle in channel.scales)
        lines.append(f"{electrode} = [{driven}]")
    for trial, cycle, use in zip(names, cycles, uses, strict=True):
        lines += ["", "[[trial]]", f'name = "{trial}"', f"speed_m_s = {cycle.speed}", f'use = "{use}"']
        lines += [f'{kind} = "trials/{trial}/{kind}.sto"' for kind in ("angles", "moments", "emg")]
        lines.append(f"cycle = [{cycle.start!r}, {cycle.end!r}]")
    return "\n".join(lines) + "\n"
