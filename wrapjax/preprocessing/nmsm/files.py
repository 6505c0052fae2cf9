"""XML files of the NMSM Pipeline: muscle-tendon personalisation settings and ``.osimx`` muscle parameters.

In ``.osimx`` files delays are in tenths of a second and time constants in hundredths; here both are in s.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Comment, Element, SubElement

import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.io.xml import read_xml

#: Root element of the files.
ROOT = "NMSMPipelineDocument"
_TOOL = "MuscleTendonPersonalizationTool"


@dataclass(frozen=True)
class ToolSettings:
    """Recordings and files that a settings file names; optimisation tasks and cost terms are not read.

    Parameters
    ----------
    file
        Settings file.
    model_file
        OpenSim model.
    osimx_file
        Muscle parameters of an earlier step, None if not given.
    data_directory
        Folder of ``IKData``, ``IDData``, ``EMGData`` and, optionally, ``MAData``.
    coordinates
        Coordinates whose moments are tracked.
    collected, missing
        Groups of muscles with and without an EMG channel.
    prefixes
        Prefixes of the names of the trial files to use; empty for all.
    passive
        Folder of passive trials as written in the settings; empty if not given.
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
        With all faults: the file is missing or not such a settings file, or names a file that does not exist.
    """
    path = Path(path)
    root = read_xml(path, ROOT)
    tool = root.find(_TOOL)
    if tool is None:
        found = ", ".join(f"<{child.tag}>" for child in root) or "nothing"
        raise InputError(Problem(str(path), f"expected a <{_TOOL}>, found {found}"))
    problems: list[Problem] = []
    model = _read_path(tool, "input_model_file", path, problems, directory=False)
    data = _read_path(tool, "data_directory", path, problems, directory=True)
    osimx = None
    if (tool.findtext("input_osimx_file") or "").strip():
        osimx = _read_path(tool, "input_osimx_file", path, problems, directory=False)
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


def _read_path(
    tool: Element, tag: str, settings: Path, problems: list[Problem], *, directory: bool
) -> Path | None:
    """Read a path that is relative to the folder of the settings; separators may be those of Windows."""
    text = (tool.findtext(tag) or "").strip()
    kind = "folder" if directory else "file"
    if not text:
        problems.append(Problem(str(settings), f"expected the name of a {kind}, found none", f"<{tag}>"))
        return None
    path = settings.parent / text.replace("\\", "/")
    try:
        exists = path.is_dir() if directory else path.is_file()
    except OSError:  # an impossible file name, such as one that is too long
        exists = False
    if not exists:
        message = f"names the {kind} '{text}', which does not exist"
        problems.append(Problem(str(settings), message, f"<{tag}>"))
    return path


#: Quantities of ``.osimx`` files: name in the file, and SI value of one unit of the file, by name in this
#: package.
OSIMX_QUANTITIES: Mapping[str, tuple[str, float]] = {
    "electromechanical_delay": ("electromechanical_delay", 0.1),
    "activation_time_constant": ("activation_time_constant", 0.01),
    "activation_nonlinearity": ("activation_nonlinearity_constant", 1.0),
    "emg_scale": ("emg_scale_factor", 1.0),
    "optimal_fiber_length": ("optimal_fiber_length", 1.0),
    "tendon_slack_length": ("tendon_slack_length", 1.0),
    "max_isometric_force": ("max_isometric_force", 1.0),
}
#: Version of the documents that are written.
_VERSION = "1.5.0"


@dataclass(frozen=True)
class OsimxMuscle:
    """Parameters of one muscle in an ``.osimx`` file.

    Parameters
    ----------
    name
        Name of the muscle.
    values
        Values in SI units by quantity (keys of `OSIMX_QUANTITIES`), without those that the file lacks.
    """

    name: str
    values: Mapping[str, float]


def read_osimx(path: str | Path) -> tuple[OsimxMuscle, ...]:
    """Read the muscles of an ``.osimx`` file; its other content is ignored.

    Raises
    ------
    InputError
        With all faults of the file.
    """
    path = Path(path)
    root = read_xml(path, ROOT)
    problems: list[Problem] = []
    muscles: dict[str, OsimxMuscle] = {}
    for element in root.iter("RCNLMuscle"):
        name = element.get("name", "").strip()
        if not name or name in muscles:
            found = "occurs a second time" if name else "has no name"
            problems.append(Problem(str(path), f"a muscle {found}", f"<RCNLMuscle> {name}".strip()))
            continue
        muscles[name] = OsimxMuscle(name, _read_values(element, name, path, problems))
    if problems:
        raise InputError(problems)
    return tuple(muscles.values())


def _read_values(element: Element, muscle: str, path: Path, problems: list[Problem]) -> dict[str, float]:
    values = {}
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
        values[name] = value * unit
    return values


def format_osimx(name: str, model_file: str, muscles: Sequence[OsimxMuscle], remark: str = "") -> str:
    """Format muscles as the text of an ``.osimx`` file.

    Parameters
    ----------
    name
        Name of the model.
    model_file
        Path of the model, relative to the folder of the ``.osimx`` file.
    muscles
        Muscles, in SI units.
    remark
        Comment at the top of the file; must not contain two successive hyphens.
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
