"""Joint angles that a laboratory has solved already, and coordinates that follow others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.model_description import Coordinate
from wrapjax.io.model_file import CoordinateInfo
from wrapjax.io.storage import find_column, read_storage
from wrapjax.subject.recordings import all_angles, check_angle_unit

#: Coupled coordinates that are this close to their couplers (rad or m, root mean square) are as coupled.
AS_COUPLED = 0.02
#: In degrees they fit so much better than in radians.
BETTER_IN_DEGREES = 0.2


@dataclass(frozen=True)
class Motion:
    """Coordinates of a model over time.

    Parameters
    ----------
    coordinates
        Names.
    time
        s.
    values
        rad or m.
    """

    coordinates: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    values: Float[np.ndarray, "coordinate frame"]

    def independent(self, couplers: Mapping[str, Coordinate]) -> Motion:
        """Leave out coordinates that follow others."""
        kept = [row for row, name in enumerate(self.coordinates) if name not in couplers]
        return Motion(tuple(self.coordinates[row] for row in kept), self.time, self.values[kept])

    def coupled(self, couplers: Mapping[str, Coordinate]) -> Motion:
        """Add what follows others, in place of whatever it was."""
        known = self.independent(couplers)
        rows = dict(zip(known.coordinates, known.values, strict=True))
        waiting = dict(couplers)
        # A coordinate may follow one that follows another.
        while ready := [name for name, entry in waiting.items() if entry.coupled_to[0] in rows]:
            for name in ready:
                entry = waiting.pop(name)
                assert entry.coupler is not None
                rows[name] = entry.coupler.value(rows[entry.coupled_to[0]])
        return Motion(tuple(rows), self.time, np.array(list(rows.values())))


def couplers_of(coordinates: Sequence[Coordinate]) -> dict[str, Coordinate]:
    """Name the coordinates that follow one other by a known function."""
    return {
        entry.name: entry for entry in coordinates if entry.coupler is not None and len(entry.coupled_to) == 1
    }


def read_motion(
    path: Path,
    infos: tuple[CoordinateInfo, ...],
    couplers: Mapping[str, Coordinate],
    wanted: Sequence[str],
    notes: list[str],
) -> Motion:
    """Read solved joint angles, coupled coordinates by their couplers whatever the file says of them.

    OpenSim's own files have coupled patellae in degrees where the header says radians, and the other way
    round; taken as they are they throw the moments of hip and knee off by tens of N m.

    Parameters
    ----------
    path
        ``.sto`` or ``.mot``.
    infos
        Coordinates of the model.
    couplers
        Those that follow others.
    wanted
        Coordinates that must be in the file.
    notes
        A sentence is added for each coupled coordinate that was not as coupled.

    Raises
    ------
    InputError
        With everything wrong in the file.
    """
    table = read_storage(path)
    problems: list[Problem] = []
    missing = [name for name in wanted if not find_column(table.columns, name)]
    problems += [Problem(str(path), "is not in the file", f"column {name}") for name in missing]
    rotational = [info for info in infos if info.name not in couplers]
    check_angle_unit(table, rotational, path, problems)
    if problems:
        raise InputError(problems)
    names, values = all_angles(table, infos)
    motion = Motion(names, table.time, values)
    mended = motion.coupled(couplers)
    for name in couplers:
        places = find_column(table.columns, name)
        if len(places) == 1 and name in mended.coordinates:
            note = _compared(
                name, table.values[:, places[0]], mended.values[mended.coordinates.index(name)], couplers
            )
            if note:
                notes.append(f"{path}: column {name}: {note}")
    return mended


def _compared(
    name: str,
    found: Float[np.ndarray, " frame"],
    expected: Float[np.ndarray, " frame"],
    couplers: Mapping[str, Coordinate],
) -> str:
    """Say how a coupled column differs from what its coupler gives; empty where it does not."""
    leader = couplers[name].coupled_to[0]
    plain, turned = (
        float(np.sqrt(np.mean((factor * found - expected) ** 2))) for factor in (1.0, np.pi / 180)
    )
    if plain <= AS_COUPLED:
        return ""
    spans = (
        f"found {found.min():.3g} to {found.max():.3g}, where {expected.min():.3g} to {expected.max():.3g}"
    )
    spans = f"{spans} rad follow from {leader}"
    if turned < BETTER_IN_DEGREES * plain:
        return f"is in degrees ({spans}); taken from its coupler instead"
    return f"does not follow its coupler ({spans}); taken from its coupler instead"
