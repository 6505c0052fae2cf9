"""Subjects and samples of a comparison: which legs are calibrated, and which quantities are compared.

A sample has one value for each leg, gait cycle or muscle, the same ones for every method.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.comparison.statistics import MINIMUM_UNITS
from wrapjax.errors import InputError, Problem
from wrapjax.subject.subject import Subject, name_without_side, read_legs

if TYPE_CHECKING:
    from wrapjax.geometry.skeleton.model_description import ModelDescription

_SIDES = {"l": "left", "r": "right"}


def subjects_to_calibrate(subjects: Sequence[Subject]) -> list[Subject]:
    """Select the subjects to calibrate: each leg once, without those calibrated as another's other leg.

    Raises
    ------
    InputError
        If there are no subjects.
    """
    if not subjects:
        raise InputError(Problem("subjects", "expected at least one, found none"))
    by_folder = {subject.folder.resolve(): subject for subject in subjects}
    calibrated: set[Path] = set()
    chosen = set()
    # Subjects that name another leg come first, because that leg need not name them.
    for folder, subject in sorted(by_folder.items(), key=lambda entry: entry[1].other_leg is None):
        if folder not in calibrated:
            chosen.add(folder)
            calibrated |= {leg.folder.resolve() for leg in read_legs(subject)}
    return [subject for folder, subject in by_folder.items() if folder in chosen]


def unique_labels(persons: Sequence[Subject]) -> tuple[str, ...]:
    """Make unique labels of subjects, valid as folder names; the side is added where names are the same.

    Raises
    ------
    InputError
        If two subjects have the same name and side.
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
    """Make a folder name that is valid on all systems."""
    return re.sub(r"[^\w.+-]+", "_", name).strip(".") or "subject"


#: Largest number of speeds that are compared separately; with more, cycles of all speeds are pooled.
MAX_SPEEDS = 4
ALL_SPEEDS = "all speeds"
#: Item of the average over all other items.
MEAN = "mean"


@dataclass(frozen=True)
class ComparedLeg:
    """Leg that was calibrated by all methods.

    Parameters
    ----------
    label
        Unique name of the leg.
    subject
        Subject folder of the leg.
    results
        Results by method.
    folders
        Folders of the runs by method, relative to that of the comparison.
    model
        Model of the leg, where a method changed wrapping cylinders; else None.
    geometry
        Source of the muscle paths by method, ``surrogate`` or ``engine``.
    """

    label: str
    subject: Subject
    results: dict[str, CalibrationResult]
    folders: dict[str, str]
    model: ModelDescription | None = None
    geometry: Mapping[str, str] = field(default_factory=dict)

    @property
    def recorded(self) -> CalibrationResult:
        """One of the results, for data that are the same for all methods."""
        return next(iter(self.results.values()))


@dataclass(frozen=True)
class CycleGroup:
    """Gait cycles that are compared together.

    Parameters
    ----------
    label
        Name of the group.
    keep
        Mask of the group's cycles among all cycles, by leg.
    """

    label: str
    keep: tuple[Bool[np.ndarray, " trial"], ...]

    @property
    def count(self) -> int:
        """Number of cycles."""
        return sum(int(mask.sum()) for mask in self.keep)


#: Function that reads a quantity from a leg's result: values by item (coordinate, muscle or parameter), one
#: for each cycle or muscle.
QuantityReader = Callable[[CalibrationResult], dict[str, Float[np.ndarray, " unit"]]]
#: Samples by item; units are the same and in the same order for all methods.
Samples = dict[str, Float[np.ndarray, "method unit"]]


def unit_of_analysis(legs: Sequence[ComparedLeg], within: str) -> str:
    """Return the unit of analysis: ``leg`` if there are enough legs, else the unit ``within`` legs."""
    return "leg" if len(legs) >= MINIMUM_UNITS else within


def collect_samples(
    legs: Sequence[ComparedLeg],
    methods: Sequence[str],
    read: QuantityReader,
    unit: str,
    group: CycleGroup | None = None,
) -> Samples:
    """Collect the samples of a quantity from all legs.

    Parameters
    ----------
    legs, methods
        Legs and methods to compare.
    read
        Function that reads the quantity from a result.
    unit
        Unit of analysis: ``leg`` for averages within legs; otherwise values are concatenated over legs.
    group
        Group of cycles, for quantities with one value per cycle; None for all values.

    Returns
    -------
    dict
        Samples by item; items without values are left out.
    """
    blocks: dict[str, list[np.ndarray]] = {}
    for number, leg in enumerate(legs):
        by_method = [read(leg.results[method]) for method in methods]
        for item in by_method[0]:
            block = np.stack([values[item] for values in by_method])
            if group is not None:
                block = block[:, group.keep[number]]
            if block.shape[1]:
                block = block.mean(axis=1, keepdims=True) if unit == "leg" else block
                blocks.setdefault(item, []).append(block)
    # The average comes last, even where legs differ in their items.
    order = sorted(blocks, key=lambda item: item == MEAN)
    return {item: np.concatenate(blocks[item], axis=1) for item in order}


