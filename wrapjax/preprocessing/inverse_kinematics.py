"""Inverse kinematics of recorded markers (`inverse_kinematics`) and its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.inverse_kinematics import (
    Bounds,
    MarkerGoals,
    fit_first,
    fit_successive,
)
from wrapjax.geometry.marker_model import MarkerModel, build_marker_model
from wrapjax.geometry.skeleton.bodies import all_coordinate_values, body_poses, build_skeleton, stations
from wrapjax.geometry.skeleton.model_description import Coordinate, ModelDescription
from wrapjax.io.files import new_folder, write_json
from wrapjax.io.storage import Storage, write_storage
from wrapjax.jax_setup import require_float64
from wrapjax.osim.model import describe_model, unknown_names
from wrapjax.preprocessing.checks.marker_checks import check_exchanged_sides, check_size, exchanged_sides
from wrapjax.preprocessing.files.c3d import read_c3d_markers
from wrapjax.preprocessing.files.kinematics_settings import CoordinateGoal, KinematicsSettings
from wrapjax.preprocessing.files.markers import Markers, match_markers, read_trc

if TYPE_CHECKING:
    from xarray import Dataset

#: Share of a coordinate that lies in directions which no marker determines, above which it is undetermined.
UNDETERMINED_SHARE = 0.01
#: Directions are undetermined whose information is below this share of the largest one.
NEGLIGIBLE_INFORMATION = 1e-8
_OTHER_CONSTRAINTS = "inverse kinematics here meets joints and coordinate couplers only; use OpenSim's"


@dataclass(frozen=True)
class InverseKinematics:
    """Motion of a model that fits recorded markers.

    Parameters
    ----------
    coordinates
        Names of all coordinates of the model, in its order.
    time
        Times of the frames, s.
    values
        Values of the coordinates, rad or m. Coupled coordinates follow their couplers, locked ones rest.
    markers
        Names of the fitted markers.
    positions
        Positions of the model's markers in ground, m.
    measured
        Measured positions, m; NaN where a marker was not visible.
    weights
        Weights of the markers.
    converged
        Whether each frame is solved.
    determined
        Whether the markers determine each coordinate; others stay near their values in the frame before.
    rotational
        Whether each coordinate is an angle.
    """

    coordinates: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    values: Float[np.ndarray, "coordinate frame"]
    markers: tuple[str, ...]
    positions: Float[np.ndarray, "marker frame 3"]
    measured: Float[np.ndarray, "marker frame 3"]
    weights: Float[np.ndarray, " marker"]
    converged: Bool[np.ndarray, " frame"]
    determined: Bool[np.ndarray, " coordinate"]
    rotational: Bool[np.ndarray, " coordinate"]

    @property
    def distances(self) -> Float[np.ndarray, "marker frame"]:
        """Distances of the model's markers from the measured ones, m; NaN where a marker was not visible."""
        return np.linalg.norm(self.positions - self.measured, axis=-1)

    @property
    def rms(self) -> float:
        """Root mean square of all distances, m."""
        return float(np.sqrt(np.nanmean(self.distances**2)))

    def summary(self) -> dict[str, Any]:
        """Return the content of ``ik.json``."""
        by_marker = np.sqrt(np.nanmean(self.distances**2, axis=1))
        return {
            "schema": 1,
            "frames": self.time.size,
            "converged_frames": int(self.converged.sum()),
            "rms_mm": 1e3 * self.rms,
            "max_mm": 1e3 * float(np.nanmax(self.distances)),
            "markers_rms_mm": dict(zip(self.markers, 1e3 * by_marker, strict=True)),
            "undetermined": [
                name for name, yes in zip(self.coordinates, self.determined, strict=True) if not yes
            ],
        }

    def to_dataset(self) -> Dataset:
        """Return coordinates and markers as an `xarray.Dataset`."""
        from wrapjax.report.labelled.geometry import inverse_kinematics_dataset

        return inverse_kinematics_dataset(self)

    def save(self, folder: Path | str, *, force: bool = False) -> None:
        """Write ``angles.sto`` (rad, m), ``marker_errors.sto`` (m) and ``ik.json`` atomically.

        Parameters
        ----------
        folder
            Folder to create.
        force
            Replace an existing folder.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is false.
        """
        with new_folder(Path(folder), force=force) as temporary:
            write_storage(
                temporary / "angles.sto", Storage("Coordinates", self.coordinates, self.time, self.values.T)
            )
            errors = np.where(np.isfinite(self.distances), self.distances, 0.0)
            write_storage(
                temporary / "marker_errors.sto", Storage("Marker errors", self.markers, self.time, errors.T)
            )
            write_json(temporary / "ik.json", self.summary())


