"""Personalisation of a model's joints from markers (`personalize_joints`)."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.errors import InputError, Problem
from wrapjax.geometry.inverse_kinematics import MarkerGoals
from wrapjax.geometry.marker_model import MarkerModel, build_marker_model
from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.skeleton import body_poses, stations
from wrapjax.joints.changed_skeleton import skeleton_change
from wrapjax.joints.estimation import Frames, JointProblem, SkinMovement, fit_poses, in_blocks
from wrapjax.joints.freed_parameters import (
    FRAME_KINDS,
    FreedParameter,
    check_spanned,
    default_parameters,
    spanned_joints,
    with_widths,
)
from wrapjax.joints.identifiability import posterior
from wrapjax.joints.nmsm_settings import read_nmsm_settings
from wrapjax.joints.result import JointPersonalisation, TrialErrors
from wrapjax.joints.settings import HELD_OUT_SHARE, JointSettings, MarkerTrial, read_joint_settings
from wrapjax.osim.model import describe_model
from wrapjax.osim.personalised_joints import JointChanges, write_model_with_joints
from wrapjax.preprocessing.inverse_kinematics import (
    InverseKinematics,
    check_constraints,
    coordinate_bounds,
    free_coordinates,
    marker_goals,
    read_marker_file,
    solve,
)
from wrapjax.preprocessing.marker_checks import check_one_person
from wrapjax.preprocessing.markers import Markers, match_markers

#: Standard deviation of a marker's coordinate beside movements of skin, m, before it is estimated.
INITIAL_NOISE = 0.005
#: Lowest standard deviation that is estimated, m: cameras are hardly better.
MIN_NOISE = 0.0005
#: Rounds of estimation; each begins with the noise of the one before.
ROUNDS = 3
#: Coordinates that spread less are taken to rest, rad or m.
MIN_SPREAD = np.radians(1.0)
#: Solver: the posterior is far wider than these tolerances.
SOLVER = ProjectedLevenbergMarquardt(gtol=1e-5, ftol=1e-8, max_iterations=80)


@dataclass(frozen=True)
class _Recording:
    """Recording of markers with the frames that take part in the estimation."""

    trial: MarkerTrial
    markers: Markers
    kinematics: InverseKinematics
    used: Bool[np.ndarray, " frame"]


def personalize_joints(
    settings: JointSettings | Path | str, *, log: Callable[[str], None] = lambda line: None
) -> JointPersonalisation:
    """Personalise joint frames, body scales and marker places of a model from recorded markers.

    The cost is the sum of squared marker distances, in units of their noise, over the frames of all trials
    with the poses eliminated, plus squared changes in units of their prior standard deviations. Noise and its
    correlation in time are estimated from the residuals. What markers do not determine keeps its prior, and
    is named in the result.

    Parameters
    ----------
    settings
        Settings, their TOML file, a folder that holds ``joints.toml``, or settings of the NMSM Pipeline's
        joint model personalization (.xml).
    log
        Function called with each line of progress.

    Returns
    -------
    JointPersonalisation
        Changes with their posterior standard deviations, marker errors before and after, and the model.

    Raises
    ------
    InputError
        With all faults of the files: unknown joints, joints that no marker spans, markers in another unit,
        left and right exchanged, files of two people.

    Examples
    --------
    >>> wrapjax.personalize_joints("lab.toml").save("joints")  # doctest: +SKIP
    """
    settings = settings if isinstance(settings, JointSettings) else _read_settings(Path(settings))
    began = time.perf_counter()
    description = describe_model(settings.model_file, settings.marker_set)
    check_constraints(description)
    recordings = _read_recordings(settings, description)
    names = _common_names([markers for _, markers in recordings], description)
    parameters = freed_parameters(settings, description, names)
    log(f"inverse kinematics of {sum(markers.time.size for _, markers in recordings)} frames")
    validated = any(trial.use == "validation" for trial, _ in recordings)
    solved = [
        _Recording(
            trial=trial,
            markers=markers,
            kinematics=_kinematics(settings, description, trial, markers),
            used=_used_frames(trial, markers.time.size, validated=validated),
        )
        for trial, markers in recordings
    ]
    log(f"estimating {len(parameters)} parameters")
    problem, counts = build_problem(settings, description, solved, names, parameters)
    first, variables = problem, np.zeros(problem.lower.size)
    for number in range(ROUNDS):
        solution = SOLVER.solve(problem, variables)
        log(f"{solution.iterations} iterations, {time.perf_counter() - began:.1f} s")
        variables = solution.variables
        noise, independent = _noise(problem, variables, counts)
        log(f"round {number + 1}: noise {1e3 * noise:.2f} mm, {independent:.0f} independent frames")
        if number + 1 < ROUNDS:
            problem = _next_round(first, problem, variables, noise, independent)
    changes = joint_changes(problem, parameters, names, variables)
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        written = Path(folder) / "model_joints.osim"
        write_model_with_joints(settings.model_file, written, changes, settings.marker_set)
        changed = describe_model(written)
        content = written.read_bytes()
    log("inverse kinematics with the personalised joints")
    errors = tuple(
        TrialErrors(
            name=entry.trial.name,
            use=entry.trial.use,
            used=entry.used,
            before=entry.kinematics,
            after=_kinematics(settings, changed, entry.trial, entry.markers),
        )
        for entry in solved
    )
    known = posterior(parameters, np.asarray(solution.linearization.gauss_newton))
    return JointPersonalisation(
        settings=settings,
        before=description,
        after=changed,
        model=content,
        parameters=tuple(parameters),
        values=np.asarray(problem.parameters(variables)),
        posterior=known,
        trials=errors,
        noise=noise,
        independent_frames=independent,
        status=solution.status,
        seconds=time.perf_counter() - began,
    )


def _read_settings(file: Path) -> JointSettings:
    return read_nmsm_settings(file) if file.suffix.lower() == ".xml" else read_joint_settings(file)


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


def _kinematics(
    settings: JointSettings, description: ModelDescription, trial: MarkerTrial, markers: Markers
) -> InverseKinematics:
    weights = np.array([settings.marker_weights.get(name, 1.0) for name in markers.names])
    return solve(description, markers, weights, {}, trial.file)


def _used_frames(trial: MarkerTrial, count: int, *, validated: bool) -> Bool[np.ndarray, " frame"]:
    """Choose the frames for the estimation; where no trial validates, the last part is held out."""
    kept = count if validated else max(1, round((1.0 - HELD_OUT_SHARE) * count))
    return (np.arange(count) < kept) & (trial.use == "calibration")


def build_problem(
    settings: JointSettings,
    description: ModelDescription,
    recordings: Sequence[_Recording],
    names: tuple[str, ...],
    parameters: Sequence[FreedParameter],
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
    goals, starts, precision = [], [], []
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
        order = [entry.kinematics.coordinates.index(name) for name in coordinates]
        starts.append(entry.kinematics.values[order][:, rows].T)
        visible = np.isfinite(chosen.positions).all(axis=-1).T[rows] @ weights
        precision.append(entry.trial.weight * visible / INITIAL_NOISE**2)
    joined = MarkerGoals(*(np.concatenate(parts) for parts in zip(*goals, strict=True)))
    poses, weight = np.concatenate(starts), np.concatenate(precision)
    skin, features = _skin(settings, description, model, names, coordinates, parameters, poses)
    blocked = in_blocks(weight)
    filled = np.arange(blocked.size).reshape(blocked.shape) < weight.size
    frames = Frames(
        goals=MarkerGoals(*(in_blocks(array) for array in joined)),
        precision=np.where(filled, blocked, 0.0),
        features=in_blocks(features),
        starts=in_blocks(poses),
    )
    problem = JointProblem(
        model=model,
        change=skeleton_change(description, model, names, parameters),
        skin=skin,
        frames=frames,
        pose_bounds=coordinate_bounds(free),
        sd=np.array([parameter.sd for parameter in parameters]),
        limits=(
            np.array([parameter.lower for parameter in parameters]),
            np.array([parameter.upper for parameter in parameters]),
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


def _skin(
    settings: JointSettings,
    description: ModelDescription,
    model: MarkerModel,
    names: tuple[str, ...],
    coordinates: Sequence[str],
    parameters: Sequence[FreedParameter],
    poses: Float[np.ndarray, "frame coordinate"],
) -> tuple[SkinMovement, Float[np.ndarray, "frame feature"]]:
    """Build the movements of skin: of markers on bodies at freed joints, with the angles of these joints."""
    spread = poses.std(axis=0)
    freed = {parameter.owner for parameter in parameters if parameter.kind in FRAME_KINDS}
    bodies: dict[str, list[int]] = {}
    for joint in description.joints:
        if joint.name in freed and settings.skin_movement > 0.0:
            columns = [coordinates.index(name) for name in joint.coordinates if name in coordinates]
            for body in (joint.parent_body, joint.child_body):
                bodies.setdefault(body, []).extend(
                    column for column in columns if spread[column] > MIN_SPREAD
                )
    rows = [
        (marker, axis, column, settings.skin_movement / np.sqrt(3.0 * len(bodies[body])))
        for marker, carrier in enumerate(model.carriers)
        if (body := model.structure.bodies[carrier]) in bodies
        for column in bodies[body]
        for axis in range(3)
    ]
    markers, axes, columns_of, sds = zip(*rows, strict=True) if rows else ((), (), (), ())
    skin = SkinMovement(tuple(markers), tuple(axes), tuple(columns_of), np.array(sds))
    return skin, _standardised(poses, poses)


def _noise(
    problem: JointProblem, variables: Float[np.ndarray, " variable"], counts: Sequence[int]
) -> tuple[float, float]:
    """Estimate the noise of a marker's coordinate, m, and the number of independent frames."""
    residuals = _residuals(problem, variables, sum(counts))
    visible = np.isfinite(residuals).all(axis=-1).sum(axis=1)
    freedoms = np.maximum(3 * visible - len(problem.model.structure.coordinates), 1)
    noise = float(np.sqrt(np.nansum(residuals**2) / freedoms.sum()))
    independent = sum(_independent_frames(part) for part in np.split(residuals, np.cumsum(counts)[:-1]))
    return max(noise, MIN_NOISE), independent


