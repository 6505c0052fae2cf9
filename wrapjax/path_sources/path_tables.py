"""Tables of muscle lengths and moment arms in the poses of a file, which the command ``paths`` writes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import new_folder, write_json
from wrapjax.io.storage import Storage, find_columns, read_storage, write_storage
from wrapjax.path_sources.muscle_paths import MusclePaths, PathValues

# Largest angle (rad) that is not taken for one in degrees.
_LARGEST_ANGLE = 2.0 * np.pi


@dataclass(frozen=True)
class PathTables:
    """Lengths and moment arms of muscles in the poses of a file.

    Parameters
    ----------
    paths
        Muscle paths.
    poses_file
        File of the poses.
    time
        First column of the file, s.
    values
        Lengths (m) and moment arms (m, m/rad).
    at_default
        Coordinates that the file lacks, which are at the model's defaults.
    inside
        Least depth (m) of a path point inside of a wrap, by muscle and wrap, where one is in every pose.
    """

    paths: MusclePaths
    poses_file: str
    time: Float[np.ndarray, " pose"]
    values: PathValues
    at_default: tuple[str, ...]
    inside: dict[str, dict[str, float]]

    def save(self, folder: Path | str, *, force: bool = False) -> None:
        """Write ``lengths.sto``, ``moment_arm_<coordinate>.sto`` and ``paths.json`` into a new folder.

        Parameters
        ----------
        folder
            Folder to create.
        force
            Replace an existing folder.
        """
        muscles = self.paths.muscles
        with new_folder(Path(folder), force=force) as out:
            length = np.asarray(self.values.length)
            write_storage(
                out / "lengths.sto", Storage("muscle-tendon lengths (m)", muscles, self.time, length)
            )
            for number, coordinate in enumerate(self.paths.coordinates):
                table = Storage(
                    f"moment arms about {coordinate} (m)",
                    muscles,
                    self.time,
                    np.asarray(self.values.moment_arm[:, number]),
                )
                write_storage(out / f"moment_arm_{coordinate}.sto", table)
            write_json(out / "paths.json", self.summary())

    def summary(self) -> dict[str, object]:
        """Summarise the paths: what ``paths.json`` holds."""
        touching, regular = np.asarray(self.values.touching), np.asarray(self.values.regular)
        length = np.asarray(self.values.length)
        return {
            "schema": 1,
            "model": self.paths.engine.model.name,
            "mode": self.paths.mode,
            "poses_file": self.poses_file,
            "poses": len(self.time),
            "coordinates": list(self.paths.coordinates),
            "at_default": list(self.at_default),
            "muscles": {
                name: {
                    "wraps": list(self.paths.engine.wraps_of(name)),
                    "touching_share": float(touching[:, column].mean()),
                    "irregular_share": float(1.0 - regular[:, column].mean()),
                    "inside_m": self.inside.get(name, {}),
                    "length_m": [float(length[:, column].min()), float(length[:, column].max())],
                }
                for column, name in enumerate(self.paths.muscles)
            },
            "unsupported": dict(self.paths.unsupported),
        }


def path_tables(paths: MusclePaths, poses_file: Path | str) -> PathTables:
    """Compute lengths and moment arms in the poses of a ``.sto`` or ``.mot`` file.

    Parameters
    ----------
    paths
        Muscle paths from `muscle_paths`.
    poses_file
        Table with a row for each pose and a column for each coordinate; the header's ``inDegrees`` is
        honoured. Other columns are ignored, and coordinates without a column stay at the model's defaults.

    Raises
    ------
    InputError
        If the file is not such a table, has no coordinate of the muscles, or has angles that must be in
        degrees although its header says that they are not.
    """
    file = str(poses_file)
    table = read_storage(poses_file)
    model = paths.engine.model
    poses = np.zeros((len(table.time), len(paths.coordinates)))
    missing, problems = [], []
    for column, name in enumerate(paths.coordinates):
        coordinate = model.coordinate(name)
        found = find_columns(table.columns, name)
        if len(found) > 1:
            problems.append(Problem(file, f"expected one column, found {len(found)}", place=name))
        elif not found:
            missing.append(name)
            poses[:, column] = coordinate.default_value
        else:
            values = table.values[:, found[0]]
            rotational = coordinate.motion == "rotational"
            poses[:, column] = np.deg2rad(values) if table.in_degrees and rotational else values
            largest = np.abs(poses[:, column]).max(initial=0.0)
            if rotational and largest > _LARGEST_ANGLE:
                message = f"expected angles up to a full turn, found {largest:.3g} rad"
                hint = "if the angles are in degrees, write inDegrees=yes in the header"
                problems.append(Problem(file, message, place=name, hint=hint))
    if len(missing) == len(paths.coordinates) and not problems:
        wanted = ", ".join(paths.coordinates[:5])
        hints = [nearest_name(label, paths.coordinates) for label in table.columns]
        hint = next((one for one in hints if one), "")
        problems.append(
            Problem(file, f"expected a column of a coordinate, such as {wanted}, found none", hint=hint)
        )
    if problems:
        raise InputError(problems)
    inside = paths.points_inside(poses) if len(poses) else {}
    return PathTables(paths, file, table.time, paths(poses), tuple(missing), inside)
