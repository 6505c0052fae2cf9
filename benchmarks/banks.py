"""Cases of a blind bank, as those see it who answer them."""

from __future__ import annotations

from pathlib import Path

from wrapjax.errors import InputError, Problem


def cases_of(bank: Path, first: int | None = None) -> list[Path]:
    """Folders of a bank's cases in the order of their ids, which are hashes: all, or the first.

    Raises
    ------
    InputError
        If there are none.
    """
    folder = bank / "cases"
    cases = sorted(path.parent for path in folder.glob("*/subject.toml"))
    if not cases:
        raise InputError(
            Problem(
                str(folder), "no cases of a blind bank", hint="make them with python -m benchmarks.blind make"
            )
        )
    return [case.resolve() for case in cases[:first]]