def _residuals(
    problem: JointProblem, variables: Float[np.ndarray, " variable"], count: int
) -> Float[np.ndarray, "frame marker 3"]:
    """Differences of the model's markers from those measured, m; NaN where a marker was not visible."""
    poses, goals, features = (
        np.asarray(array).reshape(-1, *array.shape[2:])[:count]
        for array in (
            fit_poses(problem, variables).poses,
            problem.frames.goals.measured,
            problem.frames.features,
        )
    )
    weights = np.asarray(problem.frames.goals.weights).reshape(-1, goals.shape[1])[:count]
    model, skin = problem.change.apply(problem.model, problem.parameters(variables)), problem.skin
    locations = np.repeat(np.asarray(model.locations)[None], count, axis=0)
    moved = variables[len(problem.sd) :] * skin.sd * features[:, np.array(skin.features, dtype=int)]
    for column, (marker, axis) in enumerate(zip(skin.markers, skin.axes, strict=True)):
        locations[:, marker, axis] += moved[:, column]
    skeleton = jax.tree.map(np.asarray, model.skeleton)
    positions = stations(body_poses(model.structure, skeleton, poses), np.array(model.carriers), locations)
    return np.where(weights[..., None] > 0.0, positions - goals, np.nan)


def _independent_frames(residuals: Float[np.ndarray, "frame marker 3"]) -> float:
    """Divide the number of frames by the correlation time of the residuals, up to its first zero."""
    centred = np.nan_to_num(residuals)
    count = len(centred)
    spectrum = np.abs(np.fft.rfft(centred, 2 * count, axis=0)) ** 2
    correlation = np.fft.irfft(spectrum.sum(axis=(1, 2)))[:count]
    if correlation[0] <= 0.0:
        return float(count)
    correlation = correlation / correlation[0]
    end = int(np.argmax(correlation <= 0.0)) or count
    return count / max(1.0, 2.0 * float(correlation[:end].sum()) - 1.0)


