"""Settings of OpenSim's inverse kinematics tool: weights of markers and goals of coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.io.xml import read_xml


@dataclass(frozen=True)
class CoordinateGoal:
    """Value that a coordinate should be near.

    Parameters
    ----------
    weight
        Weight of the squared difference, m^2/rad^2 (1 for a translation), beside a weighted mean of squared
        marker distances.
    value
        Value, rad or m; None for the model's default.
    """

    weight: float
    value: float | None = None


@dataclass(frozen=True)
class KinematicsSettings:
    """Weights and goals of OpenSim's inverse kinematics tool.

    Parameters
    ----------
    weights
        Weight of each marker that has a task; 0 where the task is not applied.
    goals
        Goal of each coordinate that has a task.
    """

    weights: dict[str, float]
    goals: dict[str, CoordinateGoal]


def read_kinematics_settings(file: Path | str) -> KinematicsSettings:
    """Read the tasks of OpenSim's inverse kinematics tool from its settings, or a file of its tasks (.xml).

    Raises
    ------
    InputError
        If the file is not XML of OpenSim, has no tasks, a weight is not a number from 0, or a goal is to be
        read from a file.
    """
    file = Path(file)
    root = read_xml(file, "OpenSimDocument")
    problems: list[Problem] = []
    weights, goals = {}, {}
    for task in root.iter("IKMarkerTask"):
        weights[task.get("name", "")] = _weight(task, file, problems)
    for task in root.iter("IKCoordinateTask"):
        weight = _weight(task, file, problems)
        if weight > 0.0:
            goals[task.get("name", "")] = CoordinateGoal(weight, _value(task, file, problems))
    if not (weights or goals or problems):
        problems.append(Problem(str(file), "expected tasks of inverse kinematics, found none"))
    if problems:
        raise InputError(problems)
    return KinematicsSettings(weights, goals)


def _weight(task: Element, file: Path, problems: list[Problem]) -> float:
    if (task.findtext("apply") or "true").strip().lower() == "false":
        return 0.0
    text = (task.findtext("weight") or "1").strip()
    number = next(_numbers(text), np.nan)
    if not (np.isfinite(number) and number >= 0.0):
        problems.append(Problem(str(file), f"expected a weight from 0, found '{text}'", task.get("name", "")))
        return 0.0
    return number


def _value(task: Element, file: Path, problems: list[Problem]) -> float | None:
    kind = (task.findtext("value_type") or "default_value").strip()
    if kind == "default_value":
        return None
    text = (task.findtext("value") or "").strip()
    number = next(_numbers(text), np.nan)
    if kind != "manual_value" or not np.isfinite(number):
        message = f"expected default_value, or manual_value with a number, found {kind} '{text}'"
        problems.append(Problem(str(file), message, task.get("name", "")))
        return None
    return number


def _numbers(text: str) -> Iterator[float]:
    for word in text.split():
        try:
            yield float(word)
        except ValueError:
            return
