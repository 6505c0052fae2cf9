"""Write a virtual subject's folder: what a laboratory would record of a person, whose truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from wrapjax.datasets.virtual_person.anatomy import COORDINATES
from wrapjax.datasets.virtual_person.folder import (
    MARGIN_FRAMES,
    MODEL_FILE,
    Series,
    settings_text,
    trial_names,
    write_trial,
)
from wrapjax.datasets.virtual_person.gait import CHANNELS, WalkingCycle, draw_cycle
from wrapjax.datasets.virtual_person.hidden_effects import HIDDEN_EFFECTS, NoiseFreeRecording
from wrapjax.datasets.virtual_person.leg import MUSCLES, build_leg_model, on_side
from wrapjax.datasets.virtual_person.true_parameters import (
    TrueParameters,
    draw_other_leg,
    draw_true_parameters,
    draw_wraps,
    parameter_names,
)
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.io.files import new_folder, write_text
from wrapjax.jax_setup import require_float64
from wrapjax.model.forward import Recording, joint_moments
from wrapjax.model.parameters import initial_parameters
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.excitation import fit_emg_spline
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.osim.personalised_model import write_personalised_model
from wrapjax.subject.trials import cycle_times, padding_frames

#: Standard deviation in frames of the bell that noise is smoothed with: halves the power at 3.5 / cycle,
#: where envelopes are cut off.
_NOISE_WIDTH = 3.8
#: Additive noise of a channel, in parts of the multiplicative one, where the envelope is at its highest.
_ADDITIVE_PART = 0.2

#: Three cycles to calibrate with and one to validate at a slow and a natural speed.
DEFAULT_SERIES = (Series(0.8, 3, 1), Series(1.2, 3, 1))


def write_virtual_subject(
    folder: Path,
    *,
    seed: int = 0,
    emg_noise: float = 0.1,
    moment_noise: float = 1.0,
    series: Sequence[Series] = DEFAULT_SERIES,
    wrap_spread: float = 0.0,
    hidden_effect: str | None = None,
    force: bool = False,
) -> TrueParameters:
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
    wrap_spread
        How far the person's wrapping cylinders may be from the written model's: in 5 mm, 10 degrees and
        10 % of the radius, along every parameter.
    hidden_effect
        One of `HIDDEN_EFFECTS` that is at work beside muscles, and that no file tells of.
    force
        Replace a folder that exists.

    Returns
    -------
    VirtualTruth
        What was written to ``truth.json``.
    """
    require_float64()
    person, walking, noise, _, _, _, wraps = _generators(seed)
    cycles = _walk(walking, series)
    truth = draw_true_parameters(person)
    if wrap_spread:
        truth = replace(truth, wraps=_hidden_wraps(wraps, cycles, wrap_spread))
    leg = _record(truth, "r", cycles, noise, emg_noise, moment_noise, series, hidden_effect)
    with new_folder(Path(folder), force=force) as temporary:
        leg.write(temporary, Path(folder).name)
    return leg.truth


def write_virtual_legs(
    folder: Path,
    *,
    seed: int = 0,
    emg_noise: float = 0.1,
    moment_noise: float = 1.0,
    series: Sequence[Series] = DEFAULT_SERIES,
    force: bool = False,
) -> dict[str, TrueParameters]:
    """Make up a person, and write what was recorded of both legs as two subjects that name each other.

    The right leg is that of `write_virtual_subject`. The left one is its mirror image with the same
    activation constants, fiber and slack lengths; delays, EMG scales, cycles and noise are its own.

    Parameters
    ----------
    folder
        Gets ``right/`` and ``left/``, both complete.
    seed, emg_noise, moment_noise, series, force
        As of `write_virtual_subject`.

    Returns
    -------
    dict of VirtualTruth
        By ``right`` and ``left``.
    """
    require_float64()
    person, walking, noise, other_person, other_walking, other_noise, _ = _generators(seed)
    right = draw_true_parameters(person)
    left = draw_other_leg(right, other_person)
    legs = {
        "right": _record(right, "r", _walk(walking, series), noise, emg_noise, moment_noise, series),
        "left": _record(
            left, "l", _walk(other_walking, series), other_noise, emg_noise, moment_noise, series
        ),
    }
    with new_folder(Path(folder), force=force) as temporary:
        for name, other in (("right", "left"), ("left", "right")):
            (temporary / name).mkdir()
            legs[name].write(temporary / name, f"{Path(folder).name}_{name}", other_leg=f"../{other}")
    return {name: leg.truth for name, leg in legs.items()}


def _generators(seed: int) -> list[np.random.Generator]:
    """Give those of the person, the walking and the noise; the left leg's own; that of the cylinders."""
    return [np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(7)]


@dataclass(frozen=True)
class _Leg:
    """A leg and what was recorded of it."""

    truth: TrueParameters
    side: str
    series: Sequence[Series]
    cycles: list[WalkingCycle]
    emg_time: Float[np.ndarray, "trial padded_frame"]
    emg: Float[np.ndarray, "trial channel padded_frame"]
    moments: Float[np.ndarray, "trial coordinate frame"]
    #: Channels without an electrode.
    missing_channels: tuple[str, ...] = ()

    def write(self, folder: Path, name: str, *, other_leg: str | None = None) -> None:
        """Write all files of a subject into a folder that exists."""
        build_leg_model(folder / MODEL_FILE, self.side)
        names = trial_names(self.series)
        rows = zip(self.cycles, self.emg_time, self.emg, self.moments, strict=True)
        for trial, row in zip(names, rows, strict=True):
            write_trial(folder / "trials" / trial, self.side, *row)
        settings = settings_text(
            name,
            self.side,
            other_leg,
            names,
            self.cycles,
            self.series,
            missing_channels=self.missing_channels,
        )
        write_text(folder / "subject.toml", settings)
        self.truth.write(folder)


