"""Writer of personalized models: a model's file with changed wraps and muscle constants.

OpenSim computes the wraps' new poses, but the file is edited as XML, so that nothing else in it changes.
A file written by OpenSim would contain all defaults, a newer document version and other comments.
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
from wrapjax.osim.path_engine import NOMINAL, NominalSurface, WrapParameters, nominal_surfaces

# Class and name of an element, and new texts of its properties.
_Edit = tuple[str, str, dict[str, str]]


class MuscleConstants(NamedTuple):
    """Constants of a muscle besides its path, by OpenSim's names.

    Parameters
    ----------
    optimal_fiber_length, tendon_slack_length
        Lengths, m, above 0.
    max_isometric_force
        Force, N, above 0.
    pennation_angle_at_optimal
        Angle at optimal fiber length, rad, from 0 to below a right angle.
    """

    optimal_fiber_length: float
    tendon_slack_length: float
    max_isometric_force: float
    pennation_angle_at_optimal: float

    @property
    def valid(self) -> bool:
        """Whether all constants are finite and in their ranges."""
        *above_zero, pennation = self
        return bool(np.isfinite(self).all() and min(above_zero) > 0.0 and 0.0 <= pennation < np.pi / 2)


def write_personalised_model(
    model_file: Path | str,
    out_file: Path | str,
    wraps: Mapping[str, WrapParameters],
    muscles: Mapping[str, MuscleConstants],
) -> None:
    """Write a copy of a model's file with changed wraps and muscle constants.

    Parameters
    ----------
    model_file
        OpenSim model (.osim), in which wraps are nominal.
    out_file
        File to write, atomically. May be ``model_file`` itself. OpenSim looks for bone meshes in the model's
        folder, and may not find them if this is another one.
    wraps
        Wrap parameters by wrap name: translation (m) along the nominal frame's axes, rotation (rad) about its
        x axis and then about the rotated y axis, and a factor of all sizes; optionally more
        (`NominalSurface`).
    muscles
        Constants by muscle name; other muscles are unchanged.

    Raises
    ------
    InputError
        If OpenSim cannot load the model, a name is missing in it or not unique, or wrap parameters or
        constants of a muscle are invalid.

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
    surfaces = nominal_surfaces(opensim, model)
    kinds = {muscle.getName(): muscle.getConcreteClassName() for muscle in elements(model.getMuscles())}
    problems = unknown_names(file, "wrap object", wraps, list(surfaces))
    problems += unknown_names(file, "muscle", muscles, list(kinds))
    problems += _invalid_values(file, wraps, muscles)
    if problems:
        raise InputError(problems)

    edits = [_surface_edit(opensim, surfaces[name], parameters) for name, parameters in wraps.items()]
    edits += [_muscle_edit(kinds[name], name, constants) for name, constants in muscles.items()]
    document = minidom.parse(file)
    problems = [problem for edit in edits for problem in _apply(file, document, edit)]
    if problems:
        raise InputError(problems)
    content = document.toxml(encoding="UTF-8")

    def write(temporary: Path) -> None:
        temporary.write_bytes(content)

    write_atomically(Path(out_file), write)


def _invalid_values(
    file: str, wraps: Mapping[str, WrapParameters], muscles: Mapping[str, MuscleConstants]
) -> Iterator[Problem]:
    for name, parameters in wraps.items():
        values = np.asarray(parameters, dtype=float)
        counted = values.size in (len(NOMINAL), len(NOMINAL) + 3)
        if not (counted and np.isfinite(values).all() and min(values[5], *values[7:], np.inf) > 0.0):
            message = "six finite wrap parameters (or nine), with positive factors of sizes, were expected"
            yield Problem(file, f"{message}, and '{_text(parameters)}' found", place=name)
    for name, constants in muscles.items():
        if not constants.valid:
            message = (
                "a positive optimal fiber length, tendon slack length and maximum isometric force, and a "
                "pennation angle from 0 to below a right angle were expected"
            )
            yield Problem(file, f"{message}, and '{_text(constants)}' found", place=name)


def _surface_edit(opensim: Any, nominal: NominalSurface, parameters: WrapParameters) -> _Edit:
    nominal.place(opensim, parameters)
    surface = nominal.surface
    angles, center = surface.get_xyz_body_rotation(), surface.get_translation()
    texts = {
        "xyz_body_rotation": _text(angles.get(axis) for axis in range(3)),
        "translation": _text(center.get(axis) for axis in range(3)),
    }
    for name in nominal.size_properties:
        value = getattr(surface, f"get_{name}")()
        texts[name] = _text([value] if isinstance(value, float) else [value.get(axis) for axis in range(3)])
    return surface.getConcreteClassName(), surface.getName(), texts


def _muscle_edit(kind: str, name: str, constants: MuscleConstants) -> _Edit:
    return kind, name, {tag: _text([value]) for tag, value in constants._asdict().items()}


def _text(values: Iterable[float] | WrapParameters) -> str:
    # ``repr`` gives the shortest text that is read back as the same number.
    return " ".join(repr(float(value)) for value in values)


def _apply(file: str, document: minidom.Document, edit: _Edit) -> Iterator[Problem]:
    """Change an element's properties; yield a problem if there is no unique element of its name."""
    kind, name, texts = edit
    found = [entry for entry in document.getElementsByTagName(kind) if entry.getAttribute("name") == name]
    if len(found) != 1:
        yield Problem(file, f"one <{kind}> of this name was expected, and {len(found)} found", place=name)
        return
    for tag, text in texts.items():
        _set_property(document, found[0], tag, text)


def _set_property(document: minidom.Document, element: minidom.Element, tag: str, text: str) -> None:
    existing = [child for child in element.childNodes if child.nodeName == tag]
    # A property at its default may be missing in the file.
    child = existing[0] if existing else element.appendChild(document.createElement(tag))
    while child.firstChild is not None:
        child.removeChild(child.firstChild)
    child.appendChild(document.createTextNode(text))
