"""Muscle lengths and moment arms by OpenSim in many poses and placements of wraps, in parallel and cached."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.io.files import write_atomically
from wrapjax.io.store import Store, fingerprint
from wrapjax.osim.loading import check_is_file
from wrapjax.osim.model import describe_model, unknown_names
from wrapjax.osim.path_engine import PathEngine, WrapParameters
from wrapjax.osim.workers import Placed, analyse_chunks
from wrapjax.progress import progress_bar

#: Poses that are analyzed and cached at a time, about half a second of work for 34 muscles.
CHUNK = 512
# Largest difference (rad or m) of a pose from the value at which a coordinate is locked.
_LOCKED_TOLERANCE = 1e-6
#: Placements that are analyzed and stored at a time, some seconds of work for 20 muscles in 500 poses.
PLACED_CHUNK = 8


@dataclass(frozen=True)
class PathGeometry:
    """Lengths and moment arms of muscles at poses.

    Parameters
    ----------
    muscles, coordinates
        Names along the axes.
    length
        Muscle-tendon length, m.
    moment_arm
        OpenSim's moment arm, m (m/rad; dimensionless about a translational coordinate), with the sign of
        -d(length)/d(coordinate). Zero where a muscle does not span a coordinate.
    """

    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    length: Float[np.ndarray, "pose muscle"]
    moment_arm: Float[np.ndarray, "pose coordinate muscle"]


def analyse_muscles(
    model_file: Path | str,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    poses: Float[np.ndarray, "pose coordinate"],
    *,
    processes: int | None = None,
    quiet: bool = False,
) -> PathGeometry:
    """Compute muscle-tendon lengths and moment arms with OpenSim.

    Coordinates that are not given stay at the model's defaults; coupled ones, such as a patella's, follow
    their couplers. Results are stored in the user's cache, some hundred poses in a file. An interrupted
    analysis continues from there.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    muscles
        Names of muscles of the model.
    coordinates
        Names of independent coordinates of the model.
    poses
        Coordinate values, rad (m for translations). A value outside a coordinate's range is used unchanged,
        whether clamped or not. A locked coordinate must have the value at which the model holds it.
    processes
        Number of worker processes; 1 for none. By default the number of cores, at most eight, and none if
        starting them would take longer than the remaining work.
    quiet
        Whether to show no progress.

    Returns
    -------
    PathGeometry
        Lengths and moment arms in the order of the arguments.

    Raises
    ------
    InputError
        If the model cannot be loaded, has no part of a given name, or cannot be set to a pose.
    WorkError
        If a worker process dies. Results finished before that are kept.

    Notes
    -----
    The moment arm is OpenSim's, the generalized force of unit tension along the path. On a wrapped path it
    differs from -dL/dq: by some tenths of a millimeter round one cylinder, because OpenSim's path is not
    exactly the shortest, and by up to centimeters round two cylinders (OpenSim 4.6), because of stale wrap
    points.

    Examples
    --------
    >>> knee = np.radians([[10.0], [60.0]])
    >>> analyse_muscles("model.osim", ["vasmed_l"], ["knee_angle_l"], knee).length  # doctest: +SKIP
    """
    muscles, coordinates = tuple(muscles), tuple(coordinates)
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    path = check_is_file(model_file)
    check_poses(path, coordinates, poses)
    store = Store.of_user("muscle_analysis")
    chunks = {start: poses[start : start + CHUNK] for start in range(0, len(poses), CHUNK)}
    names = {
        start: fingerprint(path, repr((muscles, coordinates)), version("opensim"), chunk, module=__name__)
        for start, chunk in chunks.items()
    }
    length = np.zeros((len(poses), len(muscles)))
    moment_arm = np.zeros((len(poses), len(coordinates), len(muscles)))

    missing = {}
    for start, chunk in chunks.items():
        rows = slice(start, start + CHUNK)
        if (known := store.read_arrays(names[start])) is None:
            missing[start] = chunk
        else:
            length[rows], moment_arm[rows] = known["length"], known["moment_arm"]
    if missing or not chunks:
        spans = check_names_and_poses(path, muscles, coordinates, poses)
        done = len(poses) - sum(len(chunk) for chunk in missing.values())
        with (
            progress_bar("OpenSim muscle analysis, poses", len(poses), quiet=quiet) as advance,
            closing(analyse_chunks(path, coordinates, spans, missing, processes)) as results,
        ):
            for start, *found in results:
                rows = slice(start, start + CHUNK)
                length[rows], moment_arm[rows] = found
                _check_finite(path, muscles, poses[rows], length[rows], moment_arm[rows])
                # The analysis does not fail if its store cannot be written.
                with suppress(OSError):
                    store.write_arrays(names[start], length=length[rows], moment_arm=moment_arm[rows])
                done += len(chunks[start])
                advance(done)
    return PathGeometry(muscles, coordinates, length, moment_arm)


def touching_muscles(
    model_file: Path | str,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    poses: Float[np.ndarray, "pose coordinate"],
) -> tuple[str, ...]:
    """Find the muscles whose path touches a wrapping surface in at least one pose.

    Parameters and errors are those of `analyse_muscles`.

    Returns
    -------
    tuple of str
        Names, in the order of ``muscles``.
    """
    muscles, coordinates = tuple(muscles), tuple(coordinates)
    path = check_is_file(model_file)
    check_poses(path, coordinates, poses)
    spans = check_names_and_poses(path, muscles, coordinates, poses)
    found = PathEngine(path, coordinates, spans).touching(poses)
    return tuple(name for number, name in enumerate(muscles) if number in found)


def check_poses(
    path: Path, coordinates: tuple[str, ...], poses: Float[np.ndarray, "pose coordinate"]
) -> None:
    """Check that poses are finite and have one value for each coordinate.

    Raises
    ------
    ValueError
        If the number of values differs from the number of coordinates.
    InputError
        If a value is not finite.
    """
    if poses.shape[1:] != (len(coordinates),):
        raise ValueError(f"poses of shape {poses.shape} do not fit {len(coordinates)} coordinates")
    bad = np.argwhere(~np.isfinite(poses))
    if len(bad):
        raise InputError(
            Problem(str(path), f"is {poses[pose, column]} in pose {pose}", place=coordinates[column])
            for pose, column in bad[np.unique(bad[:, 1], return_index=True)[1]]
        )


def check_names_and_poses(
    path: Path,
    muscles: tuple[str, ...],
    coordinates: tuple[str, ...],
    poses: Float[np.ndarray, "pose coordinate"],
) -> dict[str, tuple[str, ...]]:
    """Check names and poses against the model, and find the coordinates that each muscle spans.

    Raises
    ------
    InputError
        If the model cannot be loaded, has no part of a given name, or cannot be set to a pose.
    """
    model = describe_model(path)
    problems = unknown_names(path, "muscle", muscles, [muscle.name for muscle in model.muscles])
    problems += unknown_names(path, "coordinate", coordinates, [entry.name for entry in model.coordinates])
    if not problems:
        problems += _unsupported_parts(str(path), model, muscles, coordinates, poses)
    if problems:
        raise InputError(problems)
    return {name: model.spanned_by(name) for name in muscles}


def _unsupported_parts(
    file: str,
    model: ModelDescription,
    muscles: tuple[str, ...],
    coordinates: tuple[str, ...],
    poses: Float[np.ndarray, "pose coordinate"],
) -> Iterator[Problem]:
    """Find constraints, paths and coordinates that prevent an analysis."""
    for name, kind in model.constraints:
        yield Problem(
            file, f"is a {kind}; coordinate couplers are the only supported constraints", place=name
        )
    for name in muscles:
        kind = model.muscle(name).path_kind
        if kind != "GeometryPath":
            yield Problem(file, f"has a {kind}, where a GeometryPath was expected", place=name)
    for column, name in enumerate(coordinates):
        coordinate = model.coordinate(name)
        if coordinate.coupled_to:
            followed = ", ".join(coordinate.coupled_to)
            yield Problem(file, f"follows {followed} and cannot be set", place=name, hint="leave it out")
        elif coordinate.locked and len(poses):
            held = coordinate.default_value
            furthest = poses[np.argmax(np.abs(poses[:, column] - held)), column]
            if abs(furthest - held) > _LOCKED_TOLERANCE:
                message = f"is locked at {held:g} in the model, but a pose has it at {furthest:g}"
                yield Problem(
                    file, message, place=name, hint="unlock it in the model or leave out this coordinate"
                )


def _check_finite(
    path: Path,
    muscles: tuple[str, ...],
    poses: Float[np.ndarray, "pose coordinate"],
    length: Float[np.ndarray, "pose muscle"],
    moment_arm: Float[np.ndarray, "pose coordinate muscle"],
) -> None:
    bad = np.argwhere(~(np.isfinite(length) & np.isfinite(moment_arm).all(axis=1)))
    if len(bad):
        pose, muscle = bad[0]
        message = f"OpenSim finds no finite length or moment arm in the pose {poses[pose].tolist()}"
        raise InputError(Problem(str(path), message, place=muscles[muscle]))


@dataclass(frozen=True)
class PlacedAnalysis:
    """Lengths and moment arms of muscles at placements of cylinders and poses, stored on disk.

    Parameters
    ----------
    coordinates
        Names of the coordinates of poses.
    spans
        Names of the coordinates that each muscle's length depends on, by muscle name.
    files
        One file for each `PLACED_CHUNK` placements: an array ``placement pose column``, with a column for the
        length of each muscle and one for each of its moment arms.
    """

    coordinates: tuple[str, ...]
    spans: dict[str, tuple[str, ...]]
    files: tuple[Path, ...]

    def of(
        self, muscle: str
    ) -> tuple[Float[np.ndarray, "placement pose"], Float[np.ndarray, "placement pose coordinate"]]:
        """Read one muscle's lengths (m) and moment arms (m, zero where not spanned)."""
        columns = [place for place, (name, _) in enumerate(_columns(self.spans)) if name == muscle]
        # Memory-mapped, so that only the selected columns are in memory.
        parts = [
            np.load(file, mmap_mode="r", allow_pickle=False)[:, :, columns].astype(np.float64)
            for file in self.files
        ]
        values = np.concatenate(parts)
        moment_arm = np.zeros((*values.shape[:2], len(self.coordinates)))
        for place, name in enumerate(self.spans[muscle], start=1):
            if name in self.coordinates:
                moment_arm[:, :, self.coordinates.index(name)] = values[:, :, place]
        return values[:, :, 0], moment_arm


