"""Motion, mechanics of the bodies and joint moments of one recording, by OpenSim or as given."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.storage import find_columns, read_storage
from wrapjax.osim.mechanics import Mechanics, analyse_mechanics
from wrapjax.osim.model import describe_model
from wrapjax.osim.motion import Motion as PosedMotion
from wrapjax.osim.tools import solve_inverse_dynamics, solve_inverse_kinematics
from wrapjax.preprocessing.checks.consistency_checks import Check, check_marker_errors
from wrapjax.preprocessing.files.joint_angles import Motion
from wrapjax.preprocessing.files.laboratory_settings import LaboratorySettings, LaboratoryTrial
from wrapjax.preprocessing.files.markers import Markers, low_pass, write_trc
from wrapjax.preprocessing.files.recorded_files import PreparationModel, RecordedFiles
from wrapjax.preprocessing.gait.force_plates import FootForces, write_forces
from wrapjax.subject.emg_envelopes import resample_evenly
from wrapjax.subject.trials import GAIT

#: Motion kept before and after the cycles, s, so that edge effects of filters and derivatives are outside.
MOTION_MARGIN = 0.4
#: Frame rate at which the forces required by the motion are computed, Hz; filtered motion needs no more.
MECHANICS_RATE = 100.0


def raise_failed(trial: LaboratoryTrial, file: Path | None, checks: Sequence[Check]) -> None:
    """Raise an error with all failed checks; ``file`` is the one that most likely needs correction."""
    faults = [
        Problem(str(file), check.fault, f"trial '{trial.name}', {check.what}", check.hint)
        for check in checks
        if check.fault
    ]
    if faults:
        raise InputError(faults)


def solve_motion(
    files: RecordedFiles,
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    model: PreparationModel,
    spans: Sequence[tuple[float, float]],
    cutoff: float,
    notes: list[str],
    log: Callable[[str], None],
) -> tuple[Motion, tuple[Check, ...]]:
    """Compute filtered coordinates over all cycles or intervals with a margin."""
    start, end = (
        min(span[0] for span in spans) - MOTION_MARGIN,
        max(span[1] for span in spans) + MOTION_MARGIN,
    )
    if files.forces is not None:
        # Limited to the recorded forces, as inverse dynamics would extrapolate them.
        start, end = max(start, float(files.forces.time[0])), min(end, float(files.forces.time[-1]))
    checks: list[Check] = []
    if isinstance(files.motion, Markers):
        log(f"{trial.name}: inverse kinematics")
        filtered = files.motion.filtered(cutoff).during(start, end)
        motion = _solve_kinematics(filtered, trial, settings, model, checks, notes)
    else:
        motion = _filter_motion(files.motion, (start, end), cutoff, model)
    raise_failed(trial, trial.motion, checks)
    return motion, tuple(checks)


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


def filtered_forces(forces: FootForces, motion: Motion, cutoff: float) -> FootForces:
    """Low-pass filter forces and select those about the motion."""
    return forces.filtered(cutoff).during(motion.time[0] - MOTION_MARGIN, motion.time[-1] + MOTION_MARGIN)


def analyse_bodies(
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


def required_force(mechanics: Mechanics) -> Float[np.ndarray, " frame"]:
    """Compute the upward force that supports and accelerates all bodies, N."""
    return np.asarray(mechanics.mass_wrench[:, 4].sum(axis=0))


def foot_positions(
    mechanics: Mechanics, settings: LaboratorySettings
) -> dict[str, Float[np.ndarray, "3 frame"]]:
    """Return the position of the origin of each foot's body, m, by side."""
    return {side: mechanics.origin[mechanics.bodies.index(foot.body)] for side, foot in settings.feet.items()}


def trial_moments(
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    model: PreparationModel,
    motion: Motion,
    forces: FootForces | None,
    cutoff: float,
    notes: list[str],
    log: Callable[[str], None],
) -> dict[str, Float[np.ndarray, " frame"]]:
    """Return the laboratory's moments, or compute them by inverse dynamics, N m, by OpenSim's label."""
    if trial.moments is not None:
        return given_moments(trial, settings, motion, cutoff, notes)
    assert forces is not None
    log(f"{trial.name}: inverse dynamics")
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        write_forces(Path(folder), forces, settings.feet)
        loads = Path(folder) / "external_loads.xml"
        return solve_inverse_dynamics(model.path, motion.coordinates, motion.time, motion.values, loads)


def given_moments(
    trial: LaboratoryTrial,
    settings: LaboratorySettings,
    motion: Motion,
    cutoff: float,
    notes: list[str],
) -> dict[str, Float[np.ndarray, " frame"]]:
    """Read the laboratory's moments, filtered like the motion unless their filter is stated."""
    assert trial.moments is not None
    table = read_storage(trial.moments)
    problems, found = [], {}
    for name in settings.coordinates:
        places = find_columns(table.columns, name, ("_moment", "_force", ""))
        if len(places) == 1:
            found[f"{name}_moment"] = table.values[:, places[0]]
        elif places or trial.task == GAIT:
            message = "expected one column, found several" if places else "is not in the file"
            hint = nearest_name(f"{name}_moment", table.columns)
            problems.append(Problem(str(trial.moments), message, f"column {name}_moment", hint))
    if not found and not problems:
        message = "expected a moment about one of the coordinates, found none"
        problems.append(Problem(str(trial.moments), message, hint=nearest_name("moment", table.columns)))
    start, end = min(span[0] for span in trial.cycles or ((motion.time[0], 0.0),)), 0.0
    end = max(span[1] for span in trial.cycles) if trial.cycles else float(motion.time[-1])
    if table.time[0] > start + 1e-6 or table.time[-1] < end - 1e-6:
        covered = f"{table.time[0]:g} to {table.time[-1]:g} s"
        problems.append(
            Problem(str(trial.moments), f"expected moments from {start:g} to {end:g} s, found {covered}")
        )
    if problems:
        raise InputError(problems)
    time, values = resample_evenly(table.time, np.array(list(found.values())))
    if np.isnan(trial.moments_low_pass):
        values = low_pass(time, values, cutoff)
        notes.append(
            f"{trial.moments}: the laboratory's moments, low-passed at {cutoff:.3g} Hz like the motion"
        )
    else:
        notes.append(
            f"{trial.moments}: the laboratory's moments, low-passed by it at {trial.moments_low_pass:g} Hz "
            f"and not again; motion at {cutoff:.3g} Hz"
        )
    inside = np.clip(motion.time, time[0], time[-1])
    return dict(zip(found, CubicSpline(time, values, axis=1)(inside), strict=True))
