"""Selection of a bank's cases by the order of their ids, which are hashes and so in random order."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class CaseSelection:
    """The first cases by id (None: all) after a given id, without some.

    It starts after an id and not after a count, so that it is the same whether all cases of a bank are
    present or only the selected ones.
    """

    first: int | None = None
    after: str = ""
    #: Cases that differed from the manifest when they were made again on another machine.
    left_out: tuple[str, ...] = ()

    def select(self, ids: Iterable[str]) -> list[str]:
        """Select from ids; sorted."""
        selected = sorted(id for id in ids if id > self.after)[: self.first]
        return [id for id in selected if id not in self.left_out]


ALL_CASES = CaseSelection()


def add_selection_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--first``, ``--after`` and ``--leave-out``."""
    parser.add_argument("--first", type=_count, metavar="N", help="only the first N cases by their ids")
    parser.add_argument("--after", metavar="ID", default="", help="only cases whose ids come after this one")
    parser.add_argument(
        "--leave-out",
        metavar="ID",
        action="append",
        default=[],
        help="case to leave out, as it is known to differ from the manifest",
    )


def selection_of(chosen: argparse.Namespace) -> CaseSelection:
    """Build the selection from parsed arguments."""
    return CaseSelection(chosen.first, chosen.after, tuple(chosen.leave_out))


def _count(word: str) -> int:
    count = int(word)
    if count < 1:
        raise argparse.ArgumentTypeError(f"expected 1 or more, not {word}")
    return count
