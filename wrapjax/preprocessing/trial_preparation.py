"""Preparation of one recording: reading, gait cycles, inverse kinematics and dynamics by OpenSim, checks."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.model_description import Coordinate
from wrapjax.io.model_file import ModelFile
from wrapjax.io.storage import Storage, read_storage
from wrapjax.osim.mechanics import Mechanics, analyse_mechanics
from wrapjax.osim.model import describe_model
from wrapjax.osim.motion import Motion as PosedMotion
from wrapjax.osim.tools import solve_inverse_dynamics, solve_inverse_kinematics
from wrapjax.preprocessing.c3d import read_c3d_analog, read_c3d_markers, read_plates
from wrapjax.preprocessing.consistency_checks import (
    Check,
    check_calf_emg_against_moment,
    check_foot_on_plates,
    check_force_sides,
    check_forces_against_motion,
    check_marker_errors,
)
from wrapjax.preprocessing.emg_quality import emg_faults, envelope_faults
from wrapjax.preprocessing.force_plates import SIDES, FootForces, read_force_columns, write_forces
from wrapjax.preprocessing.gait_events import find_contacts
from wrapjax.preprocessing.joint_angles import Motion, read_motion
from wrapjax.preprocessing.laboratory_settings import LaboratorySettings, LaboratoryTrial, laboratory_rotation
from wrapjax.preprocessing.markers import (
    MOTION_HARMONIC,
    Markers,
    low_pass,
    match_markers,
    read_trc,
    write_trc,
)
from wrapjax.preprocessing.prepared_folder import PreparedTrial
from wrapjax.subject.emg_envelopes import compute_envelopes, resample_evenly, sampling_rate
from wrapjax.subject.recordings import MIN_RAW_EMG_RATE

#: Motion kept before and after the cycles, s, so that edge effects of filters and derivatives are outside.
MOTION_MARGIN = 0.4
#: EMG kept before and after the cycles, s, for delays and edge effects of the low-pass filter.
EMG_MARGIN = 1.5
#: Frame rate at which the forces required by the motion are computed, Hz; filtered motion needs no more.
MECHANICS_RATE = 100.0
#: Prefixes of the names of calf muscles.
_CALF_PREFIXES = ("soleus", "gas")


@dataclass(frozen=True)
class PreparationModel:
    """Scaled model for the preparation of all trials.

    Parameters
    ----------
    path
        File of the model (``.osim``).
    file
        Content of the file.
    coupled
        Coupled coordinates, from `find_coupled_coordinates`.
    markers
        Names of its markers.
    """

    path: Path
    file: ModelFile
    coupled: Mapping[str, Coordinate]
    markers: tuple[str, ...]


def prepare_trial(
    trial: LaboratoryTrial, settings: LaboratorySettings, model: PreparationModel, log: Callable[[str], None]
) -> PreparedTrial:
    """Read a recording, compute its motion and moments, and check that motion, forces and EMG agree.

    Parameters
    ----------
    trial
        Settings of the recording.
    settings
        Laboratory settings.
    model
        Scaled model.
    log
        Function called with each line of progress.

    Raises
    ------
    InputError
        With all faults of the files, or with all failed checks.
    """
    forces = _read_forces(trial, settings)
    emg_time, volts = _read_emg(trial, settings)
    notes: list[str] = []
    recorded = _read_recorded_motion(trial, settings, model, notes)
    cycles = _find_cycles(trial, settings, forces, recorded.time, emg_time)
    cutoff = MOTION_HARMONIC / float(np.mean([end - start for start, end in cycles]))
    # Limited to the recorded forces, as inverse dynamics would extrapolate them.
    window = (
        max(cycles[0][0] - MOTION_MARGIN, float(forces.time[0])),
        min(cycles[-1][1] + MOTION_MARGIN, float(forces.time[-1])),
    )

    checks: list[Check] = []
    if isinstance(recorded, Markers):
        log(f"{trial.name}: inverse kinematics")
        filtered = recorded.filtered(cutoff).during(*window)
        motion = _solve_kinematics(filtered, trial, settings, model, checks, notes)
    else:
        motion = _filter_motion(recorded, window, cutoff, model)
    forces = forces.filtered(cutoff).during(motion.time[0] - MOTION_MARGIN, motion.time[-1] + MOTION_MARGIN)
    _raise_failed(trial, trial.motion, checks)
    required_time, mechanics = _analyse_bodies(motion, settings, model)
    mechanical = tuple(_mechanical_checks(required_time, mechanics, forces, cycles, settings))
    _raise_failed(trial, trial.forces, mechanical)
    log(f"{trial.name}: inverse dynamics")
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        write_forces(Path(folder), forces, settings.feet)
        loads = Path(folder) / "external_loads.xml"
        moments = solve_inverse_dynamics(model.path, motion.coordinates, motion.time, motion.values, loads)
    calf = tuple(_calf_checks(motion, moments, emg_time, volts, cycles, settings, notes))
    _raise_failed(trial, trial.emg, calf)
    selected = (emg_time >= cycles[0][0] - EMG_MARGIN) & (emg_time <= cycles[-1][1] + EMG_MARGIN)
    return PreparedTrial(
        trial=trial,
        cycles=cycles,
        cutoff_hz=cutoff,
        motion=motion,
        moments=moments,
        forces=forces,
        required_time=required_time,
        required_force=_required_force(mechanics),
        emg_time=emg_time[selected],
        volts=volts[:, selected],
        checks=(*checks, *mechanical, *calf),
        notes=tuple(notes),
    )


def _raise_failed(trial: LaboratoryTrial, file: Path, checks: Sequence[Check]) -> None:
    """Raise an error with all failed checks; ``file`` is the one that most likely needs correction."""
    faults = [
        Problem(str(file), check.fault, f"trial '{trial.name}', {check.what}", check.hint)
        for check in checks
        if check.fault
    ]
    if faults:
        raise InputError(faults)


def _is_c3d(path: Path) -> bool:
    return path.suffix.lower() == ".c3d"


def _read_forces(trial: LaboratoryTrial, settings: LaboratorySettings) -> FootForces:
    plates = _is_c3d(trial.forces)
    key = "plates" if plates else "force"
    problems = [
        Problem(str(settings.file), f"expected {key}, needed to read {trial.forces}", f"[forces.{side}]")
        for side, foot in settings.feet.items()
        if bool(foot.plates) != plates
    ]
    if problems:
        raise InputError(problems)
    if plates:
        return read_plates(trial.forces, settings.feet, laboratory_rotation(settings.forward, settings.up))
    return read_force_columns(trial.forces, settings.feet)


def _read_recorded_motion(
    trial: LaboratoryTrial, settings: LaboratorySettings, model: PreparationModel, notes: list[str]
) -> Markers | Motion:
    """Read joint angles, or the markers that the model has."""
    if trial.angles is not None:
        return read_motion(trial.angles, model.file.coordinates, model.coupled, settings.coordinates, notes)
    assert trial.markers is not None
    read = read_c3d_markers if _is_c3d(trial.markers) else read_trc
    markers = read(trial.markers).rotated(laboratory_rotation(settings.forward, settings.up))
    names = match_markers(markers, model.markers, settings.ignored_markers, trial.markers)
    missing = [name for name in model.markers if name not in names and name not in settings.ignored_markers]
    if missing:
        notes.append(f"{trial.markers}: lacks the markers {', '.join(missing)} of the model")
    return markers.select(names)


def _read_emg(
    trial: LaboratoryTrial, settings: LaboratorySettings
) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "channel sample"]]:
    """Read raw EMG at the electrode (V) or envelopes, and raise an error for faulty channels."""
    path = trial.emg
    table: Storage = read_c3d_analog(path) if _is_c3d(path) else read_storage(path, trust_row_count=False)
    missing = [name for name in settings.channels if name not in table.columns]
    problems = [
        Problem(str(path), "is not in the file", f"column {name}", nearest_name(name, table.columns))
        for name in missing
    ]
    rate = sampling_rate(table.time)
    raw = settings.emg_kind == "raw"
    if raw and rate < MIN_RAW_EMG_RATE:
        message = f"expected raw EMG at {MIN_RAW_EMG_RATE:g} Hz or more, found {rate:.4g} Hz"
        problems.append(Problem(str(path), message, hint='are these envelopes? Write kind = "envelope"'))
    if problems:
        raise InputError(problems)
    columns = [table.columns.index(name) for name in settings.channels]
    time, volts = resample_evenly(table.time, table.values.T[columns] * settings.volts)
    names = tuple(settings.channels)
    found = emg_faults(names, volts, rate) if raw else envelope_faults(names, volts)
    faults = [
        Problem(str(path), message, f"channel {channel}", hint)
        for channel, message, hint in found
        if channel not in settings.accepted
    ]
    if faults:
        raise InputError(faults)
    return time, volts


def _find_cycles(
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    forces: FootForces,
    motion_time: Float[np.ndarray, " frame"],
    emg_time: Float[np.ndarray, " sample"],
) -> tuple[tuple[float, float], ...]:
    """Return the cycles in the settings, else those between strikes that motion, forces and EMG cover."""
    spans = {"motion": motion_time, "forces": forces.time, "EMG": emg_time}
    start = max(time[0] for time in spans.values())
    end = min(time[-1] for time in spans.values())
    covered = ", ".join(f"{kind} {time[0]:g} to {time[-1]:g} s" for kind, time in spans.items())
    place = f"trial '{trial.name}'"
    if trial.cycles:
        outside = [cycle for cycle in trial.cycles if cycle[0] < start - 1e-6 or cycle[1] > end + 1e-6]
        if outside:
            message = f"expected cycles that all recordings cover ({covered}), found {list(outside[0])} s"
            raise InputError(Problem(str(settings.file), message, place))
        return trial.cycles
    contacts = find_contacts(forces.time, forces.vertical(settings.side))
    cycles = contacts.cycles(start, end)
    if not cycles:
        side = SIDES[settings.side]
        message = (
            f"expected a gait cycle that all recordings cover ({covered}), found {contacts.strikes.size}"
        )
        message = f"{message} strikes of the {side} foot"
        hint = "list the cycles in the settings if there are any"
        raise InputError(Problem(str(trial.forces), message, place, hint))
    return cycles


def _solve_kinematics(
    markers: Markers,
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    model: PreparationModel,
    checks: list[Check],
    notes: list[str],
) -> Motion:
    """Compute joint angles from markers by the inverse kinematics that the settings name."""
    invisible = np.isnan(markers.positions).any(axis=2).sum(axis=1)
    gaps = [
        f"{name} in {count} frames" for name, count in zip(markers.names, invisible, strict=True) if count
    ]
    if gaps:
        notes.append(f"{trial.markers}: markers not visible, and not used there: {', '.join(gaps)}")
    weights = {name: settings.marker_weights.get(name, 1.0) for name in markers.names}
    solver = _solve_by_opensim if settings.inverse_kinematics == "opensim" else _solve_in_jax
    coordinates, values, positions = solver(markers, weights, trial, model)
    checks.append(check_marker_errors(markers.names, markers.positions, positions))
    return Motion(coordinates, markers.time, values).with_coupled(model.coupled)


#: Names of all coordinates, their values, and positions of the model's markers (m).
_Solved = tuple[tuple[str, ...], Float[np.ndarray, "coordinate frame"], Float[np.ndarray, "marker frame 3"]]


def _solve_by_opensim(
    markers: Markers, weights: Mapping[str, float], trial: LaboratoryTrial, model: PreparationModel
) -> _Solved:
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        file = Path(folder) / "markers.trc"
        write_trc(file, markers)
        try:
            solution = solve_inverse_kinematics(
                model.path, file, weights, float(markers.time[0]), float(markers.time[-1])
            )
        except InputError as error:
            # The temporary file is replaced by the recorded one.
            renamed = [replace(problem, file=str(trial.markers)) for problem in error.problems]
            raise InputError(renamed) from error
    return solution.coordinates, solution.values, solution.positions


def _solve_in_jax(
    markers: Markers, weights: Mapping[str, float], trial: LaboratoryTrial, model: PreparationModel
) -> _Solved:
    from wrapjax.preprocessing.inverse_kinematics import solve

    assert trial.markers is not None
    used = np.array([weights[name] for name in markers.names])
    solution = solve(describe_model(model.path), markers, used, {}, trial.markers)
    return solution.coordinates, solution.values, solution.positions


def _filter_motion(
    recorded: Motion, window: tuple[float, float], cutoff: float, model: PreparationModel
) -> Motion:
    """Filter joint angles that the laboratory has computed, and select the window (s)."""
    time, values = resample_evenly(recorded.time, recorded.values)
    smooth = low_pass(time, values, cutoff)
    selected = (time >= window[0] - 1e-9) & (time <= window[1] + 1e-9)
    return Motion(recorded.coordinates, time[selected], smooth[:, selected]).with_coupled(model.coupled)


def _analyse_bodies(
    motion: Motion, settings: LaboratorySettings, model: PreparationModel
) -> tuple[Float[np.ndarray, " frame"], Mechanics]:
    """Compute positions of all bodies, and the forces that the motion requires, at about `MECHANICS_RATE`."""
    independent = motion.without_coupled(model.coupled)
    step = max(1, round((motion.time.size - 1) / (motion.time[-1] - motion.time[0]) / MECHANICS_RATE))
    time = motion.time[::step]
    spline = CubicSpline(independent.time, independent.values, axis=1)
    # Positions, velocities and accelerations.
    derivatives = [spline(time, order) for order in range(3)]
    posed = PosedMotion(independent.coordinates, *derivatives)
    return time, analyse_mechanics(model.path, settings.coordinates, posed)


def _required_force(mechanics: Mechanics) -> Float[np.ndarray, " frame"]:
    """Compute the upward force that supports and accelerates all bodies, N."""
    return np.asarray(mechanics.mass_wrench[:, 4].sum(axis=0))


def _mechanical_checks(
    time: Float[np.ndarray, " frame"],
    mechanics: Mechanics,
    forces: FootForces,
    cycles: Sequence[tuple[float, float]],
    settings: LaboratorySettings,
) -> Iterator[Check]:
    """Check sides, steps, weight and timing of the forces against the motion of the bodies."""
    feet = {side: mechanics.origin[mechanics.bodies.index(foot.body)] for side, foot in settings.feet.items()}
    yield from check_force_sides(time, feet, forces, 9.81 * settings.mass_kg)
    yield from check_foot_on_plates(forces, settings.side, cycles)
    yield from check_forces_against_motion(time, _required_force(mechanics), forces)


def _calf_checks(
    motion: Motion,
    moments: Mapping[str, Float[np.ndarray, " frame"]],
    emg_time: Float[np.ndarray, " sample"],
    volts: Float[np.ndarray, "channel sample"],
    cycles: Sequence[tuple[float, float]],
    settings: LaboratorySettings,
    notes: list[str],
) -> Iterator[Check]:
    """Check the timing of the EMG channels of calf muscles against the ankle moment."""
    ankle = f"ankle_angle_{settings.side}_moment"
    calf = [
        row
        for row, muscles in enumerate(settings.channels.values())
        if any(name.startswith(_CALF_PREFIXES) for name in muscles)
    ]
    if ankle not in moments or not calf:
        notes.append(
            "timing of EMG: not checked, as this needs an EMG channel of a calf muscle and the ankle moment"
        )
        return
    inside = (motion.time >= cycles[0][0]) & (motion.time <= cycles[-1][1])
    duration = float(np.mean([end - start for start, end in cycles]))
    envelopes = volts[calf]
    if settings.emg_kind == "raw":
        envelopes = compute_envelopes(envelopes, sampling_rate(emg_time), duration)
    names = tuple(settings.channels)
    for row, envelope in zip(calf, envelopes, strict=True):
        yield check_calf_emg_against_moment(
            motion.time[inside], -moments[ankle][inside], names[row], emg_time, envelope
        )
