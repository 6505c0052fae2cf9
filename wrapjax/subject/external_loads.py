"""Ground forces of a recording: what acts on which body, read strictly, at any times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.model_file import read_xml
from wrapjax.io.storage import find_column, read_storage, read_storage_header
from wrapjax.io.toml import collecting
from wrapjax.subject.settings import TrialSettings
from wrapjax.subject.trials import TIME_TOLERANCE

#: What OpenSim writes where nothing is named.
_UNNAMED = ("", "unassigned")


@dataclass(frozen=True)
class AppliedLoad:
    """One ``<ExternalForce>``: on which body it acts, and what its columns start with.

    Parameters
    ----------
    name, body
        Its own name, and that of the body it acts on.
    force, point, torque
        What the labels of the three columns of each start with (``x``, ``y`` and ``z`` follow), all in
        ground's frame. Empty where there is none; a force has a point.
    """

    name: str
    body: str
    force: str
    point: str
    torque: str


@dataclass(frozen=True)
class GroundLoads:
    """Everything that acts on bodies from outside during a recording.

    Parameters
    ----------
    bodies
        On which each load acts.
    time
        s, as recorded.
    wrench
        Moment about ground's origin (N m), then force (N), of each load on its body, in ground's frame.
        Unlike a center of pressure it goes to zero smoothly where contact ends.
    """

    bodies: tuple[str, ...]
    time: Float[np.ndarray, " sample"]
    wrench: Float[np.ndarray, "load 6 sample"]

    def at(self, times: Float[np.ndarray, "trial frame"]) -> Float[np.ndarray, "load 6 trial frame"]:
        """Interpolate linearly at times in s; before the first and after the last sample the edge is held.

        A spline would overshoot the corners in which contact starts and ends.
        """
        flat = [[np.interp(times, self.time, row) for row in load] for load in self.wrench]
        return np.array(flat).reshape(*self.wrench.shape[:2], *times.shape)


def read_ground_loads(trial: TrialSettings) -> GroundLoads:
    """Read what acts on which body during a trial that names its ground forces and external loads.

    Raises
    ------
    InputError
        With everything wrong in the two files, or if the forces do not cover a cycle of the trial.
    """
    assert trial.ground_forces is not None and trial.external_loads is not None
    loads = read_external_loads(trial.external_loads)
    # Rows are not counted: a file of forces that was cut to a trial often keeps the header of the whole.
    table = read_storage(trial.ground_forces, trust_row_count=False)
    problems = _uncovered(trial, table.time)
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
    """Check both files, as far as a trial names them, without reading numbers; add what is wrong."""
    header, loads = None, None
    with collecting(problems):
        if trial.ground_forces is not None:
            header = read_storage_header(trial.ground_forces)
    with collecting(problems):
        if trial.external_loads is not None:
            loads = read_external_loads(trial.external_loads)
    if header is not None and loads is not None:
        _places(loads, header.columns, trial, problems)


def _places(
    loads: tuple[AppliedLoad, ...], labels: tuple[str, ...], trial: TrialSettings, problems: list[Problem]
) -> dict[str, list[int]]:
    """Find the three columns of each force, point and torque."""
    wanted = dict.fromkeys(part for load in loads for part in (load.force, load.point, load.torque) if part)
    found: dict[str, list[int]] = {prefix: [] for prefix in wanted}
    for prefix in wanted:
        for label in (prefix + axis for axis in "xyz"):
            places = find_column(labels, label)
            found[prefix] += places
            if len(places) != 1:
                seen = ", ".join(labels[place] for place in places) or "none"
                message = f"expected one column, which {trial.external_loads} names, found {seen}"
                hint = "" if places else nearest_name(label, labels)
                problems.append(Problem(str(trial.ground_forces), message, f"column {label}", hint))
    return found


def read_external_loads(path: Path) -> tuple[AppliedLoad, ...]:
    """Read which columns of a file of forces act on which body.

    Raises
    ------
    InputError
        With everything wrong: no OpenSim file of external loads, a force without a body or a point, one
        that is given in the frame of another body than ground.
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
        message = "expected <point_identifier> to say where the force acts, found none"
        problems.append(Problem(str(path), message, place))
    for tag in ("force_expressed_in_body", "point_expressed_in_body"):
        frame = text(tag).rsplit("/", 1)[-1]
        if frame not in ("", "ground"):
            message = f"expected <{tag}> to be ground, found '{frame}'"
            problems.append(Problem(str(path), message, place, "express forces and points in ground"))
    return load


def _uncovered(trial: TrialSettings, time: Float[np.ndarray, " sample"]) -> list[Problem]:
    """Report cycles that the forces do not cover."""
    spans = f"the recording, which spans {time[0]:g} to {time[-1]:g} s"
    return [
        Problem(
            str(trial.ground_forces),
            f"the cycle lies outside {spans}",
            f"trial '{trial.name}', cycle {order} [{start:g}, {end:g}] s",
        )
        for order, (start, end) in enumerate(trial.cycles, start=1)
        if start < time[0] - TIME_TOLERANCE or end > time[-1] + TIME_TOLERANCE
    ]