def all_cycles(legs: Sequence[ComparedLeg]) -> CycleGroup:
    """Return the group of all cycles of all legs."""
    return CycleGroup(ALL_SPEEDS, tuple(np.ones(len(leg.recorded.trials), dtype=bool) for leg in legs))


def group_by_speed(legs: Sequence[ComparedLeg], use: str) -> list[CycleGroup]:
    """Group the cycles of one use by walking speed; the last group contains all of them.

    If legs walked at different speeds, but at equally many, the speeds are ranked within each leg, such as
    "self-selected" and "fastest". Groups without cycles are left out.
    """
    speeds = [np.unique(leg.recorded.speeds) for leg in legs]  # NaNs are one value, the last.
    count = len(speeds[0])
    everything = CycleGroup(ALL_SPEEDS, tuple(np.array(leg.recorded.uses) == use for leg in legs))
    if any(len(leg_speeds) != count for leg_speeds in speeds) or not 2 <= count <= MAX_SPEEDS:
        return [everything]
    if all(np.array_equal(leg_speeds, speeds[0], equal_nan=True) for leg_speeds in speeds):
        labels = ["speed not given" if np.isnan(speed) else f"{speed:g} m/s" for speed in speeds[0]]
    elif np.isnan(speeds).any():
        return [everything]
    else:
        labels = [f"speed {rank} of {count}" for rank in range(1, count + 1)]
    groups = []
    for rank, label in enumerate(labels):
        keep = [
            np.isnan(leg.recorded.speeds)
            if np.isnan(leg_speeds[rank])
            else leg.recorded.speeds == leg_speeds[rank]
            for leg, leg_speeds in zip(legs, speeds, strict=True)
        ]
        groups.append(
            CycleGroup(
                label, tuple(mask & of_use for mask, of_use in zip(keep, everything.keep, strict=True))
            )
        )
    groups = [group for group in groups if group.count]
    return [*(groups if len(groups) > 1 else []), everything]


# ---- Quantities


def moment_errors(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Compute the mean absolute moment error of each cycle (N m), by coordinate."""
    errors = np.abs(result.modelled - result.measured).mean(axis=-1)
    return _with_mean(result.coordinates, errors.T)


def length_changes(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Compute the mean absolute change of muscle-tendon lengths (m), over the muscles of each coordinate."""
    before, after = result.initial_states.path.length, result.states.path.length
    changes = np.abs(np.asarray(after) - np.asarray(before)).mean(axis=-1)
    found = {
        name_without_side(coordinate): changes[spans].mean(axis=0)
        for coordinate, spans in zip(result.coordinates, _spanning(result).T, strict=True)
        if spans.any()
    }
    return found | {MEAN: changes.mean(axis=0)}


def moment_arm_changes(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Compute the mean absolute change of moment arms (m), over the muscles of each coordinate."""
    before, after = result.initial_states.path.moment_arm, result.states.path.moment_arm
    changes = np.abs(np.asarray(after) - np.asarray(before)).mean(axis=-1)
    spanning = _spanning(result)
    found = {
        name_without_side(coordinate): changes[spans, :, column].mean(axis=0)
        for column, (coordinate, spans) in enumerate(zip(result.coordinates, spanning.T, strict=True))
        if spans.any()
    }
    return found | {MEAN: changes.transpose(0, 2, 1)[spanning].mean(axis=0)}


def muscle_forces(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Compute the mean tendon force of each cycle (N), by muscle."""
    return _with_mean(result.muscles, np.asarray(result.states.fiber.tendon_force).mean(axis=-1))


def activations(result: CalibrationResult) -> dict[str, Float[np.ndarray, " trial"]]:
    """Compute the mean activation of each cycle, by muscle."""
    return _with_mean(result.muscles, np.asarray(result.states.activation).mean(axis=-1))


def parameter(name: str) -> QuantityReader:
    """Return a function that reads the values of a parameter of all muscles."""

    def read(result: CalibrationResult) -> dict[str, Float[np.ndarray, " muscle"]]:
        return {name: np.asarray(getattr(result.parameters, name))}

    return read


def freed_parameters(legs: Sequence[ComparedLeg]) -> list[str]:
    """List the parameters that any method freed."""
    names = [
        entry.name for leg in legs for result in leg.results.values() for entry in result.freedom.parameters
    ]
    return list(dict.fromkeys(names))


def _with_mean(
    names: Sequence[str], values: Float[np.ndarray, "item trial"]
) -> dict[str, Float[np.ndarray, " trial"]]:
    items = map(name_without_side, names)
    return dict(zip(items, values, strict=True)) | {MEAN: values.mean(axis=0)}


def _spanning(result: CalibrationResult) -> Bool[np.ndarray, "muscle coordinate"]:
    """Mask of the coordinates that each muscle spans: those with a moment arm."""
    return (np.asarray(result.initial_states.path.moment_arm) != 0.0).any(axis=(1, 3))
