"""One recording of a laboratory: read, checked, solved by OpenSim's tools."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.model_description import Coordinate
from wrapjax.io.model_file import ModelFile
from wrapjax.io.storage import Storage, read_storage
from wrapjax.osim.inverse_dynamics import Mechanics, analyse_mechanics
from wrapjax.osim.motion import Motion as PosedMotion
from wrapjax.osim.tools import solve_inverse_dynamics, solve_inverse_kinematics
from wrapjax.preprocessing.alignment import (
    Check,
    calf_against_moment,
    forces_against_motion,
    legs_of_forces,
    markers_followed,
    own_steps_measured,
)
from wrapjax.preprocessing.c3d import read_c3d_analog, read_c3d_markers, read_plates
from wrapjax.preprocessing.emg_quality import emg_faults, envelope_faults
from wrapjax.preprocessing.filters import MOTION_HARMONIC, laboratory_axes, low_pass
from wrapjax.preprocessing.force_plates import SIDES, FootForces, read_force_columns, write_forces
from wrapjax.preprocessing.gait_events import find_contacts
from wrapjax.preprocessing.joint_angles import Motion, read_motion
from wrapjax.preprocessing.laboratory_settings import RawSettings, RawTrial
from wrapjax.preprocessing.markers import Markers, follow, read_trc, write_trc
from wrapjax.preprocessing.prepared_folder import PreparedTrial
from wrapjax.subject.emg import envelopes_of_raw, even_samples, sampling_rate
from wrapjax.subject.recordings import LEAST_RAW_RATE

#: Motion kept before and after the cycles, s, so that filters and derivatives have settled.
MOTION_MARGIN = 0.4
#: EMG kept before and after the cycles, s: delays, and the slow filter's settling.
EMG_MARGIN = 1.5
#: Frames a second at which Newton's law is asked of all bodies: the motion has no more in it.
MECHANICS_RATE = 100.0
#: What names of the calf's muscles start with.
_CALF = ("soleus", "gas")


@dataclass(frozen=True)
class RawModel:
    """The model as the preparation of all trials needs it.

    Parameters
    ----------
    path, file
        Where it is, and what its file says.
    couplers
        Coordinates that follow others.
    markers
        Names.
    """

    path: Path
    file: ModelFile
    couplers: Mapping[str, Coordinate]
    markers: tuple[str, ...]


def prepare_trial(
    trial: RawTrial, settings: RawSettings, model: RawModel, log: Callable[[str], None]
) -> PreparedTrial:
    """Read a recording, solve its motion and moments, and check that all of it belongs together.

    Raises
    ------
    InputError
        With everything wrong in the files, or with every check that fails.
    """
    forces = _forces(trial, settings)
    emg_time, volts = _emg(trial, settings)
    notes: list[str] = []
    recorded = _recorded(trial, settings, model, notes)
    cycles = _cycles(trial, settings, forces, recorded.time, emg_time)
    cutoff = MOTION_HARMONIC / float(np.mean([end - start for start, end in cycles]))
    # No further than forces go: inverse dynamics would make some up.
    window = (
        max(cycles[0][0] - MOTION_MARGIN, float(forces.time[0])),
        min(cycles[-1][1] + MOTION_MARGIN, float(forces.time[-1])),
    )

    checks: list[Check] = []
    if isinstance(recorded, Markers):
        log(f"{trial.name}: inverse kinematics")
        motion = _followed(recorded.filtered(cutoff).during(*window), trial, settings, model, checks, notes)
    else:
        motion = _smoothed(recorded, window, cutoff, model)
    forces = forces.filtered(cutoff).during(motion.time[0] - MOTION_MARGIN, motion.time[-1] + MOTION_MARGIN)
    _refuse(trial, trial.motion, checks)
    posed_at, mechanics = _moving_bodies(motion, settings, model)
    mechanical = tuple(_mechanical_checks(posed_at, mechanics, forces, cycles, settings))
    _refuse(trial, trial.forces, mechanical)
    log(f"{trial.name}: inverse dynamics")
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        write_forces(Path(folder), forces, settings.feet)
        loads = Path(folder) / "external_loads.xml"
        moments = solve_inverse_dynamics(model.path, motion.coordinates, motion.time, motion.values, loads)
    calf = tuple(_calf_checks(motion, moments, emg_time, volts, cycles, settings, notes))
    _refuse(trial, trial.emg, calf)
    kept = (emg_time >= cycles[0][0] - EMG_MARGIN) & (emg_time <= cycles[-1][1] + EMG_MARGIN)
    return PreparedTrial(
        trial=trial,
        cycles=cycles,
        cutoff_hz=cutoff,
        motion=motion,
        moments=moments,
        forces=forces,
        needed_time=posed_at,
        needed_force=_needed(mechanics),
        emg_time=emg_time[kept],
        volts=volts[:, kept],
        checks=(*checks, *mechanical, *calf),
        notes=tuple(notes),
    )


def _refuse(trial: RawTrial, file: Path, checks: Sequence[Check]) -> None:
    """Raise with every check that failed, naming the file that has most likely to be mended."""
    faults = [
        Problem(str(file), check.fault, f"trial '{trial.name}', {check.what}", check.hint)
        for check in checks
        if check.fault
    ]
    if faults:
        raise InputError(faults)


def _is_c3d(path: Path) -> bool:
    return path.suffix.lower() == ".c3d"


def _forces(trial: RawTrial, settings: RawSettings) -> FootForces:
    plates = _is_c3d(trial.forces)
    key = "plates" if plates else "force"
    problems = [
        Problem(str(settings.file), f"expected {key}, by which {trial.forces} is read", f"[forces.{side}]")
        for side, foot in settings.feet.items()
        if bool(foot.plates) != plates
    ]
    if problems:
        raise InputError(problems)
    if plates:
        return read_plates(trial.forces, settings.feet, laboratory_axes(settings.forward, settings.up))
    return read_force_columns(trial.forces, settings.feet)


def _recorded(trial: RawTrial, settings: RawSettings, model: RawModel, notes: list[str]) -> Markers | Motion:
    if trial.angles is not None:
        return read_motion(trial.angles, model.file.coordinates, model.couplers, settings.coordinates, notes)
    assert trial.markers is not None
    read = read_c3d_markers if _is_c3d(trial.markers) else read_trc
    markers = read(trial.markers).turned(laboratory_axes(settings.forward, settings.up))
    names = follow(markers, model.markers, settings.ignored_markers, trial.markers)
    left = [name for name in model.markers if name not in names and name not in settings.ignored_markers]
    if left:
        notes.append(f"{trial.markers}: has no {', '.join(left)}, which the model has")
    return markers.select(names)


def _emg(
    trial: RawTrial, settings: RawSettings
) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "channel sample"]]:
    """Read raw EMG in volts at the electrode, or envelopes, and refuse channels that are none."""
    path = trial.emg
    table: Storage = read_c3d_analog(path) if _is_c3d(path) else read_storage(path, trust_row_count=False)
    missing = [name for name in settings.channels if name not in table.columns]
    problems = [
        Problem(str(path), "is not in the file", f"column {name}", nearest_name(name, table.columns))
        for name in missing
    ]
    rate = sampling_rate(table.time)
    raw = settings.emg_kind == "raw"
    if raw and rate < LEAST_RAW_RATE:
        message = f"expected raw EMG at {LEAST_RAW_RATE:g} Hz or more, found {rate:.4g} Hz"
        problems.append(Problem(str(path), message, hint='are these envelopes? Write kind = "envelope"'))
    if problems:
        raise InputError(problems)
    columns = [table.columns.index(name) for name in settings.channels]
    time, volts = even_samples(table.time, table.values.T[columns] * settings.volts)
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


def _cycles(
    trial: RawTrial,
    settings: RawSettings,
    forces: FootForces,
    motion_time: Float[np.ndarray, " frame"],
    emg_time: Float[np.ndarray, " sample"],
) -> tuple[tuple[float, float], ...]:
    """Take the cycles listed, or those between strikes that all three recordings cover."""
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
        raise InputError(Problem(str(trial.forces), message, place, "list them as cycles, if there are any"))
    return cycles


def _followed(
    markers: Markers,
    trial: RawTrial,
    settings: RawSettings,
    model: RawModel,
    checks: list[Check],
    notes: list[str],
) -> Motion:
    """Let the model follow the markers."""
    unseen = np.isnan(markers.positions).any(axis=2).sum(axis=1)
    gaps = [f"{name} in {count} frames" for name, count in zip(markers.names, unseen, strict=True) if count]
    if gaps:
        notes.append(f"{trial.markers}: not seen, and not followed there: {', '.join(gaps)}")
    weights = {name: settings.marker_weights.get(name, 1.0) for name in markers.names}
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        file = Path(folder) / "markers.trc"
        write_trc(file, markers)
        try:
            found = solve_inverse_kinematics(
                model.path, file, weights, float(markers.time[0]), float(markers.time[-1])
            )
        except InputError as error:
            renamed = [
                Problem(str(trial.markers), each.message, each.place, each.hint) for each in error.problems
            ]
            raise InputError(renamed) from error
    checks.append(markers_followed(markers.names, markers.positions, found.positions))
    return Motion(found.coordinates, markers.time, found.values).coupled(model.couplers)


def _smoothed(recorded: Motion, window: tuple[float, float], cutoff: float, model: RawModel) -> Motion:
    """Filter joint angles that were solved elsewhere."""
    time, values = even_samples(recorded.time, recorded.values)
    smooth = low_pass(time, values, cutoff)
    kept = (time >= window[0] - 1e-9) & (time <= window[1] + 1e-9)
    return Motion(recorded.coordinates, time[kept], smooth[:, kept]).coupled(model.couplers)


def _moving_bodies(
    motion: Motion, settings: RawSettings, model: RawModel
) -> tuple[Float[np.ndarray, " frame"], Mechanics]:
    """Ask Newton's law of all bodies, at as many frames as motion has something new in."""
    free = motion.independent(model.couplers)
    step = max(1, round((motion.time.size - 1) / (motion.time[-1] - motion.time[0]) / MECHANICS_RATE))
    time = motion.time[::step]
    spline = CubicSpline(free.time, free.values, axis=1)
    motions = [spline(time, order) for order in range(3)]
    posed = PosedMotion(free.coordinates, *motions)
    return time, analyse_mechanics(model.path, settings.coordinates, posed)


