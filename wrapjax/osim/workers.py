"""Parallel muscle analysis: chunks of poses are analyzed in this process or in several worker processes."""

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

from wrapjax.errors import ComputationError
from wrapjax.osim.path_engine import PathEngine, WrapParameters
from wrapjax.threads import usable_cores

#: Remaining work (s) above which workers are started. Each of them imports OpenSim and loads the model, which
#: takes a few seconds.
POOL_PAYS_AFTER_S = 6.0
#: Most workers. Further ones would save little time, and each holds a model in memory.
MAX_WORKERS = 8

Poses = Float[np.ndarray, "pose coordinate"]
#: The first axis is ``placement`` if chunks have placements of cylinders.
Lengths = Float[np.ndarray, "*placement pose muscle"]
MomentArms = Float[np.ndarray, "*placement pose coordinate muscle"]


class Placed(NamedTuple):
    """Poses to analyze for each of several placements of cylinders (wrap parameters by cylinder name)."""

    placements: tuple[Mapping[str, WrapParameters], ...]
    poses: Poses


#: Poses that are analyzed at a time, with or without placements of cylinders.
Chunk = Poses | Placed

# The engine of a worker process.
_engine: PathEngine | None = None


def analyse_chunks(
    model_file: Path | str,
    coordinates: Sequence[str],
    spans: dict[str, tuple[str, ...]],
    chunks: Mapping[int, Chunk],
    processes: int | None,
) -> Generator[tuple[int, Lengths, MomentArms], None, None]:
    """Yield key, lengths (m) and moment arms (m) of each chunk, in order.

    A generator that is not exhausted must be closed, which ends the workers.

    Parameters
    ----------
    model_file, coordinates, spans
        Arguments of `PathEngine`.
    chunks
        Poses (rad or m), with or without placements of cylinders, by key.
    processes
        Number of workers; 1 for none. None to begin in this process, and start workers if much work remains.

    Raises
    ------
    WorkError
        If a worker process dies.
    """
    waiting = list(chunks)
    if processes is None or processes == 1:
        engine = PathEngine(model_file, coordinates, spans)
        while waiting:
            started = time.monotonic()
            key = waiting.pop(0)
            yield key, *_analyse(engine, chunks[key])
            if processes is None:
                remaining = (time.monotonic() - started) * len(waiting)
                processes = min(usable_cores(), MAX_WORKERS) if remaining > POOL_PAYS_AFTER_S else 1
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
    # Spawned rather than forked, because a fork of a process with JAX's threads may hang.
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
        raise ComputationError(
            "a worker process of the muscle analysis died: killed, or out of memory. "
            "Finished results are kept; run it again, or in one process (--threads 1)"
        ) from error
    finally:
        # Also after Ctrl-C: chunks being analyzed end within a second or two, waiting ones are cancelled.
        with _interrupts_ignored():
            # A broken pool ends its futures itself, and fails on one that is cancelled meanwhile.
            pool.shutdown(wait=True, cancel_futures=not broken)


@contextmanager
def _calling_script_hidden() -> Iterator[None]:
    """Prevent new workers from running the caller's script.

    A spawned process imports its parent's ``__main__``. The workers do not need it, and a script without
    ``if __name__ == "__main__":`` would be run again in each of them.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C, because after a second one while workers end Python would wait for them forever."""
    if threading.current_thread() is not threading.main_thread():
        # Only the main thread is interrupted and may set signal handlers.
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
    # Ctrl-C is sent to all processes of the group; only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _engine = PathEngine(model_file, coordinates, spans)


def _end_with_parent() -> None:
    """Exit when the parent process ends, also if it was killed and could not end its workers."""
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


def _analyse_in_worker(chunk: Chunk) -> tuple[Lengths, MomentArms]:
    assert _engine is not None, "the pool starts every worker by _start_worker"
    return _analyse(_engine, chunk)


def _analyse(engine: PathEngine, chunk: Chunk) -> tuple[Lengths, MomentArms]:
    if isinstance(chunk, Placed):
        return engine.analyse_placed(*chunk)
    return engine.analyse(chunk)
