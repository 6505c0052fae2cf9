"""Settings of the NMSM Pipeline's muscle-tendon personalisation: what of them says what was recorded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from wrapjax.errors import InputError, Problem
from wrapjax.subject.model_file import read_xml

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