def inverse_kinematics(
    model: Path | str,
    markers: Path | str | Markers,
    *,
    weights: Mapping[str, float] | None = None,
    goals: Mapping[str, CoordinateGoal] | None = None,
    settings: KinematicsSettings | None = None,
    marker_set: Path | str | None = None,
    interval: tuple[float, float] | None = None,
    file: Path | str | None = None,
) -> InverseKinematics:
    """Compute the motion of a model that fits recorded markers.

    The cost of a frame is OpenSim's: the weighted mean of squared marker distances plus weighted squared
    differences of coordinates from their goals. Joints and coordinate couplers hold exactly, clamped
    coordinates stay within their ranges, and locked and prescribed ones at their defaults.

    Parameters
    ----------
    model
        OpenSim model (.osim), scaled to the person.
    markers
        Recorded markers: a ``.trc`` or ``.c3d`` file in ground's axes, or `Markers`.
    weights
        Weights of markers that differ from 1; 0 leaves a marker out.
    goals
        Goals of coordinates, by name.
    settings
        Settings of OpenSim's inverse kinematics tool (`read_kinematics_settings`), whose weights and goals
        hold where ``weights`` and ``goals`` say nothing.
    marker_set
        OpenSim's marker set (.xml), which is added to the model.
    interval
        Start and end, s; by default all frames.
    file
        File to name in messages about `Markers`.

    Returns
    -------
    InverseKinematics
        Motion, marker positions, and which coordinates the markers determine.

    Raises
    ------
    InputError
        If a file is faulty, a name is unknown, the model has constraints other than coordinate couplers, a
        frame has no visible marker, or the markers seem to be in another unit, or left and right exchanged.

    Examples
    --------
    >>> wrapjax.inverse_kinematics("scaled.osim", "walk.trc").save("angles")  # doctest: +SKIP
    """
    description = describe_model(model, marker_set)
    recorded = markers if isinstance(markers, Markers) else read_marker_file(Path(markers))
    place = Path(file or "markers") if isinstance(markers, Markers) else Path(markers)
    chosen = (settings.weights if settings else {}) | dict(weights or {})
    targets = (settings.goals if settings else {}) | dict(goals or {})
    names = [marker.name for marker in description.markers]
    problems = unknown_names(model, "marker", chosen, names)
    coordinates = [entry.name for entry in description.coordinates]
    problems += unknown_names(model, "coordinate", targets, coordinates)
    if problems:
        raise InputError(problems)
    # Settings of OpenSim list the markers to use; without settings all are used.
    ignored = tuple(
        name for name in names if chosen.get(name, 0.0 if settings and settings.weights else 1.0) <= 0.0
    )
    common = match_markers(recorded, tuple(names), ignored, place)
    recorded = recorded.select(common)
    if interval is not None:
        recorded = recorded.during(*interval)
    _check_frames(recorded, place)
    used = np.array([chosen.get(name, 1.0) for name in common])
    return solve(description, recorded, used, targets, place)


def read_marker_file(path: Path) -> Markers:
    """Read a ``.trc`` or ``.c3d`` file of markers."""
    return read_c3d_markers(path) if path.suffix.lower() == ".c3d" else read_trc(path)


def solve(
    description: ModelDescription,
    recorded: Markers,
    weights: Float[np.ndarray, " marker"],
    goals: Mapping[str, CoordinateGoal],
    file: Path,
) -> InverseKinematics:
    """Solve inverse kinematics; see `inverse_kinematics`.

    Parameters
    ----------
    description
        Model with markers.
    recorded
        Recorded markers, all of them in the model.
    weights
        Weight of each, above 0.
    goals
        Goals of coordinates.
    file
        File of the markers, for messages.
    """
    require_float64()
    check_constraints(description)
    free = free_coordinates(description)
    model = build_marker_model(description, [entry.name for entry in free], recorded.names)
    check_size(description, recorded, file)
    bounds = coordinate_bounds(free)
    frames = marker_goals(recorded, weights, free, goals)
    start = first_pose(model, frames, bounds, free, recorded.names, file)
    fit = fit_successive(model, frames, bounds, start)
    poses = np.asarray(fit.poses)
    matrix = np.mean(fit.matrix, axis=0) - np.diag(frames.value_weights.mean(axis=0))
    bodies = body_poses(model.structure, model.skeleton, poses)
    positions = stations(bodies, np.array(model.carriers), model.locations)
    values = all_values(description, free, poses)
    known = dict(zip([entry.name for entry in free], _determined(matrix).tolist(), strict=True))
    return InverseKinematics(
        coordinates=tuple(entry.name for entry in description.coordinates),
        time=recorded.time,
        values=values.T,
        markers=recorded.names,
        positions=np.moveaxis(positions, 0, 1),
        measured=recorded.positions,
        weights=weights,
        converged=np.asarray(fit.converged),
        determined=np.array(
            [_root_determined(description, entry, known) for entry in description.coordinates]
        ),
        rotational=np.array([entry.motion == "rotational" for entry in description.coordinates]),
    )


def free_coordinates(description: ModelDescription) -> list[Coordinate]:
    """Coordinates that inverse kinematics varies: not coupled, locked or prescribed."""
    return [
        entry
        for entry in description.coordinates
        if not (entry.coupled_to or entry.locked or entry.prescribed)
    ]


