"""Muscles, coordinates, force groups and mass of a model, read from its ``.osim`` file without OpenSim.

Documents of OpenSim 3 and 4 are read. Every element with an ``optimal_fiber_length`` is a muscle, of whatever
class.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.xml import read_xml

#: Motion types of the coordinates of each joint class, in order (OpenSim 4 files do not state them).
_JOINT_MOTIONS = {
    "PinJoint": ("rotational",),
    "SliderJoint": ("translational",),
    "UniversalJoint": ("rotational",) * 2,
    "BallJoint": ("rotational",) * 3,
    "GimbalJoint": ("rotational",) * 3,
    "EllipsoidJoint": ("rotational",) * 3,
    "ScapulothoracicJoint": ("rotational",) * 4,
    "PlanarJoint": ("rotational", "translational", "translational"),
    "FreeJoint": ("rotational",) * 3 + ("translational",) * 3,
}
#: Tags of the pennation angle in different muscle classes and versions.
_PENNATION = ("pennation_angle_at_optimal", "pennation_angle")


@dataclass(frozen=True)
class MuscleParameters:
    """Force-producing parameters of muscles.

    Parameters
    ----------
    names
        Names of the muscles, in the order of the arrays.
    max_isometric_force
        Maximum isometric force, N.
    optimal_fiber_length
        Optimal fiber length, m.
    tendon_slack_length
        Tendon slack length, m.
    pennation_angle
        Pennation angle at optimal fiber length, rad.
    """

    names: tuple[str, ...]
    max_isometric_force: Float[np.ndarray, " muscle"]
    optimal_fiber_length: Float[np.ndarray, " muscle"]
    tendon_slack_length: Float[np.ndarray, " muscle"]
    pennation_angle: Float[np.ndarray, " muscle"]

    def select(self, names: tuple[str, ...]) -> MuscleParameters:
        """Return the parameters of some muscles, in the order given."""
        rows = np.array([self.names.index(name) for name in names], dtype=int)
        return MuscleParameters(
            names=names,
            max_isometric_force=self.max_isometric_force[rows],
            optimal_fiber_length=self.optimal_fiber_length[rows],
            tendon_slack_length=self.tendon_slack_length[rows],
            pennation_angle=self.pennation_angle[rows],
        )

    def extended_by(self, others: MuscleParameters) -> MuscleParameters:
        """Append other muscles; `select` returns the first entry of a muscle that occurs twice."""
        first, second = (list(vars(parameters).values())[1:] for parameters in (self, others))
        return MuscleParameters(self.names + others.names, *map(np.append, first, second))


@dataclass(frozen=True)
class CoordinateInfo:
    """A coordinate of the model.

    Parameters
    ----------
    name
        Name in OpenSim.
    motion_type
        ``rotational``, ``translational`` or ``coupled`` (along several axes, none of them one to one).
    default_value
        Default value, rad or m.
    range
        Lowest and highest value, rad or m.
    locked
        Whether the model locks the coordinate at its default value.
    """

    name: str
    motion_type: str
    default_value: float
    range: tuple[float, float]
    locked: bool


@dataclass(frozen=True)
class ModelFile:
    """Content of an ``.osim`` file.

    Parameters
    ----------
    muscles
        Parameters of all muscles.
    coordinates
        All coordinates.
    groups
        Names of the members of each group of forces, by the group's name.
    mass_kg
        Mass of all bodies, kg; NaN where a mass is missing or not a number.
    """

    muscles: MuscleParameters
    coordinates: tuple[CoordinateInfo, ...]
    groups: dict[str, tuple[str, ...]]
    mass_kg: float


def read_model_file(path: str | Path) -> ModelFile:
    """Read muscles, coordinates, groups and mass from an ``.osim`` file.

    Returns
    -------
    ModelFile
        Content in SI units and radians, in the order of the file.

    Raises
    ------
    InputError
        With all faults of the file: missing, not XML, not an OpenSim model, no muscles, not a number.
    """
    path = Path(path)
    root = read_xml(path, "OpenSimDocument")
    model = root.find("Model")
    if model is None:
        raise InputError(Problem(str(path), "expected a <Model> in the OpenSim document, found none"))
    # OpenSim would read such a file from any place on this computer.
    problems = [
        Problem(
            str(path),
            f"<{element.tag}> refers to another file, '{other}'",
            hint="include its content in the model file",
        )
        for element in model.iter()
        if (other := element.get("file")) is not None
    ]
    defaults = _remove_defaults(model)
    muscles = _read_muscles(model, defaults, path, problems)
    coordinates = _read_coordinates(model, defaults, path, problems)
    groups = {
        group.get("name", ""): tuple(member.rsplit("/", 1)[-1] for member in _text(group, "members").split())
        for forces in model.iter("ForceSet")
        for group in forces.iter("ObjectGroup")
    }
    if problems:
        raise InputError(problems)
    return ModelFile(muscles, coordinates, groups, _mass(model, defaults))


def _remove_defaults(model: Element) -> dict[str, Element]:
    """Remove the ``<defaults>`` of OpenSim 3 documents from the model and return them by class name."""
    found = {}
    for parent in list(model.iter()):
        for child in parent.findall("defaults"):
            found.update(
                {element.tag: element for element in child.iter() if element.get("name") == "default"}
            )
            parent.remove(child)
    return found


def _text(element: Element, tag: str, default: Element | None = None) -> str:
    """Return the text of a child element, else that of the class's default, else an empty string."""
    for owner in (element, default):
        if owner is not None:
            text = owner.findtext(tag)
            if text is not None and text.strip():
                return text.strip()
    return ""


