"""Timing on a machine that others use too."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np


def median_seconds(calls: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Time calls in turn, so that whatever else the machine does meets all of them alike.

    Each timed call follows an untimed one of its own kind: what ran before it, perhaps with hundreds of
    megabytes, must not be charged to it. The very first call also compiles.

    Parameters
    ----------
    calls
        By name; each returns JAX arrays, which are waited for.
    repeats
        How often each is timed.

    Returns
    -------
    dict
        Median wall time of each.
    """
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            jax.block_until_ready(call())
            began = time.perf_counter()
            jax.block_until_ready(call())
            taken[name].append(time.perf_counter() - began)
    return {name: float(np.median(values)) for name, values in taken.items()}