def coordinate_bounds(coordinates: Sequence[Coordinate]) -> Bounds:
    """Ranges of clamped coordinates; infinite for others."""
    lower = [entry.range[0] if entry.clamped else -np.inf for entry in coordinates]
    upper = [entry.range[1] if entry.clamped else np.inf for entry in coordinates]
    return Bounds(np.array(lower), np.array(upper))


def coordinate_ranges(coordinates: Sequence[Coordinate]) -> Bounds:
    """Ranges of coordinates, clamped or not."""
    lower, upper = np.array([entry.range for entry in coordinates]).reshape(-1, 2).T
    return Bounds(lower, upper)


def marker_goals(
    recorded: Markers,
    weights: Float[np.ndarray, " marker"],
    coordinates: Sequence[Coordinate],
    goals: Mapping[str, CoordinateGoal],
) -> MarkerGoals:
    """Bring recorded markers and goals of coordinates into the form that the solver takes."""
    measured = np.moveaxis(recorded.positions, 0, 1)
    visible = np.isfinite(measured).all(axis=-1) * weights
    total = visible.sum(axis=1, keepdims=True)
    shape = (recorded.time.size, len(coordinates))
    values, value_weights = np.zeros(shape), np.zeros(shape)
    for column, entry in enumerate(coordinates):
        if entry.name in goals:
            goal = goals[entry.name]
            values[:, column] = entry.default_value if goal.value is None else goal.value
            value_weights[:, column] = goal.weight
    return MarkerGoals(np.nan_to_num(measured), visible / np.maximum(total, 1e-300), values, value_weights)


def first_pose(
    model: MarkerModel,
    goals: MarkerGoals,
    bounds: Bounds,
    coordinates: Sequence[Coordinate],
    names: tuple[str, ...],
    file: Path,
) -> Float[np.ndarray, " coordinate"]:
    """Find the pose of the frame with most markers, from several directions of the body.

    Raises
    ------
    InputError
        If the markers fit far better with left and right exchanged.
    """
    frame = int(np.argmax((np.asarray(goals.weights) > 0.0).sum(axis=1)))
    goal = MarkerGoals(*(array[frame] for array in goals))
    rest = np.array([entry.default_value for entry in coordinates])
    ranges = coordinate_ranges(coordinates)
    pose, cost = fit_first(model, goal, bounds, ranges, rest)
    order = exchanged_sides(names)
    if order is not None:
        exchanged = goal._replace(
            measured=np.asarray(goal.measured)[order], weights=np.asarray(goal.weights)[order]
        )
        _, other = fit_first(model, exchanged, bounds, ranges, rest)
        check_exchanged_sides(cost, other, file)
    return pose


def all_values(
    description: ModelDescription,
    free: Sequence[Coordinate],
    poses: Float[np.ndarray, "frame coordinate"],
) -> Float[np.ndarray, "frame all_coordinate"]:
    """Compute the values of all coordinates of a model, in its order, from the free ones."""
    structure, skeleton = build_skeleton(description, [entry.name for entry in free])
    values, _ = all_coordinate_values(structure, skeleton, poses)
    order = [structure.all_coordinates.index(entry.name) for entry in description.coordinates]
    return np.asarray(values)[:, order]


def check_constraints(description: ModelDescription) -> None:
    """Raise `InputError` if a model has constraints other than coordinate couplers."""
    if description.constraints:
        raise InputError(
            Problem(description.name, f"constraint '{name}' is a {kind}", hint=_OTHER_CONSTRAINTS)
            for name, kind in description.constraints
        )


def _check_frames(recorded: Markers, file: Path) -> None:
    if recorded.time.size == 0:
        raise InputError(Problem(str(file), "expected frames in the interval, found none", "Time"))
    unseen = ~np.isfinite(recorded.positions).all(axis=-1).any(axis=0)
    if unseen.any():
        at = recorded.time[unseen]
        message = f"expected a visible marker of the model in every frame, found none in {at.size} frames"
        hint = f"the first one is at {at[0]:g} s; choose an interval without them"
        raise InputError(Problem(str(file), message, hint=hint))


def _determined(matrix: Float[np.ndarray, "coordinate coordinate"]) -> Bool[np.ndarray, " coordinate"]:
    """Find the coordinates that lie in directions with information from markers."""
    values, vectors = np.linalg.eigh(matrix)
    null = vectors[:, values < NEGLIGIBLE_INFORMATION * values.max(initial=0.0)]
    return (null**2).sum(axis=1) < UNDETERMINED_SHARE


def _root_determined(
    description: ModelDescription, coordinate: Coordinate, known: Mapping[str, bool]
) -> bool:
    while coordinate.coupled_to:
        coordinate = description.coordinate(coordinate.coupled_to[0])
    return bool(known.get(coordinate.name, True))
