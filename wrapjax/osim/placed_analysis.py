"""Muscle lengths and moment arms by OpenSim for many placements of wrap cylinders, stored on disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.io.files import cache_folder, content_hash, write_atomically
from wrapjax.osim.loading import check_is_file
from wrapjax.osim.muscle_analysis import check_names_and_poses, check_poses
from wrapjax.osim.path_engine import WrapParameters
from wrapjax.osim.workers import Placed, analyse_chunks
from wrapjax.progress import progress_bar

#: Placements that are analyzed and stored at a time, some seconds of work for 20 muscles in 500 poses.
CHUNK = 8
# Part of every cache key; to be increased when results for the same inputs change.
_FORMAT = 1


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
        One file for each `CHUNK` placements: an array ``placement pose column``, with a column for the length
        of each muscle and one for each of its moment arms.
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
    key = content_hash(path, repr(muscles), repr(coordinates), poses, version("opensim"), _FORMAT)
    starts = range(0, len(placements), CHUNK)
    chunks = {start: Placed(tuple(placements[start : start + CHUNK]), poses) for start in starts}
    folder = cache_folder("placed_analysis")
    files = {
        start: folder / f"{content_hash(key, *_parts(chunk.placements))}.npy"
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
                _store(files[start], _table(spans, coordinates, length, moment_arm))
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


def _store(file: Path, table: Float[np.ndarray, "placement pose column"]) -> None:
    write_atomically(file, lambda whole: np.save(whole, table, allow_pickle=False))


def _parts(placements: Sequence[Mapping[str, WrapParameters]]) -> list[str | np.ndarray]:
    """List all contents of placements, for a hash."""
    return [
        part
        for number, wraps in enumerate(placements)
        for wrap, parameters in sorted(wraps.items())
        for part in (f"{number} {wrap}", np.asarray(parameters, dtype=np.float64))
    ]
