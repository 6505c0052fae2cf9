"""What is wrong with the input, said so that a person can mend it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

#: A file's name in a sentence may have this many letters, each other part half as many.
MOST_LETTERS = 2000
#: Names longer than this are near no other.
_LONGEST_NAME = 200


@dataclass(frozen=True)
class Problem:
    """One thing wrong with one place of the input.

    Parameters
    ----------
    file
        The file (or folder) as the user knows it.
    message
        One sentence without a full stop: what was expected and what was found.
    place
        The column, key, row or muscle inside the file; empty if it is the file itself.
    hint
        What would mend it, if that is known.
    """

    file: str
    message: str
    place: str = ""
    hint: str = ""

    def __str__(self) -> str:
        place, message, hint = (_quoted(part) for part in (self.place, self.message, self.hint))
        where = f"{_quoted(self.file, MOST_LETTERS)}: {place}" if place else _quoted(self.file, MOST_LETTERS)
        tail = f"; {hint}" if hint else ""
        sentence = f"{where}: {message}{tail}"
        return sentence if sentence.endswith(("?", "...")) else f"{sentence}."


def _quoted(text: str, most: int = MOST_LETTERS // 2) -> str:
    """Make what files hold fit for a line on a terminal: no letters that steer it, and not too many."""
    shown = text if text.isprintable() else "".join(map(_printable, text))
    return shown if len(shown) <= most else f"{shown[: most // 2]} ... {shown[-most // 2 :]}"


def _printable(letter: str) -> str:
    return letter if letter.isprintable() else letter.encode("unicode_escape", "replace").decode()


class InputError(ValueError):
    """The input cannot be used. Carries every problem found, not only the first.

    The command line prints one line a problem and exits with 2.
    """

    def __init__(self, problems: Problem | Iterable[Problem]):
        if isinstance(problems, Problem):
            problems = (problems,)
        self.problems: tuple[Problem, ...] = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[type[InputError], tuple[tuple[Problem, ...]]]:
        # What is raised in a worker process must arrive whole.
        return InputError, (self.problems,)


class WorkError(RuntimeError):
    """The work could not be done, and the input is not to blame: a sentence without a full stop.

    The command line prints it and exits with 1.
    """


def nearest_name(name: str, known: Sequence[str]) -> str:
    """Say which known name the unknown one was probably meant to be.

    Returns ``"did you mean 'soleus_l'?"``, or the (first few) known names where none is near.
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
