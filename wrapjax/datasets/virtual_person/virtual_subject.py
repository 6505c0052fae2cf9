"""Simulated recordings of a virtual person with known parameters, written as subject folders."""

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

from wrapjax.datasets.virtual_person.anatomy import BODY_MASS_KG, COORDINATES
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
from wrapjax.io.storage import Storage, write_storage
from wrapjax.jax_setup import require_float64
from wrapjax.model.forward import Recording, joint_moments
from wrapjax.model.parameters import initial_parameters
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.excitation import fit_emg_spline
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.osim.personalised_model import write_personalised_model
from wrapjax.subject.cycles import cycle_times, padding_frames

#: Standard deviation (frames) of the Gaussian filter of the noise: it halves the power at 3.5 per gait cycle,
#: the cutoff frequency of EMG envelopes.
_NOISE_WIDTH = 3.8
#: Ratio of additive to multiplicative EMG noise at the peak of an envelope.
_ADDITIVE_SHARE = 0.2

MODEL_FILE = "model.osim"
#: Number of frames of angles before and after each cycle, so that spline derivatives are accurate at its
#: ends.
MARGIN_FRAMES = 8


@dataclass(frozen=True)
class Series:
    """Series of gait cycles at one speed.

    Parameters
    ----------
    speed
        Walking speed, m/s.
    calibration, validation
        Number of cycles for calibration and for validation.
    """

    speed: float
    calibration: int
    validation: int


#: Three calibration cycles and one validation cycle at a slow and at a natural speed.
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
    """Simulate recorded walking of a virtual person, and write it as a subject folder.

    The joint moments come from the package's own forward model with the true parameters, the muscle paths of
    OpenSim and the noise-free EMG.

    Parameters
    ----------
    folder
        Subject folder to write; it appears when it is complete.
    seed
        Seed of the person, the cycles and the noise. The same seed gives the same files.
    emg_noise
        Standard deviation of the logarithm of the multiplicative noise of the envelopes. The standard
        deviation of their additive noise is a fifth of it.
    moment_noise
        Standard deviation of the noise added to the moments, N m. All noise is as smooth
        as EMG envelopes.
    series
        Speeds and numbers of cycles.
    wrap_spread
        Largest displacement of the true wrapping cylinders from those of the written model, as a multiple of
        5 mm, 10 degrees and 10 % of the radius, for every parameter.
    hidden_effect
        One of `HIDDEN_EFFECTS`, simulated in the recordings and not noted in the folder; None for none.
    force
        Replace an existing folder.

    Returns
    -------
    VirtualTruth
        True parameters, as written to ``truth.json``.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set.
    ValueError
        If ``wrap_spread`` is too large for usable muscle paths.
    RuntimeError
        If JAX is not in 64-bit mode.
    """
    require_float64()
    person, walking, noise, _, _, _, wraps = _generators(seed)
    cycles = _draw_cycles(walking, series)
    true_parameters = draw_true_parameters(person)
    if wrap_spread:
        true_parameters = replace(true_parameters, wraps=_draw_wraps(wraps, cycles, wrap_spread))
    leg = _simulate_recording(
        true_parameters, "r", cycles, noise, emg_noise, moment_noise, series, hidden_effect
    )
    with new_folder(Path(folder), force=force) as temporary:
        leg.write(temporary, Path(folder).name)
    return leg.true_parameters


def write_virtual_legs(
    folder: Path,
    *,
    seed: int = 0,
    emg_noise: float = 0.1,
    moment_noise: float = 1.0,
    series: Sequence[Series] = DEFAULT_SERIES,
    force: bool = False,
) -> dict[str, TrueParameters]:
    """Simulate recorded walking of both legs of a virtual person, and write two subject folders.

    Each folder names the other as ``other_leg``. The right leg is that of `write_virtual_subject`. The left
    one is its mirror image with the same activation constants, fiber and slack lengths; delays, EMG scales,
    cycles and noise are independent.

    Parameters
    ----------
    folder
        Folder in which ``right/`` and ``left/`` are written; it appears when it is complete.
    seed, emg_noise, moment_noise, series, force
        As in `write_virtual_subject`.

    Returns
    -------
    dict of VirtualTruth
        True parameters by leg, ``right`` and ``left``.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set.
    RuntimeError
        If JAX is not in 64-bit mode.
    """
    require_float64()
    person, walking, noise, other_person, other_walking, other_noise, _ = _generators(seed)
    right = draw_true_parameters(person)
    left = draw_other_leg(right, other_person)
    legs = {
        "right": _simulate_recording(
            right, "r", _draw_cycles(walking, series), noise, emg_noise, moment_noise, series
        ),
        "left": _simulate_recording(
            left, "l", _draw_cycles(other_walking, series), other_noise, emg_noise, moment_noise, series
        ),
    }
    with new_folder(Path(folder), force=force) as temporary:
        for name, other in (("right", "left"), ("left", "right")):
            (temporary / name).mkdir()
            legs[name].write(temporary / name, f"{Path(folder).name}_{name}", other_leg=f"../{other}")
    return {name: leg.true_parameters for name, leg in legs.items()}


