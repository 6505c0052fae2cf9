"""Whom a comparison calibrates, each once, and by which name.

What is compared, as numbers of legs, cycles or muscles, the same ones by every method.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.result import CalibrationResult
from wrapjax.comparison.statistics import MINIMUM_UNITS
from wrapjax.errors import InputError, Problem
from wrapjax.subject.subject import Subject, name_without_side, read_legs

if TYPE_CHECKING:
    from wrapjax.geometry.model_description import ModelDescription

_SIDES = {"l": "left", "r": "right"}


def subjects_to_calibrate(subjects: Sequence[Subject]) -> list[Subject]:
    """Leave out the legs that are calibrated with another's.

    Raises
    ------
    InputError
        If there is nobody.
    """
    if not subjects:
        raise InputError(Problem("subjects", "expected at least one, found none"))
    by_folder = {subject.folder.resolve(): subject for subject in subjects}
    taken: set[Path] = set()
    chosen = set()
    # Those first that name another leg: it may not name them.
    for folder, subject in sorted(by_folder.items(), key=lambda entry: entry[1].other_leg is None):
        if folder not in taken:
            chosen.add(folder)
            taken |= {leg.folder.resolve() for leg in read_legs(subject)}
    return [subject for folder, subject in by_folder.items() if folder in chosen]


def unique_labels(persons: Sequence[Subject]) -> tuple[str, ...]:
    """Name subjects so that they can be told apart, also as folders: by side where names are the same.

    Raises
    ------
    InputError
        If two have the same name and side.
    """
    names = [file_name(person.name) for person in persons]
    lowered = [name.lower() for name in names]
    labels = [
        f"{name}_{_SIDES[person.side]}" if lowered.count(name.lower()) > 1 else name
        for name, person in zip(names, persons, strict=True)
    ]
    first: dict[str, Subject] = {}
    problems = []
    for label, person in zip(labels, persons, strict=True):
        other = first.setdefault(label.lower(), person)
        if other is not person:
            message = f"has the name of {other.folder}, '{person.name}', and the same side"
            hint = "give each a [subject] name of its own"
            problems.append(Problem(str(person.folder / "subject.toml"), message, hint=hint))
    if problems:
        raise InputError(problems)
    return tuple(labels)


def file_name(name: str) -> str:
    """Turn a name into one that a folder can have anywhere."""
    return re.sub(r"[^\w.+-]+", "_", name).strip(".") or "subject"


#: Speeds that are told apart; where there are more, cycles of all speeds stand together.
MAX_SPEEDS = 4
ALL_SPEEDS = "all speeds"
#: The item that stands for the average over all others.
MEAN = "mean"


@dataclass(frozen=True)
class ComparedLeg:
    """A leg, calibrated by every method.

    Parameters
    ----------
    label
        Names it among the others.
    subject
        The leg.
    results, folders
        By method: what came of it, and the run's folder within that of the comparison.
    model
        What decides its muscle paths, where a method moved cylinders.
    geometry
        By method: where its paths are from, ``surrogate`` or ``engine``.
    """

    label: str
    subject: Subject
    results: dict[str, CalibrationResult]
    folders: dict[str, str]
    model: ModelDescription | None = None
    geometry: Mapping[str, str] = field(default_factory=dict)

    @property
    def recorded(self) -> CalibrationResult:
        """Any of the results, for what is the same by every method."""
        return next(iter(self.results.values()))


@dataclass(frozen=True)
class CycleGroup:
    """Cycles that are compared together: a label, and which ones they are of each leg."""

    label: str
    keep: tuple[Bool[np.ndarray, " trial"], ...]

    @property
    def count(self) -> int:
        """Number of cycles."""
        return sum(int(own.sum()) for own in self.keep)


#: Reads numbers by item (coordinate, muscle or parameter) off one leg's result, one a cycle or muscle.
QuantityReader = Callable[[CalibrationResult], dict[str, Float[np.ndarray, " own"]]]
#: By item, the same units in the same order by every method.
Samples = dict[str, Float[np.ndarray, "method unit"]]


def unit_of_analysis(legs: Sequence[ComparedLeg], within: str) -> str:
    """Say what counts as one observation: a leg where there are enough, else what is ``within`` legs."""
    return "leg" if len(legs) >= MINIMUM_UNITS else within


def collect_samples(
    legs: Sequence[ComparedLeg],
    methods: Sequence[str],
    read: QuantityReader,
    unit: str,
    kind: CycleGroup | None = None,
) -> Samples:
    """Read samples off all legs.

    Parameters
    ----------
    legs, methods
        What is compared.
    read
        What of a result.
    unit
        ``leg``: the average within each leg; otherwise what is read, legs one after the other.
    kind
        Which cycles, where cycles are read.

    Returns
    -------
    dict
        Items without a number are left out.
    """
    found: dict[str, list[np.ndarray]] = {}
    for number, leg in enumerate(legs):
        by_method = [read(leg.results[method]) for method in methods]
        for item in by_method[0]:
            block = np.stack([own[item] for own in by_method])
            if kind is not None:
                block = block[:, kind.keep[number]]
            if block.shape[1]:
                block = block.mean(axis=1, keepdims=True) if unit == "leg" else block
                found.setdefault(item, []).append(block)
    # Where legs differ in their items, the average still comes last.
    order = sorted(found, key=lambda item: item == MEAN)
    return {item: np.concatenate(found[item], axis=1) for item in order}


def all_cycles(legs: Sequence[ComparedLeg]) -> CycleGroup:
    """All cycles of all legs."""
    return CycleGroup(ALL_SPEEDS, tuple(np.ones(len(leg.recorded.trials), dtype=bool) for leg in legs))


def group_by_speed(legs: Sequence[ComparedLeg], use: str) -> list[CycleGroup]:
    """Sort cycles of one use by walking speed, and give all together last; kinds without cycles are left out.

    Where legs walked at different speeds, but at equally many, they are ranked within each leg, as
    "self-selected" and "fastest" are.
    """
    speeds = [np.unique(leg.recorded.speeds) for leg in legs]  # NaNs count as one, the last
    count = len(speeds[0])
    everything = CycleGroup(ALL_SPEEDS, tuple(np.array(leg.recorded.uses) == use for leg in legs))
    if any(len(own) != count for own in speeds) or not 2 <= count <= MAX_SPEEDS:
        return [everything]
    if all(np.array_equal(own, speeds[0], equal_nan=True) for own in speeds):
        labels = ["speed not given" if np.isnan(speed) else f"{speed:g} m/s" for speed in speeds[0]]
    elif np.isnan(speeds).any():
        return [everything]
    else:
        labels = [f"speed {rank} of {count}" for rank in range(1, count + 1)]
    kinds = []
    for rank, label in enumerate(labels):
        keep = [
            np.isnan(leg.recorded.speeds) if np.isnan(own[rank]) else leg.recorded.speeds == own[rank]
            for leg, own in zip(legs, speeds, strict=True)
        ]
        kinds.append(
            CycleGroup(label, tuple(own & of_use for own, of_use in zip(keep, everything.keep, strict=True)))
        )
    walked = [kind for kind in kinds if kind.count]
    return [*(walked if len(walked) > 1 else []), everything]


# ---- What is read


def moment_errors(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Mean absolute moment error of each cycle in N m, by coordinate."""
    errors = np.abs(result.modelled - result.measured).mean(axis=-1)
    return _with_mean(result.coordinates, errors.T)


