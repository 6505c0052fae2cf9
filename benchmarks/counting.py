"""Counters of function evaluations by the solver and of programs requested from XLA."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

from jax import monitoring

from wrapjax.calibration.solvers import interface


@dataclass
class Evaluations:
    """Number of evaluations of the cost alone, and of the cost with all its derivatives."""

    values: int = 0
    linearizations: int = 0

    @property
    def total(self) -> int:
        """Sum of both; a linearization evaluates the residuals once, as a cost does."""
        return self.values + self.linearizations


@contextmanager
def counted_evaluations() -> Iterator[Evaluations]:
    """Count the evaluations by `ProjectedLevenbergMarquardt` inside the context."""
    count = Evaluations()
    value, linearize = interface._value, interface._linearize

    def counted_value(*arguments: Any) -> Any:
        count.values += 1
        return value(*arguments)

    def counted_linearize(*arguments: Any) -> Any:
        count.linearizations += 1
        return linearize(*arguments)

    with mock.patch.multiple(interface, _value=counted_value, _linearize=counted_linearize):
        yield count


@contextmanager
def counted_programs() -> Iterator[list[str]]:
    """List the names of the programs requested from XLA inside the context, compiled or read from disk."""
    requested: list[str] = []

    def record(event: str, duration_secs: float, **about: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            requested.append(str(about.get("fun_name", "?")))

    monitoring.register_event_duration_secs_listener(record)
    try:
        yield requested
    finally:
        monitoring.unregister_event_duration_listener(record)