def _needed(mechanics: Mechanics) -> Float[np.ndarray, " frame"]:
    """Sum the upward force that bears and accelerates all bodies, N."""
    return np.asarray(mechanics.of_mass[:, 4].sum(axis=0))


def _mechanical_checks(
    time: Float[np.ndarray, " frame"],
    mechanics: Mechanics,
    forces: FootForces,
    cycles: Sequence[tuple[float, float]],
    settings: RawSettings,
) -> Iterator[Check]:
    """Check weight, timing and legs of the forces by the bodies' motion."""
    feet = {side: mechanics.origin[mechanics.bodies.index(foot.body)] for side, foot in settings.feet.items()}
    yield from legs_of_forces(time, feet, forces, 9.81 * settings.mass_kg)
    yield from own_steps_measured(forces, settings.side, cycles)
    yield from forces_against_motion(time, _needed(mechanics), forces)


def _calf_checks(
    motion: Motion,
    moments: Mapping[str, Float[np.ndarray, " frame"]],
    emg_time: Float[np.ndarray, " sample"],
    volts: Float[np.ndarray, "channel sample"],
    cycles: Sequence[tuple[float, float]],
    settings: RawSettings,
    notes: list[str],
) -> Iterator[Check]:
    """Check when the calf's channels are active by the moment about their ankle."""
    ankle = f"ankle_angle_{settings.side}_moment"
    calf = [
        row
        for row, muscles in enumerate(settings.channels.values())
        if any(name.startswith(_CALF) for name in muscles)
    ]
    if ankle not in moments or not calf:
        notes.append("timing of EMG: not checked, which takes a channel of the calf and the ankle's moment")
        return
    inside = (motion.time >= cycles[0][0]) & (motion.time <= cycles[-1][1])
    duration = float(np.mean([end - start for start, end in cycles]))
    envelopes = volts[calf]
    if settings.emg_kind == "raw":
        envelopes = envelopes_of_raw(envelopes, sampling_rate(emg_time), duration)
    names = tuple(settings.channels)
    for row, envelope in zip(calf, envelopes, strict=True):
        yield calf_against_moment(
            motion.time[inside], -moments[ankle][inside], names[row], emg_time, envelope
        )
