"""Ground forces under each foot: read, filtered, and written as OpenSim's external loads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import write_text
from wrapjax.io.storage import Storage, find_column, read_storage, write_storage
from wrapjax.preprocessing.filters import low_pass
from wrapjax.preprocessing.gait_events import CONTACT_FORCE

SIDES = {"l": "left", "r": "right"}


@dataclass(frozen=True)
class FootForces:
    """What the ground does to each foot, in OpenSim's axes (y up).

    Parameters
    ----------
    sides
        ``l``, ``r``: which are measured.
    time
        s.
    wrench
        Moment about ground's origin (N m), then force (N), of the ground on each foot.
    """

    sides: tuple[str, ...]
    time: Float[np.ndarray, " sample"]
    wrench: Float[np.ndarray, "foot 6 sample"]

    def vertical(self, side: str) -> Float[np.ndarray, " sample"]:
        """Upward force on a foot in N."""
        return self.wrench[self.sides.index(side), 4]

    def filtered(self, cutoff_hz: float) -> FootForces:
        """Filter force and moment low-pass: unlike a center of pressure both fade where contact ends."""
        flat = low_pass(self.time, self.wrench.reshape(-1, self.time.size), cutoff_hz)
        return replace(self, wrench=flat.reshape(self.wrench.shape))

    def during(self, start: float, end: float) -> FootForces:
        """Keep samples from ``start`` to ``end`` in s."""
        kept = (self.time >= start - 1e-9) & (self.time <= end + 1e-9)
        return replace(self, time=self.time[kept], wrench=self.wrench[..., kept])

    def at(self, time: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "foot 6 frame"]:
        """Interpolate linearly at times in s."""
        rows = [np.interp(time, self.time, row) for row in self.wrench.reshape(-1, self.time.size)]
        return np.array(rows).reshape(*self.wrench.shape[:2], time.size)


def centers_of_pressure(
    wrench: Float[np.ndarray, "foot 6 sample"], least_force: float = CONTACT_FORCE
) -> Float[np.ndarray, "foot 3 sample"]:
    """Give where each foot's force meets the ground's plane (y = 0), in m.

    While a foot bears less than ``least_force`` (N) its last center stays; before its first, that one.
    """
    centers = np.zeros((wrench.shape[0], 3, wrench.shape[2]))
    for center, (moment_x, _, moment_z, _, up, _) in zip(centers, wrench, strict=True):
        loaded = np.flatnonzero(up > least_force)
        if loaded.size == 0:
            continue
        before = np.searchsorted(loaded, np.arange(up.size), side="right") - 1
        source = loaded[np.maximum(before, 0)]
        center[0] = (moment_z[loaded] / up[loaded])[np.maximum(before, 0)]
        center[2] = -moment_x[source] / up[source]
    return centers


@dataclass(frozen=True)
class ForceColumns:
    """Which columns of a ``.mot`` file, or which plates of a ``.c3d``, are one foot's.

    Parameters
    ----------
    body
        The model's body that the ground acts on.
    force, point, torque
        What labels start with (``x``, ``y``, ``z`` follow), in ground's frame; ``torque`` may be empty.
    plates
        Numbers of force plates, from 1.
    """

    body: str
    force: str = ""
    point: str = ""
    torque: str = ""
    plates: tuple[int, ...] = ()


def read_force_columns(path: Path, feet: dict[str, ForceColumns]) -> FootForces:
    """Read forces of each foot from a ``.mot`` or ``.sto`` file in N, m and N m.

    Raises
    ------
    InputError
        With everything wrong in the file, and every column that it lacks.
    """
    table = read_storage(path, trust_row_count=False)
    problems: list[Problem] = []

    def columns(prefix: str) -> Float[np.ndarray, "3 sample"]:
        if not prefix:
            return np.zeros((3, table.time.size))
        found = [find_column(table.columns, prefix + axis) for axis in "xyz"]
        for axis, places in zip("xyz", found, strict=True):
            if len(places) != 1:
                hint = nearest_name(prefix + axis, table.columns)
                problems.append(Problem(str(path), "is not in the file", f"column {prefix}{axis}", hint))
        if any(len(places) != 1 for places in found):
            return np.zeros((3, table.time.size))
        return table.values.T[[places[0] for places in found]]

    wrench = []
    for foot in feet.values():
        force, point, torque = (columns(prefix) for prefix in (foot.force, foot.point, foot.torque))
        # A force that is not there acts nowhere; files then hold any point, some kilometers away.
        moment = np.where(np.any(force != 0.0, axis=0), np.cross(point, force, axis=0), 0.0)
        wrench.append(np.concatenate([torque + moment, force]))
    if problems:
        raise InputError(problems)
    return FootForces(tuple(feet), table.time, np.array(wrench))


def write_forces(folder: Path, forces: FootForces, feet: dict[str, ForceColumns]) -> None:
    """Write ``ground_forces.mot`` and ``external_loads.xml`` beside it.

    What the center of pressure leaves of the moment is written as a torque, so that nothing is lost.
    """
    centers = centers_of_pressure(forces.wrench)
    moment, force = forces.wrench[:, :3], forces.wrench[:, 3:]
    torque = moment - np.cross(centers, force, axis=1)
    names, series = [], []
    for row, side in enumerate(forces.sides):
        for kind, values in (("v", force), ("p", centers), ("t", torque)):
            names += [f"{SIDES[side]}_{kind}{axis}" for axis in "xyz"]
            series += list(values[row])
    table = Storage("ground forces", tuple(names), forces.time, np.array(series).T)
    write_storage(folder / "ground_forces.mot", table)
    loads = "\n".join(_external_force(SIDES[side], feet[side].body) for side in forces.sides)
    write_text(folder / "external_loads.xml", _EXTERNAL_LOADS.format(loads=loads))


def _external_force(name: str, body: str) -> str:
    return f"""   <ExternalForce name="{name}">
    <applied_to_body>{body}</applied_to_body>
    <force_expressed_in_body>ground</force_expressed_in_body>
    <point_expressed_in_body>ground</point_expressed_in_body>
    <force_identifier>{name}_v</force_identifier>
    <point_identifier>{name}_p</point_identifier>
    <torque_identifier>{name}_t</torque_identifier>
   </ExternalForce>"""


_EXTERNAL_LOADS = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
 <ExternalLoads name="ground">
  <objects>
{loads}
  </objects>
  <datafile>ground_forces.mot</datafile>
 </ExternalLoads>
</OpenSimDocument>
"""
