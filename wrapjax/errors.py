"""Errors of input files and options: file, place, what was expected, what was found, and a hint."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

#: Longest file name in a message, in characters; every other part may have half as many.
MAX_MESSAGE_LENGTH = 2000
#: Longer names are not compared by `nearest_name`, which takes time with the square of the length.
_LONGEST_NAME = 200


@dataclass(frozen=True)
class Problem:
    """One problem at one place of the input.

    Parameters
    ----------
    file
        File, folder or option, as the user gave it.
    message
        What was expected and what was found, without a full stop.
    place
        Column, key, row or muscle within the file; empty for the file itself.
    hint
        How to correct it, where known.
    """

    file: str
    message: str
    place: str = ""
    hint: str = ""

    def __str__(self) -> str:
        place, message, hint = (_quoted(part) for part in (self.place, self.message, self.hint))
        where = (
            f"{_quoted(self.file, MAX_MESSAGE_LENGTH)}: {place}"
            if place
            else _quoted(self.file, MAX_MESSAGE_LENGTH)
        )
        tail = f"; {hint}" if hint else ""
        sentence = f"{where}: {message}{tail}"
        return sentence if sentence.endswith(("?", "...")) else f"{sentence}."


def _quoted(text: str, most: int = MAX_MESSAGE_LENGTH // 2) -> str:
    """Escape control characters and shorten text from files, so that it fits on a terminal line."""
    shown = text if text.isprintable() else "".join(map(_printable, text))
    return shown if len(shown) <= most else f"{shown[: most // 2]} ... {shown[-most // 2 :]}"


def _printable(letter: str) -> str:
    return letter if letter.isprintable() else letter.encode("unicode_escape", "replace").decode()


class InputError(ValueError):
    """Invalid input, with all problems found.

    The command line prints one line for each problem and exits with status 2.

    Parameters
    ----------
    problems
        One or more problems.
    """

    def __init__(self, problems: Problem | Iterable[Problem]):
        if isinstance(problems, Problem):
            problems = (problems,)
        self.problems: tuple[Problem, ...] = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[type[InputError], tuple[tuple[Problem, ...]]]:
        # Exceptions from worker processes are pickled; the default would pass the message as `problems`.
        return InputError, (self.problems,)


class ComputationError(RuntimeError):
    """Failure of a computation on valid input; its message has no full stop.

    The command line prints the message and exits with status 1.
    """


def nearest_name(name: str, known: Sequence[str]) -> str:
    """Suggest the known name that is most similar to an unknown one.

    Parameters
    ----------
    name
        Unknown name.
    known
        Valid names.

    Returns
    -------
    str
        ``"did you mean 'soleus_l'?"``, or the first eight valid names if none is similar.
    """
    lowered = {entry.lower(): entry for entry in known if len(entry) <= _LONGEST_NAME}
    close = []
    if len(name) <= _LONGEST_NAME:
        close = difflib.get_close_matches(name.lower(), list(lowered), n=1, cutoff=0.6)
    if close:
        return f"did you mean '{lowered[close[0]]}'?"
    if not known:
        return "none are known"
    listed = ", ".join(known[:8])
    return f"known: {listed}" + (", ..." if len(known) > 8 else "")
