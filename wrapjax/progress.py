"""Progress of long computations on standard error, and the time that their steps take."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

#: Function that takes the number of finished items.
Advance = Callable[[int], None]


@contextmanager
def progress_bar(title: str, total: int, *, quiet: bool = False) -> Iterator[Advance]:
    """Show the progress of a loop: a bar on a terminal, plain lines elsewhere.

    Parameters
    ----------
    title
        Description of the computation, a few words.
    total
        Number of items.
    quiet
        Print nothing.

    Yields
    ------
    Advance
        Function to call with the number of items finished so far.
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
        # A line every ten seconds, not one for each item, keeps log files short.
        if now - last >= 10.0:
            last = now
            print(f"{title}: {done} of {total}, {now - started:.0f} s", file=sys.stderr, flush=True)

    yield line
    print(f"{title}: {total} done in {time.monotonic() - started:.1f} s", file=sys.stderr, flush=True)


def print_progress(line: str, *, quiet: bool = False) -> None:
    """Print one line of progress to standard error, unless ``quiet``."""
    if not quiet:
        print(line, file=sys.stderr, flush=True)


@dataclass
class Stopwatch:
    """Wall time by step of a computation, with a log line at the start of each step.

    Parameters
    ----------
    log
        Function that takes a line of progress.
    seconds
        Time of each step so far, s, by the step's name.
    """

    log: Callable[[str], None]
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def during(self, part: str, line: str) -> Iterator[None]:
        """Log a line, and add the time of the ``with`` block to the step ``part``."""
        self.log(line)
        began = time.perf_counter()
        yield
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began
