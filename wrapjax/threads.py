"""Independent computations in threads: compiled programs and NumPy release the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from threadpoolctl import threadpool_limits

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_Other = TypeVar("_Other")


def usable_cores() -> int:
    """Count the cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS
        return os.cpu_count() or 1


def thread_count() -> int:
    """Count the threads of this process: the usable cores, or fewer where ``OMP_NUM_THREADS`` says so."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    return min(usable_cores(), int(given)) if given.isdigit() and int(given) else usable_cores()


def map_in_threads(function: Callable[[_Item], _Result], items: Sequence[_Item]) -> list[_Result]:
    """Apply a function to independent items, `thread_count` of them at a time; results are in their order.

    The first item is alone, so that its programs are compiled once. An exception of the function is raised
    here once the items that had begun are done. Linear algebra of NumPy and SciPy has one thread meanwhile:
    threads of each item's own would wait for each other.
    """
    if thread_count() < 2:
        return [function(item) for item in items]
    results = [function(item) for item in items[:1]]
    with threadpool_limits(1, user_api="blas"), ThreadPoolExecutor(thread_count()) as pool:
        futures = [pool.submit(function, item) for item in items[1:]]
        try:
            return results + [future.result() for future in futures]
        finally:
            for future in futures:
                future.cancel()


def call_together(function: Callable[[], _Result], in_thread: Callable[[], _Other]) -> tuple[_Result, _Other]:
    """Call two independent functions, the second in a thread beside the first; return both results.

    One after the other where the process has one thread. An exception of either is raised once both are done,
    that of the first before that of the second.
    """
    if thread_count() < 2:
        return function(), in_thread()
    with threadpool_limits(1, user_api="blas"), ThreadPoolExecutor(1) as pool:
        other = pool.submit(in_thread)
        return function(), other.result()
