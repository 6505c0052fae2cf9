"""Record of an optimizer's evaluations over time, with a time limit."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Run:
    """Result of one optimizer.

    Parameters
    ----------
    name
        Name of the optimizer.
    seconds, core_seconds
        Wall time and processor time until its end or the time limit, without compilation.
    cost, variables
        Lowest cost evaluated, and its variables.
    trace
        Seconds and cost of each evaluation that lowered the cost.
    message
        Reason of termination.
    evaluations
        Evaluations of the cost or the residuals, including those for finite differences.
    iterations
        Iterations of the optimizer; 0 if it does not report them.
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

    def seconds_to_reach(self, cost: float) -> float | None:
        """Return the time (s) of the first evaluation at or below a cost; None if there is none."""
        return next((seconds for seconds, evaluated in self.trace if evaluated <= cost), None)


class _TimeLimitReached(Exception):
    """Ends an optimizer from within the function that it minimizes."""


class EvaluationRecorder:
    """Records every evaluation by an optimizer, and stops it at the time limit."""

    def __init__(self, limit: float):
        self._limit = limit
        self._began, self._began_core = time.perf_counter(), time.process_time()
        self._variables = np.array([])
        self._trace: list[tuple[float, float]] = []
        self.evaluations = 0

    def record(self, variables: Float[np.ndarray, " variable"], cost: float) -> None:
        """Record an evaluation, including those for finite differences."""
        self.evaluations += 1
        seconds = time.perf_counter() - self._began
        if not self._trace or cost < self._trace[-1][1]:
            self._trace.append((seconds, float(cost)))
            self._variables = np.array(variables)
        if seconds > self._limit:
            raise _TimeLimitReached

    def finish(self, name: str, message: str) -> Run:
        """Return the result of the run."""
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


def run_with_limit(name: str, limit: float, optimize: Callable[[EvaluationRecorder], str]) -> Run:
    """Run an optimizer for at most ``limit`` seconds.

    Parameters
    ----------
    name
        Name of the optimizer.
    limit
        Time limit in s. It is checked at every evaluation, so a long step may exceed it.
    optimize
        Function that runs the optimizer, records every evaluation, and returns the reason of termination.
    """
    recorder = EvaluationRecorder(limit)
    try:
        message = optimize(recorder)
    except _TimeLimitReached:
        message = f"not finished after {limit:.0f} s"
    return recorder.finish(name, f"{recorder.evaluations} evaluations; {message}")
