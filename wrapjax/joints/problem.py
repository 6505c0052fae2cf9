"""Building of the least-squares problem of joint personalisation from settings and recorded markers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.inverse_kinematics import MarkerGoals
from wrapjax.geometry.marker_model import build_marker_model
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.joints.changed_skeleton import skeleton_change
from wrapjax.joints.estimation import Frames, JointProblem, in_blocks
from wrapjax.joints.freed_parameters import (
    FRAME_KINDS,
    FreedParameter,
    check_spanned,
    default_parameters,
    spanned_joints,
    with_widths,
)
from wrapjax.joints.settings import HELD_OUT_SHARE, JointSettings, MarkerTrial
from wrapjax.joints.skin import angle_features, drift_functions, skin_movement
from wrapjax.osim.model import describe_model
from wrapjax.preprocessing.checks.marker_checks import check_one_person, other_side
from wrapjax.preprocessing.files.markers import Markers, match_markers
from wrapjax.preprocessing.inverse_kinematics import (
    InverseKinematics,
    check_constraints,
    coordinate_bounds,
    free_coordinates,
    marker_goals,
    read_marker_file,
    solve,
)

#: Standard deviation of a marker's coordinate beside movements of skin, m, before it is estimated.
INITIAL_NOISE = 0.005


@dataclass(frozen=True)
class Recording:
    """Recording of markers with the frames that take part in the estimation."""

    trial: MarkerTrial
    markers: Markers
    kinematics: InverseKinematics
    used: Bool[np.ndarray, " frame"]


@dataclass(frozen=True)
class PreparedProblem:
    """Least-squares problem with what it was built from.

    Parameters
    ----------
    description
        Starting model.
    recordings
        Recordings with their motions by the starting model.
    names
        Names of the markers.
    parameters
        Freed parameters.
    combination
        Map from the problem's unknowns to the parameters.
    problem
        The problem.
    counts
        Number of frames of each calibration trial in the problem.
    """

    description: ModelDescription
    recordings: list[Recording]
    names: tuple[str, ...]
    parameters: list[FreedParameter]
    combination: Float[np.ndarray, "parameter unknown"]
    problem: JointProblem
    counts: list[int]


def prepare_problem(
    settings: JointSettings, log: Callable[[str], None] = lambda line: None
) -> PreparedProblem:
    """Read model and markers, solve the motions, and build the least-squares problem.

    Parameters
    ----------
    settings
        Settings.
    log
        Function called with each line of progress.

    Raises
    ------
    InputError
        With all faults of the files.
    """
    description = describe_model(settings.model_file, settings.marker_set)
    check_constraints(description)
    read = _read_recordings(settings, description)
    names = _common_names([markers for _, markers in read], description)
    parameters = freed_parameters(settings, description, names)
    log(f"inverse kinematics of {sum(markers.time.size for _, markers in read)} frames")
    validated = any(trial.use == "validation" for trial, _ in read)
    recordings = [
        Recording(
            trial=trial,
            markers=markers,
            kinematics=solve_trial(settings, description, trial, markers),
            used=_used_frames(trial, markers.time.size, validated=validated),
        )
        for trial, markers in read
    ]
    combination = (
        symmetric_unknowns(parameters, str(settings.file)) if settings.symmetric else np.eye(len(parameters))
    )
    problem, counts = build_problem(settings, description, recordings, names, parameters, combination)
    return PreparedProblem(description, recordings, names, parameters, combination, problem, counts)


def freed_parameters(
    settings: JointSettings, description: ModelDescription, names: Sequence[str]
) -> list[FreedParameter]:
    """Freed parameters of the settings, checked against the markers.

    Raises
    ------
    InputError
        If a joint is unknown or not spanned by markers, or nothing can be freed.
    """
    file = str(settings.file)
    if settings.parameters is not None:
        joints = dict.fromkeys(entry.owner for entry in settings.parameters if entry.kind in FRAME_KINDS)
        check_spanned(description, tuple(joints), names, file)
        return with_widths(settings.parameters, settings.prior_factor)
    joints_freed = settings.joints
    if joints_freed is None:
        joints_freed = tuple(spanned_joints(description, names))
        if not joints_freed:
            message = "expected a joint with three markers or more on the bodies on both sides, found none"
            raise InputError(Problem(file, message))
    check_spanned(description, joints_freed, names, file)
    freed = default_parameters(
        description,
        names,
        joints_freed,
        settings.widths,
        scales=settings.scales,
        free_markers=settings.free_markers,
    )
    return with_widths(freed, settings.prior_factor)


def _read_recordings(
    settings: JointSettings, description: ModelDescription
) -> list[tuple[MarkerTrial, Markers]]:
    """Read the markers of all trials, and check that they are of one person."""
    names = tuple(marker.name for marker in description.markers)
    recordings = []
    for trial in settings.trials:
        markers = read_marker_file(trial.file).rotated(settings.rotation)
        wanted = names if trial.markers is None else tuple(name for name in names if name in trial.markers)
        markers = markers.select(match_markers(markers, wanted, settings.ignored_markers, trial.file))
        if trial.interval is not None:
            markers = markers.during(*trial.interval)
        if not markers.time.size:
            message = f"expected frames in the interval of trial '{trial.name}', found none"
            raise InputError(Problem(str(trial.file), message, "Time"))
        recordings.append((trial, markers))
    # Two trials may be parts of one file.
    check_one_person(description, {trial.file: markers for trial, markers in recordings})
    return recordings


def _common_names(recordings: Sequence[Markers], description: ModelDescription) -> tuple[str, ...]:
    """Names of the markers that any trial has, in the model's order."""
    recorded = {name for markers in recordings for name in markers.names}
    return tuple(marker.name for marker in description.markers if marker.name in recorded)


