"""Reading of joint angles that a laboratory has computed, and computation of coupled coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.skeleton.model_description import Coordinate
from wrapjax.io.model_file import CoordinateInfo
from wrapjax.io.storage import find_columns, read_storage
from wrapjax.subject.recordings import check_angle_unit, select_angles

#: Largest accepted difference of a coupled coordinate from its coupler function (root mean square), rad or m.
MAX_COUPLING_ERROR = 0.02
#: A coupled coordinate is in degrees if this reduces the difference to less than this share.
DEGREES_ERROR_RATIO = 0.2


@dataclass(frozen=True)
class Motion:
    """Coordinates of a model over time.

    Parameters
    ----------
    coordinates
        Names of the coordinates.
    time
        Times, s.
    values
        Values of the coordinates, rad or m.
    """

    coordinates: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    values: Float[np.ndarray, "coordinate frame"]

    def without_coupled(self, coupled: Mapping[str, Coordinate]) -> Motion:
        """Remove the coupled coordinates."""
        rows = [row for row, name in enumerate(self.coordinates) if name not in coupled]
        return Motion(tuple(self.coordinates[row] for row in rows), self.time, self.values[rows])

    def with_coupled(self, coupled: Mapping[str, Coordinate]) -> Motion:
        """Compute the coupled coordinates from the independent ones and add or replace them."""
        independent = self.without_coupled(coupled)
        rows = dict(zip(independent.coordinates, independent.values, strict=True))
        remaining = dict(coupled)
        # A coordinate can be coupled to one that is coupled itself.
        while ready := [name for name, entry in remaining.items() if entry.coupled_to[0] in rows]:
            for name in ready:
                entry = remaining.pop(name)
                assert entry.coupler is not None
                rows[name] = entry.coupler.value(rows[entry.coupled_to[0]])
        return Motion(tuple(rows), self.time, np.array(list(rows.values())))


def find_coupled_coordinates(coordinates: Sequence[Coordinate]) -> dict[str, Coordinate]:
    """Find the coordinates that are a known function of one other coordinate, by name."""
    return {
        entry.name: entry for entry in coordinates if entry.coupler is not None and len(entry.coupled_to) == 1
    }


def read_motion(
    path: Path,
    infos: tuple[CoordinateInfo, ...],
    coupled: Mapping[str, Coordinate],
    required: Sequence[str],
    notes: list[str],
) -> Motion:
    """Read joint angles; coupled coordinates are computed from their coupler functions, not read.

    Files of OpenSim can hold the coupled coordinate of the patella in degrees although the header states
    radians, and the reverse. Its values in the file would cause errors of tens of N m in the moments of hip
    and knee.

    Parameters
    ----------
    path
        File of joint angles, ``.sto`` or ``.mot``.
    infos
        Coordinates of the model.
    coupled
        Coupled coordinates, from `find_coupled_coordinates`.
    required
        Coordinates that must be in the file.
    notes
        List to which a sentence is added for each coupled coordinate that disagrees with its coupler
        function.

    Raises
    ------
    InputError
        With all faults of the file.
    """
    table = read_storage(path)
    problems: list[Problem] = []
    missing = [name for name in required if not find_columns(table.columns, name)]
    problems += [Problem(str(path), "is not in the file", f"column {name}") for name in missing]
    rotational = [info for info in infos if info.name not in coupled]
    check_angle_unit(table, rotational, path, problems)
    if problems:
        raise InputError(problems)
    names, values = select_angles(table, infos)
    motion = Motion(names, table.time, values)
    result = motion.with_coupled(coupled)
    for name in coupled:
        places = find_columns(table.columns, name)
        if len(places) == 1 and name in result.coordinates:
            expected = result.values[result.coordinates.index(name)]
            note = _describe_disagreement(table.values[:, places[0]], expected, coupled[name])
            if note:
                notes.append(f"{path}: column {name}: {note}")
    return result


def _describe_disagreement(
    found: Float[np.ndarray, " frame"], expected: Float[np.ndarray, " frame"], coordinate: Coordinate
) -> str:
    """Describe how a coupled column of the file differs from its coupler function; empty if it agrees."""
    as_radians, as_degrees = (
        float(np.sqrt(np.mean((factor * found - expected) ** 2))) for factor in (1.0, np.pi / 180)
    )
    if as_radians <= MAX_COUPLING_ERROR:
        return ""
    spans = (
        f"found {found.min():.3g} to {found.max():.3g}, where {expected.min():.3g} to {expected.max():.3g}"
    )
    spans = f"{spans} rad follow from {coordinate.coupled_to[0]}"
    if as_degrees < DEGREES_ERROR_RATIO * as_radians:
        return f"is in degrees ({spans}); computed from its coupler function instead"
    return f"disagrees with its coupler function ({spans}); computed from that instead"
