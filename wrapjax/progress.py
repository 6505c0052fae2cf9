"""Progress of long work: a bar on a terminal, plain lines elsewhere, always on standard error.

What takes how long.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

#: Called with the number of finished pieces of work.
Advance = Callable[[int], None]


@contextmanager
def progress_bar(title: str, total: int, *, quiet: bool = False) -> Iterator[Advance]:
    """Yield a function to call with the count of pieces finished so far.

    Parameters
    ----------
    title
        What is being done, in a few words.
    total
        Number of pieces in all.
    quiet
        Print nothing.
    """
    if quiet:
        yield lambda done: None
        return
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task(title, total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    started = last = time.monotonic()

    def line(done: int) -> None:
        nonlocal last
        now = time.monotonic()
        # A log gets a line every ten seconds, not one a piece.
        if now - last >= 10.0:
            last = now
            print(f"{title}: {done} of {total}, {now - started:.0f} s", file=sys.stderr, flush=True)

    yield line
    print(f"{title}: {total} done in {time.monotonic() - started:.1f} s", file=sys.stderr, flush=True)


def say(line: str, *, quiet: bool = False) -> None:
    """Print one line of progress to standard error."""
    if not quiet:
        print(line, file=sys.stderr, flush=True)


@dataclass
class Stopwatch:
    """Says what is going on, and how long it took."""

    log: Callable[[str], None]
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def during(self, part: str, line: str) -> Iterator[None]:
        """Add the time of what is done within to a part of the work."""
        self.log(line)
        began = time.perf_counter()
        yield
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began
