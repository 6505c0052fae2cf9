"""Whom a comparison calibrates, each once, and by which name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from wrapjax.errors import InputError, Problem
from wrapjax.subject import Subject, read_legs

_SIDES = {"l": "left", "r": "right"}


def persons_of(subjects: Sequence[Subject]) -> list[Subject]:
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


def labels_of(persons: Sequence[Subject]) -> tuple[str, ...]:
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
