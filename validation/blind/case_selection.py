"""Which of a bank's cases: ids are hashes, so that to go by their order is to draw by lot."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Lot:
    """So many cases (None: all) whose ids come after one, in their order, but for some.

    Named by an id and not by a count, it is the same whether all cases of a bank are there or the lot alone.
    """

    first: int | None = None
    after: str = ""
    #: Made again, on another machine, these were not byte for byte what was sealed.
    left_out: tuple[str, ...] = ()

    def of(self, ids: Iterable[str]) -> list[str]:
        """Draw, sorted."""
        drawn = sorted(id for id in ids if id > self.after)[: self.first]
        return [id for id in drawn if id not in self.left_out]


ALL_CASES = Lot()


def add_lot(parser: argparse.ArgumentParser) -> None:
    """Add ``--first``, ``--after`` and ``--leave-out``."""
    parser.add_argument("--first", type=_count, metavar="N", help="only the first N cases by their ids")
    parser.add_argument("--after", metavar="ID", default="", help="only cases whose ids come after this one")
    parser.add_argument(
        "--leave-out",
        metavar="ID",
        action="append",
        default=[],
        help="a case whose seal is known to be broken",
    )


def lot_of(chosen: argparse.Namespace) -> Lot:
    """Read what `add_lot` added."""
    return Lot(chosen.first, chosen.after, tuple(chosen.leave_out))


def _count(word: str) -> int:
    count = int(word)
    if count < 1:
        raise argparse.ArgumentTypeError(f"expected 1 or more, not {word}")
    return count
