"""Checks of recorded markers against a model: size, sides, and whether files are of one person."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.preprocessing.files.markers import Markers

#: Ratio of recorded to modelled distances between markers of a body beyond which the unit must be wrong.
MAX_SIZE_RATIO = 3.0
#: Markers closer than this in the model say little about size, m.
MIN_DISTANCE = 0.04
#: Sides are taken to be exchanged if exchanging them divides the cost of a pose by this factor.
SIDES_RATIO = 4.0
#: Root mean square distance of markers below which sides are not doubted, m.
SIDES_DISTANCE = 0.03
#: Difference of the same distance in two files, m and as a share, above which they are of two people.
PERSON_DISTANCE, PERSON_SHARE = 0.025, 0.1
#: Endings and beginnings of names that tell sides.
_SIDES = (
    (re.compile(r"^r(?=[._\- ]|[A-Z])"), re.compile(r"^l(?=[._\- ]|[A-Z])")),
    (re.compile(r"^R(?=[._\- ]|[A-Z])"), re.compile(r"^L(?=[._\- ]|[A-Z])")),
    (re.compile(r"(?<=[._\- ])r$"), re.compile(r"(?<=[._\- ])l$")),
    (re.compile(r"(?<=[._\- ])R$"), re.compile(r"(?<=[._\- ])L$")),
    (re.compile(r"right"), re.compile(r"left")),
    (re.compile(r"Right"), re.compile(r"Left")),
)
_LETTERS = (("r", "l"), ("R", "L"), ("r", "l"), ("R", "L"), ("right", "left"), ("Right", "Left"))


def check_size(description: ModelDescription, recorded: Markers, file: Path) -> None:
    """Check that the distances between markers of a body are those of the model within a factor of three.

    Raises
    ------
    InputError
        If the median ratio of recorded to modelled distances is beyond that, as with a wrong unit of length.
    """
    by_name = {marker.name: marker for marker in description.markers}
    ratios = []
    for (first, second), found in _distances(description, recorded).items():
        expected = np.subtract(by_name[first].location, by_name[second].location)
        distance = float(np.linalg.norm(expected))
        if distance >= MIN_DISTANCE:
            ratios.append(found / distance)
    if not ratios:
        return
    ratio = float(np.median(ratios))
    if not 1.0 / MAX_SIZE_RATIO <= ratio <= MAX_SIZE_RATIO:
        message = (
            f"expected distances between the markers of a body about as in the model, found {ratio:.3g} times"
        )
        hint = "is the unit of length stated in the file that of its numbers?"
        raise InputError(Problem(str(file), message, "Units", hint))


def exchanged_sides(names: tuple[str, ...]) -> Int[np.ndarray, " marker"] | None:
    """Order of the markers with left and right exchanged; None if the names tell no sides."""
    order = np.arange(len(names))
    for place, name in enumerate(names):
        other = other_side(name)
        if other in names:
            order[place] = names.index(other)
    return None if (order == np.arange(len(names))).all() else order


def other_side(name: str) -> str:
    """Name with left and right exchanged; the name itself if it tells no side."""
    for patterns, letters in zip(_SIDES, _LETTERS, strict=True):
        for pattern, letter in zip(patterns, reversed(letters), strict=True):
            if pattern.search(name):
                return pattern.sub(letter, name, count=1)
    return name


def check_exchanged_sides(cost: float, exchanged: float, file: Path) -> None:
    """Check that the markers do not fit far better with left and right exchanged.

    Parameters
    ----------
    cost, exchanged
        Mean squared distance of the markers as named, and with sides exchanged, m^2.
    file
        File of the markers.

    Raises
    ------
    InputError
        If they do.
    """
    if cost > SIDES_DISTANCE**2 and SIDES_RATIO * exchanged < cost:
        message = (
            f"expected markers that fit the model, found them {1e3 * cost**0.5:.0f} mm away as named, and "
            f"{1e3 * exchanged**0.5:.0f} mm with left and right exchanged"
        )
        raise InputError(Problem(str(file), message, hint="are left and right exchanged in the names?"))


def check_one_person(description: ModelDescription, recordings: Mapping[Path, Markers]) -> None:
    """Check that distances between markers of a body agree between files.

    Raises
    ------
    InputError
        With a sentence for each file whose distances differ from those of the first file.
    """
    tables = {file: _distances(description, markers) for file, markers in recordings.items()}
    raise_if(_two_people(tables))


def _two_people(tables: Mapping[Path, Mapping[tuple[str, str], float]]) -> Iterator[Problem]:
    (reference, expected), *others = tables.items()
    for file, found in others:
        common = [pair for pair in expected if pair in found]
        differences = {
            pair: found[pair] - expected[pair]
            for pair in common
            if abs(found[pair] - expected[pair]) > max(PERSON_DISTANCE, PERSON_SHARE * expected[pair])
        }
        # A single marker may have been placed anew between trials.
        if len(common) >= 3 and len(differences) > 0.5 * len(common):
            pair = max(differences, key=lambda key: abs(differences[key]))
            message = (
                f"expected the person of {reference}, found other distances between {len(differences)} of "
                f"{len(common)} pairs of markers on a body, as {pair[0]} to {pair[1]} "
                f"{1e3 * found[pair]:.0f} mm instead of {1e3 * expected[pair]:.0f} mm"
            )
            yield Problem(str(file), message, hint="are these files of two people?")


def raise_if(problems: Iterator[Problem]) -> None:
    """Raise `InputError` if there are problems."""
    found = tuple(problems)
    if found:
        raise InputError(found)


def _distances(description: ModelDescription, recorded: Markers) -> dict[tuple[str, str], float]:
    """Median distance of each pair of recorded markers on the same body, m."""
    bodies = {marker.name: marker.body for marker in description.markers}
    paths: dict[str, Float[np.ndarray, "frame 3"]] = dict(
        zip(recorded.names, recorded.positions, strict=True)
    )
    pairs = [
        pair for pair in combinations(sorted(paths), 2) if bodies.get(pair[0], "") == bodies.get(pair[1])
    ]
    distances = {pair: np.linalg.norm(paths[pair[0]] - paths[pair[1]], axis=-1) for pair in pairs}
    return {
        pair: float(np.nanmedian(values)) for pair, values in distances.items() if np.isfinite(values).any()
    }
