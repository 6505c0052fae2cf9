"""Both legs of a person: the folders of two subjects that belong together."""

from __future__ import annotations

import re
from dataclasses import replace

from wrapjax.errors import InputError, Problem
from wrapjax.subject.folder import Subject, read_subject
from wrapjax.subject.settings import SETTINGS_FILE

_PLACE = "[subject] other_leg"


def name_without_side(name: str) -> str:
    """Name a muscle as both legs do: ``soleus_l`` and ``soleus_r`` are ``soleus``."""
    return re.sub(r"_[lr]$", "", name)


def read_legs(subject: Subject) -> tuple[Subject, ...]:
    """Gather the legs that are calibrated together: the subject, and its other leg if it names one.

    Returns
    -------
    tuple of Subject
        One, or two that name each other, whether or not the other leg's folder points back.

    Raises
    ------
    InputError
        With everything wrong in the other leg's folder, or between the two.
    """
    if subject.other_leg is None:
        return (subject,)
    other = read_subject(subject.other_leg)
    file, other_file = (str(leg.folder / SETTINGS_FILE) for leg in (subject, other))
    problems = []
    if other.side == subject.side:
        message = f"expected the other leg, found one of the same side '{other.side}' in {other.folder}"
        problems.append(Problem(file, message, _PLACE))
    elif not _shared(subject) & _shared(other):
        message = f"no driven muscle of {other.folder} has a namesake here: the legs would share nothing"
        problems.append(Problem(file, message, _PLACE, "namesakes differ in '_l' and '_r' only"))
    if other.other_leg is not None and other.other_leg.resolve() != subject.folder.resolve():
        message = f"expected {subject.folder}, whose other leg this is, or nothing; found {other.other_leg}"
        problems.append(Problem(other_file, message, _PLACE))
    if problems:
        raise InputError(problems)
    return subject, replace(other, other_leg=subject.folder)


def _shared(subject: Subject) -> set[str]:
    return set(map(name_without_side, subject.muscles.names))