def _walk(walking: np.random.Generator, series: Sequence[Series]) -> list[WalkingCycle]:
    return [
        draw_cycle(walking, entry.speed, start=1.0)
        for entry in series
        for _ in range(entry.calibration + entry.validation)
    ]


def _hidden_wraps(
    generator: np.random.Generator, cycles: Sequence[WalkingCycle], spread: float
) -> dict[str, Float[np.ndarray, " wrap_parameter"]]:
    """Draw the right leg's cylinders, with which it can walk these cycles."""
    _, angles = _walked_angles(cycles)
    with TemporaryDirectory() as place:
        model_file = Path(place) / MODEL_FILE
        build_leg_model(model_file)
        return draw_wraps(generator, model_file, angles, spread)


def _record(
    truth: TrueParameters,
    side: str,
    cycles: list[WalkingCycle],
    noise: np.random.Generator,
    emg_noise: float,
    moment_noise: float,
    series: Sequence[Series],
    hidden_effect: str | None = None,
) -> _Leg:
    """Let a leg walk and record it."""
    limits = [(cycle.start, cycle.end) for cycle in cycles]
    emg_time = cycle_times(limits, padding_frames(limits))
    emg = np.array([cycle.emg(time) for cycle, time in zip(cycles, emg_time, strict=True)])
    emg /= emg.max(axis=(0, 2))[None, :, None]
    with TemporaryDirectory() as place:
        model_file = Path(place) / MODEL_FILE
        build_leg_model(model_file, side)
        if truth.wraps:
            write_personalised_model(model_file, model_file, truth.wraps, {})
        path = compute_muscle_paths(model_file, cycles, side)
    moments = compute_moments(truth, emg_time, emg, path)
    _, angles = _walked_angles(cycles)
    inside = np.swapaxes(angles, 1, 2)[..., MARGIN_FRAMES:-MARGIN_FRAMES]
    speeds = np.array([cycle.speed for cycle in cycles])
    recorded = NoiseFreeRecording(speeds, inside, emg_time, emg, moments)
    if hidden_effect is not None:
        recorded = HIDDEN_EFFECTS[hidden_effect](recorded)
    moments, emg = recorded.moments, recorded.emg
    moments = moments + moment_noise * _smooth_noise(noise, moments.shape)
    factor = np.exp(emg_noise * _smooth_noise(noise, emg.shape))
    emg = emg * factor + _ADDITIVE_PART * emg_noise * np.abs(_smooth_noise(noise, emg.shape))
    return _Leg(truth, side, series, cycles, emg_time, emg, moments, recorded.missing_channels)


def compute_muscle_paths(model_file: Path, cycles: Sequence[WalkingCycle], side: str = "r") -> PathState:
    """Compute the muscles' paths over the cycles with OpenSim.

    Parameters
    ----------
    model_file
        The virtual leg.
    cycles
        How it walked.
    side
        Which leg it is.

    Returns
    -------
    PathState
        Of the muscles as `TrueParameters` orders them; the rate is the derivative of the spline through the
        lengths.
    """
    muscles = tuple(on_side(name, side) for channel in CHANNELS.values() for name in channel.scales)
    coordinates = tuple(on_side(name, side) for name in COORDINATES)
    time, angles = _walked_angles(cycles)
    poses = angles.reshape(-1, len(COORDINATES))
    geometry = analyse_muscles(model_file, muscles, coordinates, poses, quiet=True)
    length = np.moveaxis(geometry.length.reshape(*time.shape, len(muscles)), -1, 0)
    rate = np.stack(
        [CubicSpline(time[trial], length[:, trial], axis=-1)(time[trial], 1) for trial in range(len(cycles))],
        axis=1,
    )
    arms = geometry.moment_arm.reshape(*time.shape, len(COORDINATES), len(muscles))
    inside = slice(MARGIN_FRAMES, -MARGIN_FRAMES)
    return PathState(
        length=jnp.asarray(length[..., inside]),
        velocity=jnp.asarray(rate[..., inside]),
        moment_arm=jnp.asarray(np.transpose(arms[:, inside], (3, 0, 2, 1))),
    )


def _walked_angles(
    cycles: Sequence[WalkingCycle],
) -> tuple[Float[np.ndarray, "trial padded_frame"], Float[np.ndarray, "trial padded_frame coordinate"]]:
    """Give times (s) and joint angles (rad) of the cycles, with frames before and after."""
    time = cycle_times([(cycle.start, cycle.end) for cycle in cycles], MARGIN_FRAMES)
    return time, np.array([cycle.angles(row).T for cycle, row in zip(cycles, time, strict=True)])


def compute_moments(
    truth: TrueParameters,
    emg_time: Float[np.ndarray, "trial padded_frame"],
    emg: Float[np.ndarray, "trial channel padded_frame"],
    path: PathState,
) -> Float[np.ndarray, "trial coordinate frame"]:
    """Compute the joint moments (N m) of a person from noise-free EMG and the muscles' paths."""
    # The same figures on either side.
    by_name = {on_side(muscle.name, side): muscle for muscle in MUSCLES for side in ("l", "r")}
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