def solve_trial(
    settings: JointSettings, description: ModelDescription, trial: MarkerTrial, markers: Markers
) -> InverseKinematics:
    """Solve inverse kinematics of a trial with the settings' weights of markers."""
    weights = np.array([settings.marker_weights.get(name, 1.0) for name in markers.names])
    return solve(description, markers, weights, {}, trial.file)


def _used_frames(trial: MarkerTrial, count: int, *, validated: bool) -> Bool[np.ndarray, " frame"]:
    """Choose the frames for the estimation; where no trial validates, the last part is held out."""
    kept = count if validated else max(1, round((1.0 - HELD_OUT_SHARE) * count))
    return (np.arange(count) < kept) & (trial.use == "calibration")


def build_problem(
    settings: JointSettings,
    description: ModelDescription,
    recordings: Sequence[Recording],
    names: tuple[str, ...],
    parameters: Sequence[FreedParameter],
    combination: Float[np.ndarray, "parameter unknown"],
) -> tuple[JointProblem, list[int]]:
    """Build the least-squares problem from frames that are spread evenly over the calibration trials.

    Returns
    -------
    problem, counts
        The problem, and the number of frames of each calibration trial.
    """
    free = free_coordinates(description)
    coordinates = [entry.name for entry in free]
    model = build_marker_model(description, coordinates, names)
    total = sum(int(entry.used.sum()) for entry in recordings)
    share = min(1.0, settings.frames / total)
    goals, starts, precision, times = [], [], [], []
    for entry in recordings:
        rows = np.flatnonzero(entry.used)
        if not rows.size:
            continue
        # At least two frames of a trial, evenly spread.
        count = min(rows.size, max(2, round(share * rows.size)))
        rows = rows[np.unique(np.round(np.linspace(0, rows.size - 1, count)).astype(int))]
        chosen = _with_all_markers(entry.markers, names)
        weights = np.array([settings.marker_weights.get(name, 1.0) for name in names])
        goal = marker_goals(chosen, weights, free, {})
        goals.append(MarkerGoals(*(array[rows] for array in goal)))
        times.append(entry.markers.time[rows])
        order = [entry.kinematics.coordinates.index(name) for name in coordinates]
        starts.append(entry.kinematics.values[order][:, rows].T)
        visible = np.isfinite(chosen.positions).all(axis=-1).T[rows] @ weights
        precision.append(entry.trial.weight * visible / INITIAL_NOISE**2)
    joined = MarkerGoals(*(np.concatenate(parts) for parts in zip(*goals, strict=True)))
    poses, weight = np.concatenate(starts), np.concatenate(precision)
    drift = drift_functions(times, len(names))
    spread, size = poses.std(axis=0), settings.skin_movement
    skin = skin_movement(description, model, parameters, spread, size, drift.shape[1])
    blocked = in_blocks(weight)
    filled = np.arange(blocked.size).reshape(blocked.shape) < weight.size
    frames = Frames(
        goals=MarkerGoals(*(in_blocks(array) for array in joined)),
        precision=np.where(filled, blocked, 0.0),
        features=in_blocks(angle_features(poses, poses)),
        drift=in_blocks(drift[:, : skin.functions]),
        starts=in_blocks(poses),
    )
    # Prior and bounds of an unknown are those of the first parameter that it gives.
    of_unknowns = [parameters[int(np.argmax(column != 0.0))] for column in combination.T]
    problem = JointProblem(
        model=model,
        change=skeleton_change(description, model, names, parameters, combination),
        skin=skin,
        frames=frames,
        pose_bounds=coordinate_bounds(free),
        sd=np.array([entry.sd for entry in of_unknowns]),
        limits=(
            np.array([entry.lower for entry in of_unknowns]),
            np.array([entry.upper for entry in of_unknowns]),
        ),
    )
    return problem, [len(part) for part in precision]


