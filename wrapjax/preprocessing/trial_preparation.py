"""Preparation of one recording: reading, gait cycles, inverse kinematics and dynamics by OpenSim, checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.preprocessing.checks.consistency_checks import (
    MIN_LOAD_SHARE,
    Check,
    check_calf_emg_against_moment,
    check_foot_on_plates,
    check_force_sides,
    check_forces_against_motion,
    check_support,
)
from wrapjax.preprocessing.dynamometer import DynamometerSettings, compare_angles, read_device_trial
from wrapjax.preprocessing.files.joint_angles import Motion
from wrapjax.preprocessing.files.laboratory_settings import LaboratorySettings, LaboratoryTrial
from wrapjax.preprocessing.files.markers import MOTION_HARMONIC
from wrapjax.preprocessing.files.recorded_files import PreparationModel, RecordedFiles, read_files
from wrapjax.preprocessing.gait.cycle_outliers import (
    dropped_sentences,
    steps_of_other_foot,
    unusual_durations,
    unusual_moments,
)
from wrapjax.preprocessing.gait.flight_steps import (
    MIN_OTHER_SHARE,
    assign_steps,
    find_flight_contacts,
    flight_cycles,
    forces_of_steps,
    is_flight,
    stride_time,
)
from wrapjax.preprocessing.gait.force_plates import SIDES, FootForces
from wrapjax.preprocessing.gait.gait_events import find_contacts
from wrapjax.preprocessing.motion_and_moments import (
    analyse_bodies,
    filtered_forces,
    foot_positions,
    given_moments,
    raise_failed,
    required_force,
    solve_motion,
    trial_moments,
)
from wrapjax.preprocessing.prepared_folder import PreparedTrial
from wrapjax.subject.emg_envelopes import compute_envelopes, sampling_rate
from wrapjax.subject.trials import GAIT
from wrapjax.subject.windows import SETTLING_SECONDS

#: EMG kept before and after the cycles, s, for delays and edge effects of the low-pass filter.
EMG_MARGIN = 1.5
# Share of steps on the other foot's plate above which the plates of the two feet seem exchanged.
_EXCHANGED_SHARE = 0.9
#: Cut-off frequency of motion and forces of tasks other than gait, Hz.
TASK_LOW_PASS = 6.0
#: Prefixes of the names of calf muscles.
_CALF_PREFIXES = ("soleus", "gas")


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
    files = read_files(trial, settings, model)
    if trial.dynamometer is not None:
        return _prepare_dynamometer(files, trial, trial.dynamometer, settings, model, log)
    if trial.task != GAIT:
        return _prepare_task(files, trial, settings, model, log)
    contacts = () if files.forces is None else find_flight_contacts(files.forces)
    if contacts:
        prepared = _prepare_flight_gait(files, contacts, trial, settings, model, log)
        if prepared is not None:
            return prepared
    return _prepare_gait(files, trial, settings, model, log)


def _prepare_gait(
    files: RecordedFiles,
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    model: PreparationModel,
    log: Callable[[str], None],
) -> PreparedTrial:
    """Prepare gait in which a foot is on the ground at any time, or whose moments are given."""
    notes = list(files.notes)
    cycles = _find_cycles(trial, settings, files)
    if not trial.cycles:
        cycles = _without(cycles, unusual_durations(cycles), notes)
    cutoff = _cutoff(trial, float(np.mean([end - start for start, end in cycles])))
    motion, checks = solve_motion(files, trial, settings, model, cycles, cutoff, notes, log)
    if files.forces is None:
        moments = given_moments(trial, settings, motion, cutoff, notes)
        return _finish(files, trial, cycles, cutoff, motion, moments, None, None, checks, notes)
    forces = filtered_forces(files.forces, motion, cutoff)
    required_time, mechanics = analyse_bodies(motion, settings, model)
    feet = foot_positions(mechanics, settings)
    if not trial.cycles:
        least = MIN_LOAD_SHARE * 9.81 * settings.mass_kg
        strange = steps_of_other_foot(cycles, settings.side, required_time, feet, forces, least)
        # Where most are nearer to the other foot, legs are swapped, which the check of sides names.
        cycles = _without(cycles, strange, notes) if 2 * len(strange) < len(cycles) else cycles
    weight = 9.81 * settings.mass_kg
    mechanical = (
        *check_force_sides(required_time, feet, forces, weight),
        *check_foot_on_plates(forces, settings.side, cycles),
        *check_forces_against_motion(required_time, required_force(mechanics), forces),
    )
    raise_failed(trial, trial.forces, mechanical)
    moments = trial_moments(trial, settings, model, motion, forces, cutoff, notes, log)
    cycles = _without_unusual_moments(trial, settings, cycles, motion, moments, notes)
    calf = tuple(_calf_checks(motion, moments, files, cycles, settings, notes))
    raise_failed(trial, trial.emg, calf)
    required = (required_time, required_force(mechanics))
    checks = (*checks, *mechanical, *calf)
    return _finish(files, trial, cycles, cutoff, motion, moments, forces, required, checks, notes)


def _prepare_flight_gait(
    files: RecordedFiles,
    contacts: Sequence[tuple[float, float]],
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    model: PreparationModel,
    log: Callable[[str], None],
) -> PreparedTrial | None:
    """Prepare running; None where the body was not in the air between contacts."""
    assert files.forces is not None
    notes = list(files.notes)
    cutoff = _cutoff(trial, stride_time(contacts))
    span = ((contacts[0][0], contacts[-1][1]),)
    motion, checks = solve_motion(files, trial, settings, model, span, cutoff, notes, log)
    required_time, mechanics = analyse_bodies(motion, settings, model)
    required = required_force(mechanics)
    if not is_flight(required_time, required, contacts, 9.81 * settings.mass_kg):
        return None
    feet = foot_positions(mechanics, settings)
    steps = assign_steps(files.forces, contacts, required_time, feet, trial.steps)
    start, end = (
        pick(limit[place] for limit in files.covered.values()) for place, pick in enumerate((max, min))
    )
    cycles, dropped = flight_cycles(steps, settings.side, start, end)
    moved = sum(step.other_share > MIN_OTHER_SHARE for step in steps)
    notes.append(
        f"gait with flight phases: {len(steps)} steps, each assigned to the foot nearest to the center of "
        f"pressure of all plates; {moved} of them trod the other foot's plate, wholly or in part"
        + ("; are [forces.l] and [forces.r] exchanged?" if moved > _EXCHANGED_SHARE * len(steps) else "")
    )
    if trial.cycles:
        cycles, dropped = trial.cycles, ()
    notes += dropped
    if not cycles:
        message = "expected strikes of the leg's foot with one step of the other in between, found none"
        raise InputError(Problem(str(trial.forces), message, f"trial '{trial.name}'"))
    if not trial.cycles:
        cycles = _without(cycles, unusual_durations(cycles), notes)
    forces = filtered_forces(forces_of_steps(files.forces, steps), motion, cutoff)
    mechanical = (
        *check_force_sides(required_time, feet, forces, 9.81 * settings.mass_kg),
        *check_forces_against_motion(required_time, required, forces),
    )
    raise_failed(trial, trial.forces, mechanical)
    moments = trial_moments(trial, settings, model, motion, forces, cutoff, notes, log)
    cycles = _without_unusual_moments(trial, settings, cycles, motion, moments, notes)
    calf = tuple(_calf_checks(motion, moments, files, cycles, settings, notes))
    raise_failed(trial, trial.emg, calf)
    checks = (*checks, *mechanical, *calf)
    pair = (required_time, required)
    return _finish(files, trial, cycles, cutoff, motion, moments, forces, pair, checks, notes)


def _prepare_task(
    files: RecordedFiles,
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    model: PreparationModel,
    log: Callable[[str], None],
) -> PreparedTrial:
    """Prepare intervals of a task other than gait."""
    notes = list(files.notes)
    _check_covered(trial, settings, files)
    cutoff = TASK_LOW_PASS if np.isnan(trial.low_pass) else trial.low_pass
    intervals = trial.cycles
    motion, checks = solve_motion(files, trial, settings, model, intervals, cutoff, notes, log)
    forces = required = None
    if files.forces is not None:
        forces = filtered_forces(files.forces, motion, cutoff)
        required_time, mechanics = analyse_bodies(motion, settings, model)
        required = (required_time, required_force(mechanics))
        feet = foot_positions(mechanics, settings)
        mechanical = tuple(check_force_sides(required_time, feet, forces, 9.81 * settings.mass_kg))
        mechanical += tuple(check_support(*required, forces, intervals, 9.81 * settings.mass_kg))
        raise_failed(trial, trial.forces, mechanical)
        checks = (*checks, *mechanical)
    moments = trial_moments(trial, settings, model, motion, forces, cutoff, notes, log)
    return _finish(files, trial, intervals, cutoff, motion, moments, forces, required, checks, notes)


def _prepare_dynamometer(
    files: RecordedFiles,
    trial: LaboratoryTrial,
    device: DynamometerSettings,
    settings: LaboratorySettings,
    model: PreparationModel,
    log: Callable[[str], None],
) -> PreparedTrial:
    """Prepare intervals in which a dynamometer measured the moment about one joint."""
    notes = list(files.notes)
    if device.coordinate not in settings.coordinates:
        message = f"expected one of the coordinates of [model], found '{device.coordinate}'"
        place = f"[[trial]] '{trial.name}' dynamometer coordinate"
        hint = nearest_name(device.coordinate, settings.coordinates)
        raise InputError(Problem(str(settings.file), message, place, hint))
    stated = {name for name, _ in trial.posture} | {device.coordinate}
    unknown = [name for name in settings.coordinates if name not in stated]
    if trial.markers is None and trial.angles is None and unknown:
        message = f"expected the posture of every other coordinate, found none of {', '.join(unknown)}"
        hint = f"posture = {{ {unknown[0]} = 0.0 }}, in degrees"
        raise InputError(Problem(str(settings.file), message, f"[[trial]] '{trial.name}' posture", hint))
    _check_covered(trial, settings, files)
    cutoff = TASK_LOW_PASS if np.isnan(trial.low_pass) else trial.low_pass
    measured = read_device_trial(device, trial.task, settings.mass_kg, trial.cycles, cutoff)
    notes += measured.notes
    first, last = min(one[0] for one in trial.cycles), max(one[1] for one in trial.cycles)
    if first < measured.time[0] - 1e-6 or last > measured.time[-1] + 1e-6:
        covered = f"{measured.time[0]:g} to {measured.time[-1]:g} s"
        message = f"expected samples from {first:g} to {last:g} s, found them from {covered}"
        raise InputError(Problem(str(device.file), message, f"trial '{trial.name}'"))
    label = f"{device.coordinate}_moment"
    checks: tuple[Check, ...] = ()
    if trial.markers is None and trial.angles is None:
        motion = Motion((device.coordinate,), measured.time, measured.angle[None])
        moments = {label: measured.moment}
    else:
        motion, checks = solve_motion(files, trial, settings, model, trial.cycles, cutoff, notes, log)
        row = motion.coordinates.index(device.coordinate)
        notes.append(compare_angles(device, measured, motion.time, motion.values[row]))
        moments = {label: np.interp(motion.time, measured.time, measured.moment)}
    return _finish(files, trial, trial.cycles, cutoff, motion, moments, None, None, checks, notes)


def _cutoff(trial: LaboratoryTrial, period: float) -> float:
    """Return the cut-off frequency of motion and forces of gait, Hz."""
    return MOTION_HARMONIC / period if np.isnan(trial.low_pass) else trial.low_pass


def _without(
    cycles: tuple[tuple[float, float], ...], unusual: Mapping[tuple[float, float], str], notes: list[str]
) -> tuple[tuple[float, float], ...]:
    """Drop unusual cycles, and note each with its reason."""
    notes += dropped_sentences(unusual)
    return tuple(cycle for cycle in cycles if cycle not in unusual)


def _without_unusual_moments(
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    cycles: tuple[tuple[float, float], ...],
    motion: Motion,
    moments: Mapping[str, Float[np.ndarray, " frame"]],
    notes: list[str],
) -> tuple[tuple[float, float], ...]:
    """Drop cycles with unusual moments; those that a person listed are kept and named."""
    own = {
        name: moment for name, moment in moments.items() if name[: -len("_moment")] in settings.coordinates
    }
    unusual = unusual_moments(cycles, motion.time, own)
    if trial.cycles:
        notes += [line.replace("dropped", "is unusual") for line in dropped_sentences(unusual)]
        return cycles
    return _without(cycles, unusual, notes)


def _finish(
    files: RecordedFiles,
    trial: LaboratoryTrial,
    cycles: tuple[tuple[float, float], ...],
    cutoff: float,
    motion: Motion,
    moments: dict[str, Float[np.ndarray, " frame"]],
    forces: FootForces | None,
    required: tuple[Float[np.ndarray, " required_frame"], Float[np.ndarray, " required_frame"]] | None,
    checks: Sequence[Check],
    notes: Sequence[str],
) -> PreparedTrial:
    """Collect a prepared trial, with the EMG about its cycles."""
    emg_time = volts = None
    if files.emg_time is not None and files.volts is not None:
        first, last = cycles[0][0], max(end for _, end in cycles)
        margin = EMG_MARGIN if trial.task == GAIT else EMG_MARGIN + SETTLING_SECONDS
        selected = (files.emg_time >= first - margin) & (files.emg_time <= last + EMG_MARGIN)
        emg_time, volts = files.emg_time[selected], files.volts[:, selected]
    nothing = np.zeros(0)
    required_time, required_force = required if required is not None else (nothing, nothing)
    return PreparedTrial(
        trial=trial,
        cycles=cycles,
        cutoff_hz=cutoff,
        motion=motion,
        moments=moments,
        forces=forces,
        required_time=required_time,
        required_force=required_force,
        emg_time=emg_time,
        volts=volts,
        checks=tuple(checks),
        notes=tuple(notes),
    )


def _check_covered(
    trial: LaboratoryTrial, settings: LaboratorySettings, files: RecordedFiles
) -> tuple[float, float, str]:
    """Return the first and last time that all files cover, s, with words; report cycles outside."""
    start = max(limits[0] for limits in files.covered.values())
    end = min(limits[1] for limits in files.covered.values())
    covered = ", ".join(f"{kind} {limits[0]:g} to {limits[1]:g} s" for kind, limits in files.covered.items())
    outside = [cycle for cycle in trial.cycles if cycle[0] < start - 1e-6 or cycle[1] > end + 1e-6]
    if outside:
        noun = "cycles" if trial.task == GAIT else "intervals"
        message = f"expected {noun} that all recordings cover ({covered}), found {list(outside[0])} s"
        raise InputError(Problem(str(settings.file), message, f"trial '{trial.name}'"))
    return start, end, covered


def _find_cycles(
    trial: LaboratoryTrial, settings: LaboratorySettings, files: RecordedFiles
) -> tuple[tuple[float, float], ...]:
    """Return the cycles in the settings, else those between strikes that motion, forces and EMG cover."""
    start, end, covered = _check_covered(trial, settings, files)
    if trial.cycles:
        return trial.cycles
    assert files.forces is not None
    contacts = find_contacts(files.forces.time, files.forces.vertical(settings.side))
    cycles = contacts.cycles(start, end)
    if not cycles:
        side = SIDES[settings.side]
        message = (
            f"expected a gait cycle that all recordings cover ({covered}), found {contacts.strikes.size}"
        )
        message = f"{message} strikes of the {side} foot"
        hint = "list the cycles in the settings if there are any"
        raise InputError(Problem(str(trial.forces), message, f"trial '{trial.name}'", hint))
    return cycles


def _calf_checks(
    motion: Motion,
    moments: Mapping[str, Float[np.ndarray, " frame"]],
    files: RecordedFiles,
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
    emg_time, volts = files.emg_time, files.volts
    if ankle not in moments or not calf or emg_time is None or volts is None:
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
