"""Watching an optimizer: how far it comes, when, and when to stop it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Run:
    """How an optimizer did.

    Parameters
    ----------
    name
        Of the optimizer.
    seconds, core_seconds
        From its start to its end, or to the limit on its time, by the clock and of all processors;
        compiling is left out.
    cost, variables
        The best point that it saw.
    trace
        Seconds and cost whenever it saw a better one.
    message
        How it ended.
    evaluations
        How often it asked for the cost or the residuals, those it only differenced at among them.
    iterations
        Of its own; 0 where it does not say.
    """

    name: str
    seconds: float
    core_seconds: float
    cost: float
    variables: Float[np.ndarray, " variable"]
    trace: tuple[tuple[float, float], ...]
    message: str
    evaluations: int
    iterations: int = 0

    def arrival(self, cost: float) -> float | None:
        """When it first saw a cost as low as this, in s; None if never."""
        return next((seconds for seconds, seen in self.trace if seen <= cost), None)


class _TimeIsUp(Exception):
    """Ends an optimizer from within the function that it minimises."""


class IterationCallback:
    """Notes every point that an optimizer evaluates; ends it when its time is up."""

    def __init__(self, limit: float):
        self._limit = limit
        self._began, self._began_core = time.perf_counter(), time.process_time()
        self._variables = np.array([])
        self._trace: list[tuple[float, float]] = []
        self.evaluations = 0

    def see(self, variables: Float[np.ndarray, " variable"], cost: float) -> None:
        """Take note of an evaluation; points the optimizer only differences at count as well."""
        self.evaluations += 1
        seconds = time.perf_counter() - self._began
        if not self._trace or cost < self._trace[-1][1]:
            self._trace.append((seconds, float(cost)))
            self._variables = np.array(variables)
        if seconds > self._limit:
            raise _TimeIsUp

    def finish(self, name: str, message: str) -> Run:
        """Sum the run up."""
        return Run(
            name=name,
            seconds=time.perf_counter() - self._began,
            core_seconds=time.process_time() - self._began_core,
            cost=self._trace[-1][1],
            variables=self._variables,
            trace=tuple(self._trace),
            message=message,
            evaluations=self.evaluations,
        )


def race(name: str, limit: float, optimize: Callable[[IterationCallback], str]) -> Run:
    """Let an optimizer run, for ``limit`` seconds at most.

    Parameters
    ----------
    name
        Of the optimizer.
    limit
        In s. It is looked at with every evaluation, so that a long step may overrun it.
    optimize
        Reports every evaluation to the watch; returns how it ended.
    """
    watch = IterationCallback(limit)
    try:
        ending = optimize(watch)
    except _TimeIsUp:
        ending = f"not finished after {limit:.0f} s"
    return watch.finish(name, f"{watch.evaluations} evaluations; {ending}")