def _with_all_markers(markers: Markers, names: tuple[str, ...]) -> Markers:
    """Bring the markers of a trial into a common order; those that it lacks are not visible."""
    positions = np.full((len(names), *markers.positions.shape[1:]), np.nan)
    for row, name in enumerate(names):
        if name in markers.names:
            positions[row] = markers.positions[markers.names.index(name)]
    return Markers(names, markers.time, positions)


def symmetric_unknowns(
    parameters: Sequence[FreedParameter], file: str
) -> Float[np.ndarray, "parameter unknown"]:
    """Map unknowns to parameters, those of corresponding joints and bodies of both sides being one unknown.

    In a mirror across the plane of x and y, a translation along z and rotations about x and y change their
    sign. Markers of the two sides are placed by hand, and keep unknowns of their own.

    Parameters
    ----------
    parameters
        Freed parameters.
    file
        File of the settings, for messages.

    Raises
    ------
    InputError
        If the other side of a freed joint or body is not freed alike, or nothing has two sides.
    """
    places = {(entry.kind, entry.owner, entry.axis): place for place, entry in enumerate(parameters)}
    columns, problems, pairs = [], [], 0
    for place, entry in enumerate(parameters):
        column = np.zeros(len(parameters))
        column[place] = 1.0
        other = other_side(entry.owner) if entry.kind in (*FRAME_KINDS, "scale") else entry.owner
        if other != entry.owner:
            partner = places.get((entry.kind, other, entry.axis))
            if partner is None:
                message = f"symmetric sides need '{other}' freed as '{entry.owner}' is, found it not freed"
                problems.append(Problem(file, message, entry.name))
                continue
            if partner < place:
                continue
            pairs += 1
            column[partner] = mirror_sign(entry.kind, entry.axis)
        columns.append(column)
    if not problems and not pairs:
        problems.append(Problem(file, "expected freed joints of both sides for symmetric, found none"))
    if problems:
        raise InputError(problems)
    return np.stack(columns, axis=1)


def mirror_sign(kind: str, axis: int) -> float:
    """Sign of a change of a frame or scale in a mirror across the plane of x and y."""
    if kind == "scale":
        return 1.0
    turned = kind.endswith("orientation")
    return -1.0 if (axis == 2) != turned else 1.0