def _generators(seed: int) -> list[np.random.Generator]:
    """Make the random generators.

    They are those of the person, the walking and the noise, the same of the left leg, and that of the
    cylinders.
    """
    return [np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(7)]


@dataclass(frozen=True)
class _SimulatedLeg:
    """True parameters of a leg and its simulated recording."""

    true_parameters: TrueParameters
    side: str
    series: Sequence[Series]
    cycles: list[WalkingCycle]
    emg_time: Float[np.ndarray, "trial padded_frame"]
    emg: Float[np.ndarray, "trial channel padded_frame"]
    moments: Float[np.ndarray, "trial coordinate frame"]
    #: Channels that were not recorded.
    missing_channels: tuple[str, ...] = ()

    def write(self, folder: Path, name: str, *, other_leg: str | None = None) -> None:
        """Write all files of the subject into an existing folder."""
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
        self.true_parameters.write(folder)


def _draw_cycles(walking: np.random.Generator, series: Sequence[Series]) -> list[WalkingCycle]:
    return [
        draw_cycle(walking, entry.speed, start=1.0)
        for entry in series
        for _ in range(entry.calibration + entry.validation)
    ]


def _draw_wraps(
    generator: np.random.Generator, cycles: Sequence[WalkingCycle], spread: float
) -> dict[str, Float[np.ndarray, " wrap_parameter"]]:
    """Draw random cylinders of the right leg with which the paths over these cycles are usable."""
    _, angles = _cycle_angles(cycles)
    with TemporaryDirectory() as place:
        model_file = Path(place) / MODEL_FILE
        build_leg_model(model_file)
        return draw_wraps(generator, model_file, angles, spread)


def _simulate_recording(
    true_parameters: TrueParameters,
    side: str,
    cycles: list[WalkingCycle],
    noise: np.random.Generator,
    emg_noise: float,
    moment_noise: float,
    series: Sequence[Series],
    hidden_effect: str | None = None,
) -> _SimulatedLeg:
    """Simulate the recording of a leg: muscle paths, moments, a hidden effect and noise."""
    limits = [(cycle.start, cycle.end) for cycle in cycles]
    emg_time = cycle_times(limits, padding_frames(limits))
    emg = np.array([cycle.emg(time) for cycle, time in zip(cycles, emg_time, strict=True)])
    emg /= emg.max(axis=(0, 2))[None, :, None]
    with TemporaryDirectory() as place:
        model_file = Path(place) / MODEL_FILE
        build_leg_model(model_file, side)
        if true_parameters.wraps:
            write_personalised_model(model_file, model_file, true_parameters.wraps, {})
        path = compute_muscle_paths(model_file, cycles, side)
    moments = compute_true_moments(true_parameters, emg_time, emg, path)
    _, angles = _cycle_angles(cycles)
    inside = np.swapaxes(angles, 1, 2)[..., MARGIN_FRAMES:-MARGIN_FRAMES]
    speeds = np.array([cycle.speed for cycle in cycles])
    recorded = NoiseFreeRecording(speeds, inside, emg_time, emg, moments)
    if hidden_effect is not None:
        recorded = HIDDEN_EFFECTS[hidden_effect](recorded)
    moments, emg = recorded.moments, recorded.emg
    moments = moments + moment_noise * _smooth_noise(noise, moments.shape)
    factor = np.exp(emg_noise * _smooth_noise(noise, emg.shape))
    emg = emg * factor + _ADDITIVE_SHARE * emg_noise * np.abs(_smooth_noise(noise, emg.shape))
    return _SimulatedLeg(
        true_parameters, side, series, cycles, emg_time, emg, moments, recorded.missing_channels
    )


def compute_muscle_paths(model_file: Path, cycles: Sequence[WalkingCycle], side: str = "r") -> PathState:
    """Compute muscle paths over gait cycles by OpenSim.

    Parameters
    ----------
    model_file
        Model of the virtual leg.
    cycles
        Gait cycles.
    side
        Side of the leg, ``l`` or ``r``.

    Returns
    -------
    PathState
        Paths of the muscles in the order of `TrueParameters`. Velocities are derivatives of splines through
        the lengths.
    """
    muscles = tuple(on_side(name, side) for channel in CHANNELS.values() for name in channel.scales)
    coordinates = tuple(on_side(name, side) for name in COORDINATES)
    time, angles = _cycle_angles(cycles)
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


def _cycle_angles(
    cycles: Sequence[WalkingCycle],
) -> tuple[Float[np.ndarray, "trial padded_frame"], Float[np.ndarray, "trial padded_frame coordinate"]]:
    """Compute times (s) and joint angles (rad) of cycles, with `MARGIN_FRAMES` before and after."""
    time = cycle_times([(cycle.start, cycle.end) for cycle in cycles], MARGIN_FRAMES)
    return time, np.array([cycle.angles(row).T for cycle, row in zip(cycles, time, strict=True)])


