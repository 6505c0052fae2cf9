"""How times grow with muscles, trials, path coefficients and people; steady state, compiling apart."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from benchmarks.batching import batched
from benchmarks.metric import Metric
from benchmarks.tiled import another_person, tiled
from benchmarks.timing import median_seconds
from wrapjax.calibration.objective import Objective

Kernel = Callable[[Objective, Array], Any]

KERNELS: dict[str, Kernel] = {
    "residuals": lambda problem, x: problem.residuals(x),
    "jacobian": lambda problem, x: problem.moment_jacobian(x),
    "linearization": lambda problem, x: problem.linearize(x),
}
ALL = tuple(KERNELS)
_COMPILED = {name: eqx.filter_jit(kernel) for name, kernel in KERNELS.items()}
#: Sizes in parts of the subject's own muscles and trials; modes a muscle, and people.
PARTS = (0.5, 1.0, 2.0, 4.0)
MODES = (4, 8, 16, 32)
PEOPLE = (1, 2, 4, 8)
_REPEATS = 5


@dataclass(frozen=True)
class Growth:
    """Times of one kernel at several sizes.

    Parameters
    ----------
    axis
        What there is more and more of.
    kernel
        What is timed.
    sizes
        How many.
    seconds, compile_seconds
        Median of steady calls, and what the first took over that; one a size.
    """

    axis: str
    kernel: str
    sizes: tuple[int, ...]
    seconds: tuple[float, ...]
    compile_seconds: tuple[float, ...]

    @property
    def slope(self) -> float:
        """Power of the size that times grow with: the straight line through logarithms."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.seconds), 1)[0])

    def metrics(self) -> list[Metric]:
        """Its slope; time and compiling at the largest size."""
        name, largest = f"growth/{self.axis}/{self.kernel}", self.sizes[-1]
        return [
            Metric(
                f"{name}/slope",
                self.slope,
                "slope",
                "lower",
                f"of log time over log number, {self.sizes[0]} to {largest} {self.axis}",
                negligible=0.15,
            ),
            Metric(name, 1e3 * self.seconds[-1], "ms", "lower", f"{largest} {self.axis}"),
            Metric(
                f"{name}/compile",
                self.compile_seconds[-1],
                "s",
                "lower",
                f"first call at {largest} {self.axis} over later ones; less where the disk still has it",
                negligible=5.0,
            ),
        ]


def growth(problem: Objective) -> tuple[list[Growth], list[Metric]]:
    """Time kernels with more and more muscles, trials, path coefficients and people; give metrics, too."""
    grown = [*by_muscles(problem), *by_trials(problem), *by_modes(problem)]
    in_turn, by_vmap = by_people(problem)
    grown += [in_turn, by_vmap]
    metrics = [metric for one in grown for metric in one.metrics()]
    ratio = Metric(
        "growth/people/in_turn_over_vmap",
        in_turn.seconds[-1] / by_vmap.seconds[-1],
        "x",
        "higher",
        f"linearizations of {PEOPLE[-1]} people of one shape, one after the other over all in one program",
    )
    return grown, [*metrics, ratio]


def by_muscles(problem: Objective, kernels: Sequence[str] = ALL) -> list[Growth]:
    """With muscles, and variables with them."""
    muscles, trials = _own_size(problem)
    problems = {size: tiled(problem, muscles=size, trials=trials) for size in _sizes(muscles)}
    return [_of_kernel("muscles", name, problems) for name in kernels]


def by_trials(problem: Objective, kernels: Sequence[str] = ALL) -> list[Growth]:
    """With trials, and residuals with them."""
    muscles, trials = _own_size(problem)
    problems = {size: tiled(problem, muscles=muscles, trials=size) for size in _sizes(trials)}
    return [_of_kernel("trials", name, problems) for name in kernels]


def by_modes(problem: Objective, kernels: Sequence[str] = ALL) -> list[Growth]:
    """With free coefficients of every path, as in SGA: a few more variables a muscle, then dozens."""
    muscles, trials = _own_size(problem)
    problems = {size: tiled(problem, muscles=muscles, trials=trials, modes=size) for size in MODES}
    return [_of_kernel("modes", name, problems) for name in kernels]


def by_people(problem: Objective) -> tuple[Growth, Growth]:
    """With people of one shape: linearizations one after the other, and all in one program by `vmap`."""
    people = [another_person(problem, seed) for seed in range(PEOPLE[-1])]
    points = [person.variables.start() for person in people]

    def in_turn(size: int) -> Callable[[], Any]:
        pairs = list(zip(people[:size], points[:size], strict=True))
        return lambda: [_COMPILED["linearization"](person, point) for person, point in pairs]

    def by_vmap(size: int) -> Callable[[], Any]:
        together, stacked = batched(KERNELS["linearization"], people[:size]), jnp.stack(points[:size])
        return lambda: together(stacked)

    return (
        _grown("people", "linearization_in_turn", {size: in_turn(size) for size in PEOPLE}),
        _grown("people", "linearization_by_vmap", {size: by_vmap(size) for size in PEOPLE}),
    )


def _own_size(problem: Objective) -> tuple[int, int]:
    return len(problem.initial.emg_scale), len(problem.measured)


def _sizes(own: int) -> tuple[int, ...]:
    return tuple(max(round(part * own), 1) for part in PARTS)


def _of_kernel(axis: str, kernel: str, problems: Mapping[int, Objective]) -> Growth:
    def call_of(problem: Objective) -> Callable[[], Any]:
        point = problem.variables.start()
        return lambda: _COMPILED[kernel](problem, point)

    return _grown(axis, kernel, {size: call_of(problem) for size, problem in problems.items()})


def _grown(axis: str, kernel: str, calls: Mapping[int, Callable[[], Any]]) -> Growth:
    first = {}
    for size, call in calls.items():
        began = time.perf_counter()
        jax.block_until_ready(call())
        first[size] = time.perf_counter() - began
    steady = median_seconds({str(size): call for size, call in calls.items()}, _REPEATS)
    seconds = tuple(steady[str(size)] for size in calls)
    compiling = (max(first[size] - taken, 0.0) for size, taken in zip(calls, seconds, strict=True))
    return Growth(axis, kernel, tuple(calls), seconds, tuple(compiling))