def _read_muscles(
    model: Element, defaults: dict[str, Element], path: Path, problems: list[Problem]
) -> MuscleParameters:
    names = []
    table = []
    for element in model.iter():
        default = defaults.get(element.tag)
        if element.find("optimal_fiber_length") is None and (
            default is None or default.find("optimal_fiber_length") is None
        ):
            continue
        name = element.get("name", "")
        place = f"muscle {name}"
        if not name or name in names:
            message = "occurs more than once" if name else "has no name"
            problems.append(Problem(str(path), f"a muscle (<{element.tag}>) {message}", place))
            continue
        row = []
        for tag in ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length"):
            row.append(_number(_text(element, tag, default), tag, place, path, problems))
        pennation = next((text for tag in _PENNATION if (text := _text(element, tag, default))), "0")
        row.append(_number(pennation, _PENNATION[0], place, path, problems))
        names.append(name)
        table.append(row)
    if not names:
        problems.append(
            Problem(str(path), "expected muscles (elements with an optimal_fiber_length), found none")
        )
    columns = np.array(table, dtype=float).reshape(len(names), 4)
    return MuscleParameters(tuple(names), columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 3])


def _mass(model: Element, defaults: dict[str, Element]) -> float:
    """Sum the masses of all bodies, kg; NaN where one is missing or not a number."""
    texts = [_text(body, "mass", defaults.get("Body")) for body in model.iter("Body")]
    try:
        return float(sum(map(float, texts))) if texts else float("nan")
    except ValueError:
        return float("nan")


def _number(text: str, tag: str, place: str, path: Path, problems: list[Problem]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        problems.append(Problem(str(path), f"expected a number as {tag}, found '{text[:40]}'", place))
    return value


def _read_coordinates(
    model: Element, defaults: dict[str, Element], path: Path, problems: list[Problem]
) -> tuple[CoordinateInfo, ...]:
    coordinates: dict[str, CoordinateInfo] = {}
    default = defaults.get("Coordinate")
    for joint in model.iter():
        holders = [*joint.findall("coordinates"), *joint.findall("CoordinateSet/objects")]
        elements = [element for holder in holders for element in holder.findall("Coordinate")]
        for order, element in enumerate(elements):
            name = element.get("name", "")
            place = f"coordinate {name}"
            if not name or name in coordinates:
                message = "expected every coordinate to have a unique name"
                problems.append(Problem(str(path), message, place))
                continue
            limits = _text(element, "range", default).split() or ["-inf", "inf"]
            try:
                lower, upper = map(float, limits)
            except ValueError:
                message = f"expected two numbers as range, found '{' '.join(limits)[:40]}'"
                problems.append(Problem(str(path), message, place))
                lower, upper = -np.inf, np.inf
            coordinates[name] = CoordinateInfo(
                name=name,
                motion_type=_motion_type(joint, element, order),
                default_value=_number(
                    _text(element, "default_value", default) or "0", "default_value", place, path, problems
                ),
                range=(lower, upper),
                locked=_text(element, "locked", default).lower() == "true",
            )
    return tuple(coordinates.values())


def _motion_type(joint: Element, coordinate: Element, order: int) -> str:
    """Determine the motion type of a coordinate by OpenSim's rule.

    A coordinate of a custom joint is rotational (translational) if it equals, up to its sign, the angle (the
    displacement) about one of the joint's axes, whatever else it also moves; otherwise it is coupled.
    """
    stated = _text(coordinate, "motion_type").lower()
    if stated in ("rotational", "translational", "coupled"):
        return stated
    if joint.tag in _JOINT_MOTIONS:
        motions = _JOINT_MOTIONS[joint.tag]
        return motions[order] if order < len(motions) else "coupled"
    for axis in joint.iter("TransformAxis"):
        if coordinate.get("name") not in _text(axis, "coordinates").split():
            continue
        for function in (*axis.findall("LinearFunction"), *axis.findall("function/LinearFunction")):
            if re.match(r"[-+]?1(\.0*)?(\s|$)", _text(function, "coefficients")):
                return "rotational" if axis.get("name", "").startswith("rotation") else "translational"
    return "coupled"
