"""Ground reaction forces of a recording, and OpenSim's external loads that assign them to bodies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.storage import find_columns, read_storage, read_storage_header
from wrapjax.io.toml import collect_problems
from wrapjax.io.xml import read_xml
from wrapjax.subject.trial_settings import TrialSettings
from wrapjax.subject.trials import TIME_TOLERANCE

#: Values that OpenSim writes for an empty name.
_UNNAMED = ("", "unassigned")


@dataclass(frozen=True)
class AppliedLoad:
    """External force on a body (``<ExternalForce>``) and the columns that hold it.

    Parameters
    ----------
    name
        Name of the external force.
    body
        Name of the body on which it acts.
    force, point, torque
        Prefixes of the labels of the three columns each (``x``, ``y`` and ``z`` follow) of the force, its
        point of application and the torque, in the ground frame. Empty if there is none; a force has a point.
    """

    name: str
    body: str
    force: str
    point: str
    torque: str


@dataclass(frozen=True)
class GroundLoads:
    """External forces and moments on bodies during a recording.

    Parameters
    ----------
    bodies
        Body on which each load acts.
    time
        Times, s, as recorded.
    wrench
        Moment about the origin of ground (N m), then force (N), of each load on its body, in the ground
        frame. Unlike the center of pressure it goes to zero smoothly at the end of a contact.
    """

    bodies: tuple[str, ...]
    time: Float[np.ndarray, " sample"]
    wrench: Float[np.ndarray, "load 6 sample"]

    def at(self, times: Float[np.ndarray, "trial frame"]) -> Float[np.ndarray, "load 6 trial frame"]:
        """Interpolate the wrench linearly at times in s; outside the recording the edge value is held.

        A spline would overshoot at the start and the end of contact.
        """
        flat = [[np.interp(times, self.time, row) for row in load] for load in self.wrench]
        return np.array(flat).reshape(*self.wrench.shape[:2], *times.shape)


def read_ground_loads(trial: TrialSettings) -> GroundLoads:
    """Read the external loads of a trial whose settings name ground forces and external loads.

    Raises
    ------
    InputError
        With all faults of the two files, or if the forces do not cover a cycle of the trial.
    """
    assert trial.ground_forces is not None and trial.external_loads is not None
    loads = read_external_loads(trial.external_loads)
    # A file that was cut to a trial often keeps the number of rows of the original in its header.
    table = read_storage(trial.ground_forces, trust_row_count=False)
    problems = _cycles_outside(trial, table.time)
    places = _places(loads, table.columns, trial, problems)
    if problems:
        raise InputError(dict.fromkeys(problems))

    def columns(prefix: str) -> Float[np.ndarray, "3 sample"]:
        return table.values.T[places[prefix]] if prefix else np.zeros((3, table.time.size))

    def wrench(load: AppliedLoad) -> Float[np.ndarray, "6 sample"]:
        force = columns(load.force)
        return np.concatenate([columns(load.torque) + np.cross(columns(load.point), force, axis=0), force])

    return GroundLoads(
        tuple(load.body for load in loads), table.time, np.array([wrench(load) for load in loads])
    )


def check_ground_loads(trial: TrialSettings, problems: list[Problem]) -> None:
    """Check the files of ground forces and external loads of a trial without reading numbers."""
    header, loads = None, None
    with collect_problems(problems):
        if trial.ground_forces is not None:
            header = read_storage_header(trial.ground_forces)
    with collect_problems(problems):
        if trial.external_loads is not None:
            loads = read_external_loads(trial.external_loads)
    if header is not None and loads is not None:
        _places(loads, header.columns, trial, problems)


def _places(
    loads: tuple[AppliedLoad, ...], labels: tuple[str, ...], trial: TrialSettings, problems: list[Problem]
) -> dict[str, list[int]]:
    """Find the three columns of each force, point and torque."""
    prefixes = dict.fromkeys(part for load in loads for part in (load.force, load.point, load.torque) if part)
    found: dict[str, list[int]] = {prefix: [] for prefix in prefixes}
    for prefix in prefixes:
        for label in (prefix + axis for axis in "xyz"):
            places = find_columns(labels, label)
            found[prefix] += places
            if len(places) != 1:
                matches = ", ".join(labels[place] for place in places) or "none"
                message = f"expected one column, which {trial.external_loads} names, found {matches}"
                hint = "" if places else nearest_name(label, labels)
                problems.append(Problem(str(trial.ground_forces), message, f"column {label}", hint))
    return found


def read_external_loads(path: Path) -> tuple[AppliedLoad, ...]:
    """Read OpenSim's file of external loads: the columns of forces and the bodies on which they act.

    Raises
    ------
    InputError
        With all faults: not an OpenSim file of external loads, a force without a body or a point, a force
        that is not expressed in ground.
    """
    root = read_xml(path, "OpenSimDocument")
    problems: list[Problem] = []
    loads = [_load(element, path, problems) for element in root.iter("ExternalForce")]
    if not loads:
        problems.append(Problem(str(path), "expected at least one <ExternalForce>, found none"))
    if problems:
        raise InputError(problems)
    return tuple(loads)


def _load(element: Element, path: Path, problems: list[Problem]) -> AppliedLoad:
    name = element.get("name") or "unnamed"
    place = f"<ExternalForce> '{name}'"

    def text(tag: str) -> str:
        found = (element.findtext(tag) or "").strip()
        return "" if found.lower() in _UNNAMED else found

    load = AppliedLoad(
        name=name,
        body=text("applied_to_body").rsplit("/", 1)[-1],
        force=text("force_identifier"),
        point=text("point_identifier"),
        torque=text("torque_identifier"),
    )
    if not load.body:
        problems.append(Problem(str(path), "expected <applied_to_body> to name a body, found none", place))
    if not (load.force or load.torque):
        message = "expected <force_identifier> or <torque_identifier> to name columns, found neither"
        problems.append(Problem(str(path), message, place))
    if load.force and not load.point:
        message = "expected <point_identifier> to name the columns of the point of application, found none"
        problems.append(Problem(str(path), message, place))
    for tag in ("force_expressed_in_body", "point_expressed_in_body"):
        frame = text(tag).rsplit("/", 1)[-1]
        if frame not in ("", "ground"):
            message = f"expected <{tag}> to be ground, found '{frame}'"
            problems.append(Problem(str(path), message, place, "express forces and points in ground"))
    return load


def _cycles_outside(trial: TrialSettings, time: Float[np.ndarray, " sample"]) -> list[Problem]:
    """Return a problem for each cycle that the forces do not cover."""
    recording = f"the recording, which spans {time[0]:g} to {time[-1]:g} s"
    return [
        Problem(
            str(trial.ground_forces),
            f"the cycle lies outside {recording}",
            f"trial '{trial.name}', cycle {order} [{start:g}, {end:g}] s",
        )
        for order, (start, end) in enumerate(trial.cycles, start=1)
        if start < time[0] - TIME_TOLERANCE or end > time[-1] + TIME_TOLERANCE
    ]
