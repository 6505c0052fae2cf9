"""Settings of the NMSM Pipeline's joint model personalization, read as settings of joint personalisation.

The pipeline runs its tasks one after the other. Here all enabled tasks are one estimation: each trial keeps
its markers, and the freed parameters are those of all tasks, so that no task undoes what another has found.
Settings of the pipeline's optimiser have no meaning here and are left alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath
from xml.etree.ElementTree import Element

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.io.xml import read_xml
from wrapjax.joints.freed_parameters import (
    FreedParameter,
    PriorWidths,
    frame_parameters,
    marker_parameters,
    scale_parameters,
)
from wrapjax.joints.settings import JointSettings, MarkerTrial
from wrapjax.osim.model import describe_model

_TOOL = "JointModelPersonalizationTool"


def read_nmsm_settings(file: Path | str) -> JointSettings:
    """Read the settings of the NMSM Pipeline's joint model personalization (.xml).

    Parameters
    ----------
    file
        Settings; model and marker files lie in their ``input_directory``, relative to the settings' folder.

    Raises
    ------
    InputError
        With all faults of the file: no enabled task, files that do not exist, unknown joints, bodies or
        markers, values that are not true or false.
    """
    file = Path(file)
    tool = read_xml(file, "NMSMPipelineDocument").find(_TOOL)
    if tool is None:
        raise InputError(Problem(str(file), f"expected settings of <{_TOOL}>, found none"))
    problems: list[Problem] = []
    folder = file.parent / _posix(tool.findtext("input_directory") or ".")
    model_file = _existing(
        folder, tool.findtext("input_model_file") or "", file, "input_model_file", problems
    )
    tasks = sorted(
        (task for task in tool.iter("JMPTask") if _truth(task.findtext("is_enabled") or "true")),
        key=lambda task: _order(task, file, problems),
    )
    if not tasks:
        problems.append(Problem(str(file), "expected an enabled <JMPTask>, found none"))
    if problems or model_file is None:
        raise InputError(problems)
    description = describe_model(model_file)
    trials = tuple(
        trial
        for number, task in enumerate(tasks, start=1)
        for trial in _trial(task, number, folder, file, problems)
    )
    freed: dict[tuple[str, str, int], FreedParameter] = {}
    for task in tasks:
        for parameter in _parameters(task, description, file, problems):
            freed.setdefault((parameter.kind, parameter.owner, parameter.axis), parameter)
    if not freed and not problems:
        problems.append(Problem(str(file), "expected a freed parameter in some task, found none"))
    if problems:
        raise InputError(dict.fromkeys(problems))
    return JointSettings(
        file=file,
        name=model_file.stem,
        model_file=model_file,
        trials=trials,
        parameters=tuple(freed.values()),
    )


def _trial(
    task: Element, number: int, folder: Path, file: Path, problems: list[Problem]
) -> Iterator[MarkerTrial]:
    name = task.get("name") or f"task {number}"
    path = _existing(folder, task.findtext("marker_file_name") or "", file, "marker_file_name", problems)
    span = (task.findtext("time_range") or "").split()
    names = tuple((task.findtext("marker_names") or "").split()) or None
    if path is None:
        return
    interval = None
    if span:
        try:
            start, end = map(float, span)
        except ValueError:
            message = f"expected two numbers as time_range, found '{' '.join(span)}'"
            problems.append(Problem(str(file), message, name))
            return
        interval = (start, end)
    yield MarkerTrial(name, path, interval=interval, markers=names)


def _parameters(
    task: Element, description: ModelDescription, file: Path, problems: list[Problem]
) -> Iterator[FreedParameter]:
    """Yield the freed parameters of a task."""
    widths = PriorWidths()
    joints = {joint.name for joint in description.joints}
    bodies = {joint.child_body for joint in description.joints}
    for joint in task.iter("JMPJoint"):
        name = joint.get("name", "")
        if not _known(name, joints, "joint", file, problems):
            continue
        for side in ("parent", "child"):
            frame = joint.find(f"{side}_frame_transformation")
            for quantity in ("translation", "orientation") if frame is not None else ():
                assert frame is not None
                axes = _axes(frame, quantity, name, file, problems)
                bound = _number(frame, f"{quantity}_bounds", file, problems)
                if bound is not None and not 0.0 < bound < math.inf:
                    message = f"expected a positive number as {quantity}_bounds, found {bound:g}"
                    problems.append(Problem(str(file), message, name))
                    continue
                yield from frame_parameters(name, f"{side}_{quantity}", axes, widths, bound)
    for body in task.iter("JMPBody"):
        name = body.get("name", "")
        if not _known(name, bodies, "body", file, problems):
            continue
        if _truth(body.findtext("scale_body") or "false"):
            yield from scale_parameters(name, widths, per_axis=False)
        axes = _axes(body, "move_markers", name, file, problems)
        for marker in description.markers:
            if axes and marker.body == name:
                yield from marker_parameters(description, marker.name, widths, axes)
    for name in (word for entry in task.iter("free_markers") for word in (entry.text or "").split()):
        if _known(name, {marker.name for marker in description.markers}, "marker", file, problems):
            yield from marker_parameters(description, name, widths)


def _axes(parent: Element, tag: str, name: str, file: Path, problems: list[Problem]) -> list[int]:
    """Find the axes for which an element of three truth values says true."""
    words = (parent.findtext(tag) or "false false false").split()
    if len(words) != 3 or any(word.lower() not in ("true", "false") for word in words):
        message = f"expected three of true and false as {tag}, found '{' '.join(words)}'"
        problems.append(Problem(str(file), message, name))
        return []
    return [axis for axis, word in enumerate(words) if _truth(word)]


def _order(task: Element, file: Path, problems: list[Problem]) -> float:
    """Place of a task; those without one come last."""
    index = _number(task, "index", file, problems)
    return math.inf if index is None else index


def _number(parent: Element, tag: str, file: Path, problems: list[Problem]) -> float | None:
    """Read a number; None where it is missing or not a number."""
    text = (parent.findtext(tag) or "").strip()
    if not text:
        return None
    try:
        return float(text)
    except ValueError:
        message = f"expected a number as {tag}, found '{text}'"
        problems.append(Problem(str(file), message, parent.get("name") or ""))
        return None


def _known(name: str, known: set[str], what: str, file: Path, problems: list[Problem]) -> bool:
    if name not in known:
        hint = nearest_name(name, sorted(known))
        problems.append(Problem(str(file), f"the model has no such {what}", f"{what} {name}", hint))
    return name in known


def _existing(folder: Path, name: str, file: Path, tag: str, problems: list[Problem]) -> Path | None:
    path = folder / _posix(name)
    try:
        exists = bool(name.strip()) and path.is_file()
    except OSError:  # an impossible file name, such as one that is too long
        exists = False
    if not exists:
        problems.append(Problem(str(file), f"expected a file, found no {path}", f"<{tag}>"))
        return None
    return path


def _posix(name: str) -> str:
    """Convert the path of a file that was written under Windows or elsewhere."""
    return PureWindowsPath(name.strip()).as_posix()


def _truth(text: str) -> bool:
    return text.strip().lower() == "true"
