"""What a subject's model says, read from its ``.osim`` file as XML, without OpenSim.

Old (3.x) and new (4.x) documents are understood. A muscle is whatever has an ``optimal_fiber_length``, so
that every muscle class counts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.files import read_content
from wrapjax.io.xml import MOST_BYTES, parse_xml

#: Motion types of the coordinates of joints that say nothing themselves (OpenSim 4), in order.
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
#: Names of one property in different muscle classes and versions.
_PENNATION = ("pennation_angle_at_optimal", "pennation_angle")


@dataclass(frozen=True)
class MuscleParameters:
    """Force-producing parameters, one row a muscle.

    Parameters
    ----------
    names
        Muscles, in the order of all rows.
    max_isometric_force
        N.
    optimal_fiber_length
        m.
    tendon_slack_length
        m.
    pennation_angle
        rad, at optimal fiber length.
    """

    names: tuple[str, ...]
    max_isometric_force: Float[np.ndarray, " muscle"]
    optimal_fiber_length: Float[np.ndarray, " muscle"]
    tendon_slack_length: Float[np.ndarray, " muscle"]
    pennation_angle: Float[np.ndarray, " muscle"]

    def select(self, names: tuple[str, ...]) -> MuscleParameters:
        """Keep some muscles, in the order given."""
        rows = np.array([self.names.index(name) for name in names], dtype=int)
        return MuscleParameters(
            names=names,
            max_isometric_force=self.max_isometric_force[rows],
            optimal_fiber_length=self.optimal_fiber_length[rows],
            tendon_slack_length=self.tendon_slack_length[rows],
            pennation_angle=self.pennation_angle[rows],
        )

    def followed_by(self, others: MuscleParameters) -> MuscleParameters:
        """Append other muscles; of one that is in both, `select` gives the first."""
        own, added = (list(vars(one).values())[1:] for one in (self, others))
        return MuscleParameters(self.names + others.names, *map(np.append, own, added))


@dataclass(frozen=True)
class CoordinateInfo:
    """A coordinate of the model.

    Parameters
    ----------
    name
        OpenSim's name.
    motion_type
        ``rotational``, ``translational`` or ``coupled`` (moves several axes, none of them one to one).
    default_value
        rad or m.
    range
        Lowest and highest value in rad or m.
    locked
        Whether the model holds it at its default value.
    """

    name: str
    motion_type: str
    default_value: float
    range: tuple[float, float]
    locked: bool


@dataclass(frozen=True)
class ModelFile:
    """What a model's file says.

    Parameters
    ----------
    muscles, coordinates, groups
        Muscles, coordinates, and groups of forces by their names.
    mass_kg
        Sum over all bodies; NaN where the file does not say.
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
        In SI units and radians, in the file's order.

    Raises
    ------
    InputError
        With everything wrong: missing, not XML, not an OpenSim model, no muscles, a number that is none.
    """
    path = Path(path)
    root = read_xml(path, "OpenSimDocument")
    model = root.find("Model")
    if model is None:
        raise InputError(Problem(str(path), "expected a <Model> in the OpenSim document, found none"))
    # OpenSim would read it, wherever it is: a model's parts are to be in the model.
    problems = [
        Problem(str(path), f"<{one.tag}> is to be read from another file, '{other}'", hint="put it in here")
        for one in model.iter()
        if (other := one.get("file")) is not None
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


def read_xml(path: Path, root_tag: str) -> Element:
    """Parse an XML file and check its root.

    Raises
    ------
    InputError
        If it is missing, is nothing that `parse_xml` takes, or has another root.
    """
    root = parse_xml(read_content(path, "XML", most_bytes=MOST_BYTES), path)
    if root.tag != root_tag:
        raise InputError(Problem(str(path), f"expected the root element <{root_tag}>, found <{root.tag}>"))
    return root


def _remove_defaults(model: Element) -> dict[str, Element]:
    """Take the ``<defaults>`` of old documents out of the model: one element a class, by its tag."""
    found = {}
    for parent in list(model.iter()):
        for child in parent.findall("defaults"):
            found.update(
                {element.tag: element for element in child.iter() if element.get("name") == "default"}
            )
            parent.remove(child)
    return found


def _text(element: Element, tag: str, default: Element | None = None) -> str:
    """Text of a child element; of the class's default where the element lacks it; else empty."""
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
            message = "is there more than once" if name else "has no name"
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
    """Sum the bodies' masses in kg; NaN where one is missing or no number."""
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
                message = "expected every coordinate to have a name of its own"
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
    """Say what a coordinate moves, as OpenSim does.

    A coordinate of a custom joint is rotational (translational) where it is the angle (the distance) along
    one of the joint's axes, one to one, whatever else it also moves; and coupled otherwise.
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
