"""What is wrong with the input, said so that a person can mend it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


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
        where = f"{self.file}: {self.place}" if self.place else self.file
        tail = f"; {self.hint}" if self.hint else ""
        sentence = f"{where}: {self.message}{tail}"
        return sentence if sentence.endswith("?") else f"{sentence}."


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


def nearest_name(name: str, known: Sequence[str]) -> str:
    """Say which known name the unknown one was probably meant to be.

    Returns ``"did you mean 'soleus_l'?"``, or the (first few) known names where none is near.
    """
    lowered = {entry.lower(): entry for entry in known}
    close = difflib.get_close_matches(name.lower(), list(lowered), n=1, cutoff=0.6)
    if close:
        return f"did you mean '{lowered[close[0]]}'?"
    if not known:
        return "none are known"
    listed = ", ".join(known[:8])
    return f"known: {listed}" + (", ..." if len(known) > 8 else "")
