"""Wall times of function calls on a shared machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np


def median_seconds(calls: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Time calls in turn, so that other load on the machine affects all of them equally.

    Each timed call follows an untimed one of the same function, so that its time does not depend on the
    memory use of the previous function. The first call also compiles.

    Parameters
    ----------
    calls
        Functions by name; each returns JAX arrays, which are waited for.
    repeats
        Number of timed calls of each function.

    Returns
    -------
    dict
        Median wall time of each function, s.
    """
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            jax.block_until_ready(call())
            began = time.perf_counter()
            jax.block_until_ready(call())
            taken[name].append(time.perf_counter() - began)
    return {name: float(np.median(values)) for name, values in taken.items()}