def _next_round(
    first: JointProblem,
    last: JointProblem,
    variables: Float[np.ndarray, " variable"],
    noise: float,
    independent: float,
) -> JointProblem:
    """Weight frames by noise and independence, and take poses and angles of the last round.

    Angles about the starting model's axes explain the movement of skin less well than about better axes.
    """
    precision = np.asarray(first.frames.precision)
    used = precision > 0.0
    factor = INITIAL_NOISE**2 / noise**2 * min(1.0, independent / used.sum())
    poses = np.asarray(fit_poses(last, variables).poses)
    frames = first.frames._replace(
        precision=precision * factor, starts=poses, features=_standardised(poses, poses[used])
    )
    return JointProblem(
        first.model, first.change, first.skin, frames, first.pose_bounds, first.sd, first.limits
    )


def _standardised(
    poses: Float[np.ndarray, "... coordinate"], among: Float[np.ndarray, "frame coordinate"]
) -> Float[np.ndarray, "... coordinate"]:
    """Subtract the mean of coordinates and divide by their spread among some frames, if they move at all."""
    spread = among.std(axis=0)
    return (poses - among.mean(axis=0)) / np.where(spread > MIN_SPREAD, spread, 1.0)


def joint_changes(
    problem: JointProblem,
    parameters: Sequence[FreedParameter],
    names: Sequence[str],
    variables: Float[np.ndarray, " variable"],
) -> JointChanges:
    """Collect the changes of frames, scales and markers for the model's file."""
    structure, change = problem.model.structure, problem.change
    values = np.asarray(problem.parameters(variables))
    changed = change.apply(problem.model, values)
    skeleton = changed.skeleton
    scales = 1.0 + np.asarray(change.scales @ values)
    scaled = {parameter.owner for parameter in parameters if parameter.kind == "scale"}
    moved = {parameter.owner for parameter in parameters if parameter.kind in FRAME_KINDS}
    placed = {parameter.owner for parameter in parameters if parameter.kind == "marker"}
    rows = {name: structure.joints.index(name) for name in structure.joints if name in moved}

    def frame(kind: str, row: int) -> tuple[np.ndarray, np.ndarray]:
        rotation, origin = (getattr(skeleton, f"{kind}_{part}")[row] for part in ("rotation", "origin"))
        return np.asarray(rotation), np.asarray(origin)

    return JointChanges(
        scales={body: scales[structure.bodies.index(body)] for body in structure.bodies if body in scaled},
        frames={name: (frame("parent", row), frame("child", row)) for name, row in rows.items()},
        markers={
            name: np.asarray(changed.locations)[row] for row, name in enumerate(names) if name in placed
        },
    )
