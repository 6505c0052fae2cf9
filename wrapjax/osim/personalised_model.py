"""Write a model with other wrap cylinders and other muscle constants, and nothing else changed.

OpenSim computes where the cylinders go; the file itself is edited as XML. Had OpenSim written it, every
default would be spelled out, old documents upgraded and comments replaced.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.dom import minidom

import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_atomically
from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import elements, unknown_names
from wrapjax.osim.path_engine import NOMINAL, NominalCylinder, WrapParameters, nominal_cylinders

#: What is to be written: an element's class and name, and the text of its properties.
_Edit = tuple[str, str, dict[str, str]]


class MuscleConstants(NamedTuple):
    """What makes one muscle's force beside its path, by OpenSim's names.

    Parameters
    ----------
    optimal_fiber_length, tendon_slack_length
        m, above 0.
    max_isometric_force
        N, above 0.
    pennation_angle_at_optimal
        rad, from 0 and below a right angle.
    """

    optimal_fiber_length: float
    tendon_slack_length: float
    max_isometric_force: float
    pennation_angle_at_optimal: float

    @property
    def possible(self) -> bool:
        """Whether a muscle can have them."""
        *above_zero, pennation = self
        return bool(np.isfinite(self).all() and min(above_zero) > 0.0 and 0.0 <= pennation < np.pi / 2)


def write_personalised_model(
    model_file: Path | str,
    out_file: Path | str,
    wraps: Mapping[str, WrapParameters],
    muscles: Mapping[str, MuscleConstants],
) -> None:
    """Write a model's file again with cylinders moved and muscle constants changed.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    out_file
        Where to write; whole or not at all. May be ``model_file`` itself. Bone meshes are looked for
        beside a model, so that in another folder they may not be found.
    wraps
        Wrap cylinder to its six parameters: translation (m) along the nominal frame's axes, turns (rad)
        about its x and then its own y axis, and the radius as a multiple of the nominal one. What is
        nominal, ``model_file`` says.
    muscles
        Muscle to its constants; muscles that are not named keep theirs.

    Raises
    ------
    InputError
        If OpenSim cannot load the model, it does not have all that is named (each name but once), or a
        radius factor or constant of a muscle is impossible.

    Examples
    --------
    >>> write_personalised_model(
    ...     "model.osim",
    ...     "model_personalized.osim",
    ...     wraps={"PS_at_brim_l": (0.002, 0.0, -0.001, 0.1, 0.0, 1.1)},
    ...     muscles={"psoas_l": MuscleConstants(0.11, 0.10, 2500.0, 0.2)},
    ... )  # doctest: +SKIP
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    file = str(model_file)
    cylinders = nominal_cylinders(opensim, model)
    kinds = {muscle.getName(): muscle.getConcreteClassName() for muscle in elements(model.getMuscles())}
    problems = unknown_names(file, "wrap cylinder", wraps, list(cylinders))
    problems += unknown_names(file, "muscle", muscles, list(kinds))
    problems += _impossible_values(file, wraps, muscles)
    if problems:
        raise InputError(problems)

    edits = [_cylinder_edit(opensim, cylinders[name], parameters) for name, parameters in wraps.items()]
    edits += [_muscle_edit(kinds[name], name, constants) for name, constants in muscles.items()]
    document = minidom.parse(file)
    problems = [problem for edit in edits for problem in _apply(file, document, edit)]
    if problems:
        raise InputError(problems)
    content = document.toxml(encoding="UTF-8")

    def write(temporary: Path) -> None:
        temporary.write_bytes(content)

    write_atomically(Path(out_file), write)


def _impossible_values(
    file: str, wraps: Mapping[str, WrapParameters], muscles: Mapping[str, MuscleConstants]
) -> Iterator[Problem]:
    for name, parameters in wraps.items():
        if not (len(parameters) == len(NOMINAL) and np.isfinite(parameters).all() and parameters[-1] > 0.0):
            message = "six finite wrap parameters, the last one positive, were expected"
            yield Problem(file, f"{message}, and '{_text(parameters)}' found", place=name)
    for name, constants in muscles.items():
        if not constants.possible:
            message = (
                "a positive optimal fiber length, tendon slack length and maximum isometric force, and a "
                "pennation angle from 0 to below a right angle were expected"
            )
            yield Problem(file, f"{message}, and '{_text(constants)}' found", place=name)


def _cylinder_edit(opensim: Any, nominal: NominalCylinder, parameters: WrapParameters) -> _Edit:
    nominal.place(opensim, parameters)
    cylinder = nominal.cylinder
    turn, center = cylinder.get_xyz_body_rotation(), cylinder.get_translation()
    texts = {
        "xyz_body_rotation": _text(turn.get(axis) for axis in range(3)),
        "translation": _text(center.get(axis) for axis in range(3)),
        "radius": _text([cylinder.get_radius()]),
    }
    return cylinder.getConcreteClassName(), cylinder.getName(), texts


def _muscle_edit(kind: str, name: str, constants: MuscleConstants) -> _Edit:
    return kind, name, {tag: _text([value]) for tag, value in constants._asdict().items()}


def _text(values: Iterable[float] | WrapParameters) -> str:
    # The shortest digits that are read back as the same number.
    return " ".join(repr(float(value)) for value in values)


def _apply(file: str, document: minidom.Document, edit: _Edit) -> Iterator[Problem]:
    """Change an element's properties, or say why this cannot be done."""
    kind, name, texts = edit
    found = [entry for entry in document.getElementsByTagName(kind) if entry.getAttribute("name") == name]
    if len(found) != 1:
        yield Problem(file, f"one <{kind}> of this name was expected, and {len(found)} found", place=name)
        return
    for tag, text in texts.items():
        _set_property(document, found[0], tag, text)


def _set_property(document: minidom.Document, element: minidom.Element, tag: str, text: str) -> None:
    own = [child for child in element.childNodes if child.nodeName == tag]
    # A property at its default may be left out of a file.
    child = own[0] if own else element.appendChild(document.createElement(tag))
    while child.firstChild is not None:
        child.removeChild(child.firstChild)
    child.appendChild(document.createTextNode(text))
