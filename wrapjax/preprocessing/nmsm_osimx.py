"""The NMSM Pipeline's file of muscle parameters, ``.osimx``.

Its delays count tenths of a second and its time constants hundredths, as its code does; here both are in s.

Settings of the NMSM Pipeline's muscle-tendon personalisation: what of them says what was recorded.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Comment, Element, SubElement

import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.io.model_file import read_xml

ROOT = "NMSMPipelineDocument"
_TOOL = "MuscleTendonPersonalizationTool"


@dataclass(frozen=True)
class ToolSettings:
    """What a settings file names. How its tool optimises (tasks, cost terms) is not read.

    Parameters
    ----------
    file
        The settings themselves.
    model_file, osimx_file
        Model, and the parameters of an earlier step; None where none are named.
    data_directory
        Folder of ``IKData``, ``IDData``, ``EMGData`` and, where there is one, ``MAData``.
    coordinates
        Whose moments are tracked.
    collected, missing
        Groups of muscles with an EMG channel, and without.
    prefixes
        With which names of trial files begin; empty for all.
    passive
        Folder of passive trials as the settings write it; empty where they name none.
    """

    file: Path
    model_file: Path
    osimx_file: Path | None
    data_directory: Path
    coordinates: tuple[str, ...]
    collected: tuple[str, ...]
    missing: tuple[str, ...]
    prefixes: tuple[str, ...]
    passive: str = ""


def read_tool_settings(path: str | Path) -> ToolSettings:
    """Read the settings of a muscle-tendon personalisation.

    Raises
    ------
    InputError
        With everything wrong: no such file, not these settings, something named that there is not.
    """
    path = Path(path)
    root = read_xml(path, ROOT)
    tool = root.find(_TOOL)
    if tool is None:
        found = ", ".join(f"<{child.tag}>" for child in root) or "nothing"
        raise InputError(Problem(str(path), f"expected a <{_TOOL}>, found {found}"))
    problems: list[Problem] = []
    model = _named(tool, "input_model_file", path, problems, directory=False)
    data = _named(tool, "data_directory", path, problems, directory=True)
    osimx = None
    if (tool.findtext("input_osimx_file") or "").strip():
        osimx = _named(tool, "input_osimx_file", path, problems, directory=False)
    coordinates = _words(tool, "coordinate_list")
    collected = _words(tool, "collected_emg_channel_muscle_groups")
    for tag, names in (
        ("coordinate_list", coordinates),
        ("collected_emg_channel_muscle_groups", collected),
    ):
        if not names:
            problems.append(Problem(str(path), "expected names, found none", f"<{tag}>"))
    if problems:
        raise InputError(problems)
    assert model is not None and data is not None
    missing = _words(tool, "missing_emg_channel_muscle_groups")
    prefixes = _words(tool, "trial_prefixes")
    passive = next(tool.iter("passive_data_input_directory"), None)
    return ToolSettings(
        path,
        model,
        osimx,
        data,
        coordinates,
        collected,
        missing,
        prefixes,
        "" if passive is None else (passive.text or "").strip(),
    )


def _words(tool: Element, tag: str) -> tuple[str, ...]:
    return tuple((tool.findtext(tag) or "").split())


def _named(
    tool: Element, tag: str, settings: Path, problems: list[Problem], *, directory: bool
) -> Path | None:
    """Find what a tag names: from the folder of the settings, and with Windows' separators understood."""
    text = (tool.findtext(tag) or "").strip()
    kind = "folder" if directory else "file"
    if not text:
        problems.append(Problem(str(settings), f"expected the name of a {kind}, found none", f"<{tag}>"))
        return None
    place = settings.parent / text.replace("\\", "/")
    try:
        there = place.is_dir() if directory else place.is_file()
    except OSError:  # a name that no file can have
        there = False
    if not there:
        problems.append(Problem(str(settings), f"names the {kind} '{text}', which there is not", f"<{tag}>"))
    return place


#: By our name: the file's, and the unit of its numbers in ours.
OSIMX_QUANTITIES: Mapping[str, tuple[str, float]] = {
    "electromechanical_delay": ("electromechanical_delay", 0.1),
    "activation_time_constant": ("activation_time_constant", 0.01),
    "activation_nonlinearity": ("activation_nonlinearity_constant", 1.0),
    "emg_scale": ("emg_scale_factor", 1.0),
    "optimal_fiber_length": ("optimal_fiber_length", 1.0),
    "tendon_slack_length": ("tendon_slack_length", 1.0),
    "max_isometric_force": ("max_isometric_force", 1.0),
}
#: Of the documents that are written.
_VERSION = "1.5.0"


@dataclass(frozen=True)
class OsimxMuscle:
    """What a file says of one muscle.

    Parameters
    ----------
    name
        Of the muscle.
    values
        By our name of the quantity (`OSIMX_QUANTITIES`), SI units; what the file does not give is left out.
    """

    name: str
    values: Mapping[str, float]


def read_osimx(path: str | Path) -> tuple[OsimxMuscle, ...]:
    """Read the muscles of an ``.osimx`` file; what else is in it is passed over.

    Raises
    ------
    InputError
        With everything wrong in the file.
    """
    path = Path(path)
    root = read_xml(path, ROOT)
    problems: list[Problem] = []
    muscles: dict[str, OsimxMuscle] = {}
    for element in root.iter("RCNLMuscle"):
        name = element.get("name", "").strip()
        if not name or name in muscles:
            found = "a second time" if name else "without a name"
            problems.append(Problem(str(path), f"a muscle is there {found}", f"<RCNLMuscle> {name}".strip()))
            continue
        muscles[name] = OsimxMuscle(name, _values(element, name, path, problems))
    if problems:
        raise InputError(problems)
    return tuple(muscles.values())


def _values(element: Element, muscle: str, path: Path, problems: list[Problem]) -> dict[str, float]:
    found = {}
    for name, (tag, unit) in OSIMX_QUANTITIES.items():
        text = (element.findtext(tag) or "").strip()
        if not text:
            continue
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            place = f"muscle {muscle}, <{tag}>"
            problems.append(Problem(str(path), f"expected a number, found '{text[:40]}'", place))
            continue
        found[name] = value * unit
    return found


def osimx_text(name: str, model_file: str, muscles: Sequence[OsimxMuscle], remark: str = "") -> str:
    """Write muscles as the text of an ``.osimx`` file.

    Parameters
    ----------
    name
        Of the model.
    model_file
        The model's file, from the folder of this one.
    muscles
        In SI units.
    remark
        What a reader has to know of them, as a comment at the top; without two hyphens in a row.
    """
    root = Element(ROOT, Version=_VERSION)
    if remark:
        root.append(Comment(f" {remark} "))
    model = SubElement(root, "OsimxModel", name=name)
    SubElement(model, "associated_osim_model").text = model_file
    objects = SubElement(SubElement(model, "RCNLMuscleSet"), "objects")
    for muscle in muscles:
        element = SubElement(objects, "RCNLMuscle", name=muscle.name)
        for quantity, value in muscle.values.items():
            tag, unit = OSIMX_QUANTITIES[quantity]
            SubElement(element, tag).text = repr(float(value) / unit)
    ElementTree.indent(root, "   ")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
