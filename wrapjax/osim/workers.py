"""Share chunks of poses among this process and, where it pays, several others."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from wrapjax.errors import WorkError
from wrapjax.osim.path_engine import PathEngine, WrapParameters

#: Starting workers, each of which imports OpenSim and loads the model, costs a few seconds.
POOL_PAYS_AFTER_S = 6.0
#: More workers than this gain little and hold a model each.
MOST_WORKERS = 8

Poses = Float[np.ndarray, "pose coordinate"]
#: With an axis ``placement`` in front where cylinders are placed.
Lengths = Float[np.ndarray, "*placement pose muscle"]
MomentArms = Float[np.ndarray, "*placement pose coordinate muscle"]


class Placed(NamedTuple):
    """Poses to analyse once for each placement of cylinders."""

    placements: tuple[Mapping[str, WrapParameters], ...]
    poses: Poses


#: What is analysed at a time.
Chunk = Poses | Placed

_engine: PathEngine | None = None


def analyse_chunks(
    model_file: Path | str,
    coordinates: Sequence[str],
    spans: dict[str, tuple[str, ...]],
    chunks: Mapping[int, Chunk],
    processes: int | None,
) -> Generator[tuple[int, Lengths, MomentArms], None, None]:
    """Yield key, lengths (m) and moment arms (m) of each chunk, in order.

    Close the generator if it is not used up: that is what dismisses the workers.

    Parameters
    ----------
    model_file, coordinates, spans
        As `PathEngine` takes them.
    chunks
        Poses (rad or m), with cylinders placed or not, by any key.
    processes
        Number of workers; 1 for none. None: start here, and call workers if much is left to do.
    """
    waiting = list(chunks)
    if processes is None or processes == 1:
        engine = PathEngine(model_file, coordinates, spans)
        while waiting:
            started = time.monotonic()
            key = waiting.pop(0)
            yield key, *_answer(engine, chunks[key])
            if processes is None:
                left = (time.monotonic() - started) * len(waiting)
                processes = min(_cores(), MOST_WORKERS) if left > POOL_PAYS_AFTER_S else 1
            if processes > 1:
                break
    if waiting:
        yield from _analyse_in_workers(
            (model_file, tuple(coordinates), spans),
            {key: chunks[key] for key in waiting},
            min(processes or 1, len(waiting)),
        )


def _analyse_in_workers(
    engine_arguments: tuple, chunks: dict[int, Chunk], processes: int
) -> Generator[tuple[int, Lengths, MomentArms], None, None]:
    # Not by fork: JAX has threads running, and a fork of those may hang.
    pool = ProcessPoolExecutor(
        processes, mp_context=get_context("spawn"), initializer=_start_worker, initargs=engine_arguments
    )
    broken = False
    try:
        with _calling_script_hidden():
            waiting = deque((key, pool.submit(_analyse_in_worker, chunk)) for key, chunk in chunks.items())
        while waiting:
            key, future = waiting.popleft()
            length, moment_arm = future.result()
            yield key, length, moment_arm
    except BrokenProcessPool as error:
        broken = True
        raise WorkError(
            "a worker process of the muscle analysis died: killed, or out of memory. "
            "What was finished is kept; run it again, or in one process (--threads 1)"
        ) from error
    finally:
        # After Ctrl-C too: what is being analysed ends within a second or two, what is waiting is dropped.
        with _deaf_to_interrupts():
            # A broken pool ends its futures itself, and trips over one that is cancelled meanwhile.
            pool.shutdown(wait=True, cancel_futures=not broken)


@contextmanager
def _calling_script_hidden() -> Iterator[None]:
    """Keep workers that start now from running the caller's script first.

    A spawned process imports its parent's ``__main__``. The workers need nothing of it, and a script
    without ``if __name__ == "__main__":`` would do all its work again in each of them.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C: a second one while workers are dismissed would have Python wait for them for ever."""
    if threading.current_thread() is not threading.main_thread():
        # Only the main thread is interrupted, and only it may say how.
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def _start_worker(
    model_file: Path | str, coordinates: tuple[str, ...], spans: dict[str, tuple[str, ...]]
) -> None:
    global _engine
    # Ctrl-C reaches the whole group of processes; only the parent answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _engine = PathEngine(model_file, coordinates, spans)


def _end_with_parent() -> None:
    """Do not outlive a parent that was killed and could dismiss nobody."""
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


def _analyse_in_worker(chunk: Chunk) -> tuple[Lengths, MomentArms]:
    assert _engine is not None, "the pool starts every worker by _start_worker"
    return _answer(_engine, chunk)


def _answer(engine: PathEngine, chunk: Chunk) -> tuple[Lengths, MomentArms]:
    if isinstance(chunk, Placed):
        return engine.analyse_placed(*chunk)
    return engine.analyse(chunk)


def _cores() -> int:
    """Count the cores this process may use, where the system can say; else all."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
