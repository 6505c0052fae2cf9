"""Ground reaction forces under each foot: reading, filtering, writing; frames with all contact measured.

Another format of force plates needs a reader that returns `FootForces`, called in
`wrapjax.preprocessing.trial_preparation`; `read_plates` reads those of ``.c3d`` files.

In overground walking a foot may step beside the plates, where its force is not measured. Contact is known
from the forces alone, in whatever unit: a foot on its plate; a foot that is certainly in the air, for some
time before and after a stance and between two stances that are no further apart than a swing; and, in the
middle half of a stance in walking, the other foot in the air.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import write_text
from wrapjax.io.storage import Storage, find_columns, read_storage, write_storage
from wrapjax.preprocessing.files.markers import low_pass
from wrapjax.preprocessing.gait.gait_events import CONTACT_FORCE, MIN_PHASE_DURATION, without_short_runs

#: Names of the sides.
SIDES = {"l": "left", "r": "right"}
#: A foot is on a plate above this share of the largest vertical force on any foot.
CONTACT_SHARE = 0.05
#: Longest swing, in stances of the same foot: in walking a stance takes at least 0.4 of the gait cycle. A
#: longer gap contains a step that was not measured.
MAX_SWING = 1.5
#: Time before a strike and after a toe-off in which the foot is certainly in the air, in stances.
CERTAIN_SWING = 0.25
#: Part of a stance in which, in walking, the other foot is in the air.
SINGLE_SUPPORT = (0.25, 0.75)
#: Smallest share of that part that must be within the recording: in half of it the force mainly rises or
#: mainly falls, so that a wrong amplitude and a time shift have the same effect.
MIN_RECORDED_SHARE = 0.75


@dataclass(frozen=True)
class FootForces:
    """Ground reaction force and moment on each foot, in OpenSim's axes (y up).

    Parameters
    ----------
    sides
        Sides of the measured feet, ``l`` or ``r``.
    time
        Times, s.
    wrench
        Moment about the origin of ground (N m), then force (N), of the ground on each foot.
    """

    sides: tuple[str, ...]
    time: Float[np.ndarray, " sample"]
    wrench: Float[np.ndarray, "foot 6 sample"]

    def vertical(self, side: str) -> Float[np.ndarray, " sample"]:
        """Return the upward force on a foot, N."""
        return self.wrench[self.sides.index(side), 4]

    def filtered(self, cutoff_hz: float) -> FootForces:
        """Low-pass filter the wrench; unlike a center of pressure it is smooth at the end of contact."""
        flat = low_pass(self.time, self.wrench.reshape(-1, self.time.size), cutoff_hz)
        return replace(self, wrench=flat.reshape(self.wrench.shape))

    def during(self, start: float, end: float) -> FootForces:
        """Select the samples from ``start`` to ``end``, s."""
        selected = (self.time >= start - 1e-9) & (self.time <= end + 1e-9)
        return replace(self, time=self.time[selected], wrench=self.wrench[..., selected])

    def at(self, time: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "foot 6 frame"]:
        """Interpolate the wrench linearly at times in s."""
        rows = [np.interp(time, self.time, row) for row in self.wrench.reshape(-1, self.time.size)]
        return np.array(rows).reshape(*self.wrench.shape[:2], time.size)


def centers_of_pressure(
    wrench: Float[np.ndarray, "foot 6 sample"], min_force: float = CONTACT_FORCE
) -> Float[np.ndarray, "foot 3 sample"]:
    """Compute the center of pressure of each foot in the ground plane (y = 0), m.

    While the vertical force is at most ``min_force`` (N) the last center is kept; before the first contact,
    the first one. It is zero for a foot that is never in contact.
    """
    centers = np.zeros((wrench.shape[0], 3, wrench.shape[2]))
    for center, (moment_x, _, moment_z, _, up, _) in zip(centers, wrench, strict=True):
        loaded = np.flatnonzero(up > min_force)
        if loaded.size == 0:
            continue
        before = np.searchsorted(loaded, np.arange(up.size), side="right") - 1
        source = loaded[np.maximum(before, 0)]
        center[0] = (moment_z[loaded] / up[loaded])[np.maximum(before, 0)]
        center[2] = -moment_x[source] / up[source]
    return centers


@dataclass(frozen=True)
class ForceColumns:
    """Columns of a ``.mot`` file, or force plates of a ``.c3d`` file, that hold the force on one foot.

    Parameters
    ----------
    body
        Body of the model on which the ground acts.
    force, point, torque
        Prefixes of the column labels (``x``, ``y``, ``z`` follow) of force, center of pressure and free
        torque, in the ground frame; ``torque`` may be empty.
    plates
        Numbers of the force plates, from 1.
    """

    body: str
    force: str = ""
    point: str = ""
    torque: str = ""
    plates: tuple[int, ...] = ()


def read_force_columns(path: Path, feet: dict[str, ForceColumns]) -> FootForces:
    """Read the forces on each foot from a ``.mot`` or ``.sto`` file in N, m and N m.

    Raises
    ------
    InputError
        With all faults of the file, and every missing column.
    """
    table = read_storage(path, trust_row_count=False)
    problems: list[Problem] = []

    def columns(prefix: str) -> Float[np.ndarray, "3 sample"]:
        if not prefix:
            return np.zeros((3, table.time.size))
        found = [find_columns(table.columns, prefix + axis) for axis in "xyz"]
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
        # Without force the point of application is undefined, and files hold arbitrary values.
        moment = np.where(np.any(force != 0.0, axis=0), np.cross(point, force, axis=0), 0.0)
        wrench.append(np.concatenate([torque + moment, force]))
    if problems:
        raise InputError(problems)
    return FootForces(tuple(feet), table.time, np.array(wrench))


def write_forces(folder: Path, forces: FootForces, feet: dict[str, ForceColumns]) -> None:
    """Write forces as ``ground_forces.mot`` and ``external_loads.xml`` into a folder.

    The part of the moment that the force at the center of pressure does not give is written as a free torque.
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