def compute_true_moments(
    true_parameters: TrueParameters,
    emg_time: Float[np.ndarray, "trial padded_frame"],
    emg: Float[np.ndarray, "trial channel padded_frame"],
    path: PathState,
) -> Float[np.ndarray, "trial coordinate frame"]:
    """Compute joint moments (N m) from true parameters, noise-free EMG and muscle paths."""
    # Muscles of both sides have the same model parameters.
    by_name = {on_side(muscle.name, side): muscle for muscle in MUSCLES for side in ("l", "r")}
    chosen = [by_name[name] for name in true_parameters.muscles]
    columns = np.array(
        [
            (m.max_isometric_force, m.optimal_fiber_length, m.tendon_slack_length, m.pennation_angle)
            for m in chosen
        ]
    )
    start = initial_parameters(*jnp.asarray(columns.T))
    true_values = {name: jnp.asarray(getattr(true_parameters, name)) for name in parameter_names()}
    parameters = type(start)(**{**vars(start), **true_values})
    channel_of = np.repeat(np.arange(len(CHANNELS)), [len(channel.scales) for channel in CHANNELS.values()])
    spline = fit_emg_spline(emg_time, emg[:, channel_of])
    padding = (emg_time.shape[1] - path.length.shape[-1]) // 2
    return np.asarray(
        joint_moments(HILL_CURVES["paper"], parameters, Recording(spline, fixed_path(path), padding))
    )


def _smooth_noise(generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Draw noise of zero mean and unit standard deviation that is smooth along the last axis."""
    white = generator.standard_normal(shape)
    # The smoothed variance of white noise is 1 / (2 sqrt(pi) width).
    return gaussian_filter1d(white, _NOISE_WIDTH, axis=-1, mode="wrap") * np.sqrt(
        2.0 * np.sqrt(np.pi) * _NOISE_WIDTH
    )


def trial_names(series: Sequence[Series]) -> list[str]:
    """Return the names of the trials, one for each cycle."""
    return [
        f"walk_{entry.speed:g}".replace(".", "p") + f"_{order}"
        for entry in series
        for order in range(1, entry.calibration + entry.validation + 1)
    ]


def write_trial(
    folder: Path,
    side: str,
    cycle: WalkingCycle,
    emg_time: Float[np.ndarray, " padded_frame"],
    emg: Float[np.ndarray, "channel padded_frame"],
    moments: Float[np.ndarray, "coordinate frame"],
) -> None:
    """Write a trial's angles (deg), moments (N m) and EMG envelopes."""
    limits = [(cycle.start, cycle.end)]
    (wide,) = cycle_times(limits, MARGIN_FRAMES)
    (time,) = cycle_times(limits)
    degrees = np.degrees(cycle.angles(wide)).T
    coordinates = tuple(on_side(name, side) for name in COORDINATES)
    moment_columns = tuple(f"{name}_moment" for name in coordinates)
    write_storage(folder / "angles.sto", Storage("coordinates", coordinates, wide, degrees, in_degrees=True))
    write_storage(folder / "moments.sto", Storage("inverse dynamics", moment_columns, time, moments.T))
    write_storage(folder / "emg.sto", Storage("emg envelopes", tuple(CHANNELS), emg_time, emg.T))


def settings_text(
    name: str,
    side: str,
    other_leg: str | None,
    names: Sequence[str],
    cycles: Sequence[WalkingCycle],
    series: Sequence[Series],
    *,
    missing_channels: Sequence[str] = (),
) -> str:
    """Compose ``subject.toml``.

    Parameters
    ----------
    name
        Name of the subject.
    side
        Side of the leg, ``l`` or ``r``.
    other_leg
        Folder of the other leg, relative to this one; None if there is none.
    names, cycles
        Names and gait cycles of the trials.
    series
        Series of cycles, which determine the use of each trial.
    missing_channels
        Channels that were not recorded.
    """
    uses = [
        use
        for entry in series
        for use in ["calibration"] * entry.calibration + ["validation"] * entry.validation
    ]
    quoted = ", ".join(f'"{on_side(coordinate, side)}"' for coordinate in COORDINATES)
    lines = [
        "# A virtual person, simulated by wrapjax. The true parameters are in truth.json.",
        "[subject]",
        f'name = "{name}"',
        f"mass_kg = {BODY_MASS_KG}",
        f'side = "{side}"',
        *([] if other_leg is None else [f'other_leg = "{other_leg}"']),
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
        if electrode in missing_channels:
            continue
        driven = ", ".join(f'"{on_side(muscle, side)}"' for muscle in channel.scales)
        lines.append(f"{electrode} = [{driven}]")
    for trial, cycle, use in zip(names, cycles, uses, strict=True):
        lines += ["", "[[trial]]", f'name = "{trial}"', f"speed_m_s = {cycle.speed}", f'use = "{use}"']
        lines += [f'{kind} = "trials/{trial}/{kind}.sto"' for kind in ("angles", "moments", "emg")]
        lines.append(f"cycle = [{cycle.start!r}, {cycle.end!r}]")
    return "\n".join(lines) + "\n"