def analyse_placements(
    model_file: Path | str,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    poses: Float[np.ndarray, "pose coordinate"],
    placements: Sequence[Mapping[str, WrapParameters]],
    *,
    processes: int | None = None,
    quiet: bool = False,
) -> PlacedAnalysis:
    """Compute muscle-tendon lengths and moment arms with OpenSim for many placements of cylinders.

    Parameters
    ----------
    model_file, muscles, coordinates, poses, processes, quiet
        As for `analyse_muscles`, which raises the same errors.
    placements
        Wrap parameters by cylinder name for each placement (see `PathEngine.place`).

    Returns
    -------
    PlacedAnalysis
        Results, stored in the user's cache in single precision, which rounds lengths by 30 nm at most. An
        interrupted analysis continues from there.
    """
    muscles, coordinates = tuple(muscles), tuple(coordinates)
    path = check_is_file(model_file)
    check_poses(path, coordinates, poses)
    spans = check_names_and_poses(path, muscles, coordinates, poses)
    inputs = (path, repr((muscles, coordinates)), poses, version("opensim"))
    starts = range(0, len(placements), PLACED_CHUNK)
    chunks = {start: Placed(tuple(placements[start : start + PLACED_CHUNK]), poses) for start in starts}
    store = Store.of_user("placed_analysis")
    files = {
        start: store.place(f"{fingerprint(*inputs, *_parts(chunk.placements), module=__name__)}.npy")
        for start, chunk in chunks.items()
    }
    missing = {start: chunk for start, chunk in chunks.items() if not files[start].exists()}
    if missing:
        done = len(placements) - sum(len(chunk.placements) for chunk in missing.values())
        with (
            progress_bar(
                "OpenSim analysis, placements of cylinders", len(placements), quiet=quiet
            ) as advance,
            closing(analyse_chunks(path, coordinates, spans, missing, processes)) as results,
        ):
            for start, length, moment_arm in results:
                _write(files[start], _table(spans, coordinates, length, moment_arm))
                done += len(chunks[start].placements)
                advance(done)
    return PlacedAnalysis(coordinates, spans, tuple(files.values()))


