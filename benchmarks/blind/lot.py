"""Which of a bank's cases: ids are hashes, so that to go by their order is to draw by lot."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Lot:
    """So many cases (None: all) whose ids come after one, in their order.

    Named by an id and not by a count, it is the same whether all cases of a bank are there or the lot alone.
    """

    first: int | None = None
    after: str = ""

    def of(self, ids: Iterable[str]) -> list[str]:
        """Draw, sorted."""
        return sorted(id for id in ids if id > self.after)[: self.first]


ALL_CASES = Lot()


def add_lot(parser: argparse.ArgumentParser) -> None:
    """Add ``--first`` and ``--after``."""
    parser.add_argument("--first", type=_count, metavar="N", help="only the first N cases by their ids")
    parser.add_argument("--after", metavar="ID", default="", help="only cases whose ids come after this one")


def lot_of(chosen: argparse.Namespace) -> Lot:
    """Read what `add_lot` added."""
    return Lot(chosen.first, chosen.after)


def _count(word: str) -> int:
    count = int(word)
    if count < 1:
        raise argparse.ArgumentTypeError(f"expected 1 or more, not {word}")
    return count