@dataclass(frozen=True)
class Steps:
    """Stances of one foot on its force plates.

    Parameters
    ----------
    strikes, offs
        Start and end of each stance, s; a stance that extends beyond the recording starts or ends at its
        limit.
    complete
        Whether both the start and the end of each stance were recorded.
    """

    strikes: Float[np.ndarray, " step"]
    offs: Float[np.ndarray, " step"]
    complete: Bool[np.ndarray, " step"]

    @property
    def stance(self) -> float:
        """Median duration of a stance, s; NaN without any."""
        if self.strikes.size == 0:
            return float("nan")
        durations = self.offs - self.strikes
        return float(np.median(durations[self.complete]) if self.complete.any() else durations.max())

    def on_plate(self, time: Float[np.ndarray, " frame"], margin: float = 0.0) -> Bool[np.ndarray, " frame"]:
        """Return whether the foot is on a plate at each time, or within ``margin`` s before or after."""
        return _within(time, self.strikes - margin, self.offs + margin)

    def contact_known(self, time: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """Return whether the foot is certainly on a plate or in the air (not beside plates) at each time."""
        if self.strikes.size == 0:
            return np.zeros(time.size, bool)
        swings = self.strikes[1:] - self.offs[:-1] <= MAX_SWING * self.stance
        in_air = _within(time, self.offs[:-1][swings], self.strikes[1:][swings])
        return self.on_plate(time, CERTAIN_SWING * self.stance) | in_air

    def single_support(self, time: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """Return whether the foot is certainly in single support (middle of a complete stance)."""
        first, last = (self.strikes + share * (self.offs - self.strikes) for share in SINGLE_SUPPORT)
        recorded = np.minimum(last, time[-1]) - np.maximum(first, time[0])
        usable = self.complete & (recorded >= MIN_RECORDED_SHARE * (last - first))
        return _within(time, first[usable], last[usable])

    def durations_off_plate(self, start: float, end: float) -> Float[np.ndarray, " span"]:
        """Compute the duration of each interval off the plates between two times, s."""
        inside = (self.offs > start) & (self.strikes < end)
        interval_start = np.concatenate([[start], np.minimum(self.offs[inside], end)])
        interval_end = np.concatenate([np.maximum(self.strikes[inside], start), [end]])
        return np.asarray(interval_end - interval_start)


def _within(
    time: Float[np.ndarray, " frame"], starts: Float[np.ndarray, " span"], ends: Float[np.ndarray, " span"]
) -> Bool[np.ndarray, " frame"]:
    return np.asarray(((time >= starts[:, None]) & (time <= ends[:, None])).any(axis=0))


def find_plate_contacts(forces: FootForces) -> dict[str, Steps]:
    """Find the stances of each foot on its plates.

    Parameters
    ----------
    forces
        Forces, upward positive, in any unit.

    Returns
    -------
    dict
        Stances by side.
    """
    threshold = max(CONTACT_SHARE * float(forces.wrench[:, 4].max()), 0.0)
    return {side: _find_steps(forces.time, forces.vertical(side), threshold) for side in forces.sides}


def _find_steps(
    time: Float[np.ndarray, " sample"], vertical: Float[np.ndarray, " sample"], threshold: float
) -> Steps:
    on = without_short_runs(time, vertical > threshold, MIN_PHASE_DURATION)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    first, after = edges[::2], edges[1::2]
    complete = (first > 0) & (after < time.size)
    return Steps(time[first], time[np.minimum(after, time.size - 1)], complete)


def all_contact_measured(
    time: Float[np.ndarray, " frame"], steps: Sequence[Steps]
) -> Bool[np.ndarray, " frame"]:
    """Return whether, in walking, the plates measured all ground contact at each time.

    Parameters
    ----------
    time
        Times, s.
    steps
        Stances of one foot or of both.
    """
    single_support = np.any([foot.single_support(time) for foot in steps], axis=0)
    if len(steps) < 2:
        return np.asarray(single_support)
    return np.asarray(single_support | np.all([foot.contact_known(time) for foot in steps], axis=0))