def _columns(spans: Mapping[str, tuple[str, ...]]) -> list[tuple[str, str | None]]:
    """List muscle and coordinate of each column; a muscle's length, of coordinate None, comes first."""
    return [(muscle, name) for muscle, span in spans.items() for name in (None, *span)]


def _table(
    spans: Mapping[str, tuple[str, ...]],
    coordinates: tuple[str, ...],
    length: Float[np.ndarray, "placement pose muscle"],
    moment_arm: Float[np.ndarray, "placement pose coordinate muscle"],
) -> Float[np.ndarray, "placement pose column"]:
    """Arrange lengths and moment arms in columns."""
    muscles = list(spans)
    table = np.zeros((*length.shape[:2], len(_columns(spans))), dtype=np.float32)
    for place, (muscle, name) in enumerate(_columns(spans)):
        row = muscles.index(muscle)
        if name is None:
            table[:, :, place] = length[:, :, row]
        elif name in coordinates:
            table[:, :, place] = moment_arm[:, :, coordinates.index(name), row]
    return table


def _write(file: Path, table: Float[np.ndarray, "placement pose column"]) -> None:
    write_atomically(file, lambda whole: np.save(whole, table, allow_pickle=False))


def _parts(placements: Sequence[Mapping[str, WrapParameters]]) -> list[str | np.ndarray]:
    """List all contents of placements, for a hash."""
    return [
        part
        for number, wraps in enumerate(placements)
        for wrap, parameters in sorted(wraps.items())
        for part in (f"{number} {wrap}", np.asarray(parameters, dtype=np.float64))
    ]