def length_changes(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Mean absolute change of muscle-tendon lengths in m, by coordinate over the muscles that span it."""
    before, after = result.initial_states.path.length, result.states.path.length
    changes = np.abs(np.asarray(after) - np.asarray(before)).mean(axis=-1)
    found = {
        name_without_side(coordinate): changes[own].mean(axis=0)
        for coordinate, own in zip(result.coordinates, _spanning(result).T, strict=True)
        if own.any()
    }
    return found | {MEAN: changes.mean(axis=0)}


def moment_arm_changes(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Mean absolute change of moment arms in m, by coordinate over the muscles that span it."""
    before, after = result.initial_states.path.moment_arm, result.states.path.moment_arm
    changes = np.abs(np.asarray(after) - np.asarray(before)).mean(axis=-1)
    spanning = _spanning(result)
    found = {
        name_without_side(coordinate): changes[own, :, place].mean(axis=0)
        for place, (coordinate, own) in enumerate(zip(result.coordinates, spanning.T, strict=True))
        if own.any()
    }
    return found | {MEAN: changes.transpose(0, 2, 1)[spanning].mean(axis=0)}


def muscle_forces(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Mean tendon force of each cycle in N, by muscle."""
    return _with_mean(result.muscles, np.asarray(result.states.fiber.tendon_force).mean(axis=-1))


def activations(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Mean activation of each cycle, by muscle."""
    return _with_mean(result.muscles, np.asarray(result.states.activation).mean(axis=-1))


def parameter(name: str) -> QuantityReader:
    """Values of one parameter of all muscles."""

    def read(result: CalibrationResult) -> dict[str, Float[np.ndarray, " muscle"]]:
        return {name: np.asarray(getattr(result.parameters, name))}

    return read


def freed_parameters(legs: Sequence[ComparedLeg]) -> list[str]:
    """Name the parameters that any method freed."""
    names = [own.name for leg in legs for result in leg.results.values() for own in result.freedom.parameters]
    return list(dict.fromkeys(names))


def _with_mean(
    names: Sequence[str], values: Float[np.ndarray, "item trial"]
) -> dict[str, Float[np.ndarray, " trial"]]:
    items = map(name_without_side, names)
    return dict(zip(items, values, strict=True)) | {MEAN: values.mean(axis=0)}


def _spanning(result: CalibrationResult) -> Bool[np.ndarray, "muscle coordinate"]:
    return (np.asarray(result.initial_states.path.moment_arm) != 0.0).any(axis=(1, 3))
