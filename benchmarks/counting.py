"""Counting what is done, where it is done: evaluations of a problem, and programs that XLA is asked for."""

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
    """How often our solver asked for a cost alone, and for a cost with all its derivatives."""

    values: int = 0
    linearizations: int = 0

    @property
    def total(self) -> int:
        """Both; a linearization evaluates the residuals once, as a cost does."""
        return self.values + self.linearizations


@contextmanager
def counted_evaluations() -> Iterator[Evaluations]:
    """Count what `ProjectedLevenbergMarquardt` asks of its problem meanwhile."""
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
    """List the programs that XLA is asked for meanwhile, by name, whether compiled or found on disk."""
    asked: list[str] = []

    def note(event: str, duration_secs: float, **about: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            asked.append(str(about.get("fun_name", "?")))

    monitoring.register_event_duration_secs_listener(note)
    try:
        yield asked
    finally:
        monitoring.unregister_event_duration_listener(note)
