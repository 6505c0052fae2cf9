"""Growth of run times with the numbers of muscles, trials, path coefficients and subjects."""

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
from benchmarks.tiled_problems import perturb_problem, tile_problem
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
#: Numbers of muscles and trials relative to the subject's own; modes of each path; numbers of subjects.
PARTS = (0.5, 1.0, 2.0, 4.0)
MODES = (4, 8, 16, 32)
SUBJECTS = (1, 2, 4, 8)
_REPEATS = 5


@dataclass(frozen=True)
class Growth:
    """Times of one kernel at several sizes.

    Parameters
    ----------
    axis
        Quantity that is increased, such as ``muscles``.
    kernel
        Name of the timed function.
    sizes
        Numbers of that quantity.
    seconds, compile_seconds
        Median time of calls after the first, and the excess of the first call over it, for each size.
    """

    axis: str
    kernel: str
    sizes: tuple[int, ...]
    seconds: tuple[float, ...]
    compile_seconds: tuple[float, ...]

    @property
    def slope(self) -> float:
        """Exponent of a power law, fitted to the logarithms of times and sizes."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.seconds), 1)[0])

    def metrics(self) -> list[Metric]:
        """Return the slope, and the time and compile time at the largest size."""
        name, largest = f"growth/{self.axis}/{self.kernel}", self.sizes[-1]
        return [
            Metric(
                f"{name}/slope",
                self.slope,
                "slope",
                "lower",
                f"log time over log number, {self.sizes[0]} to {largest} {self.axis}",
                negligible=0.15,
            ),
            Metric(name, 1e3 * self.seconds[-1], "ms", "lower", f"{largest} {self.axis}"),
            Metric(
                f"{name}/compile",
                self.compile_seconds[-1],
                "s",
                "lower",
                f"first call at {largest} {self.axis} minus later ones; less if cached on disk",
                negligible=5.0,
            ),
        ]


def growth(problem: Objective) -> tuple[list[Growth], list[Metric]]:
    """Time kernels for increasing numbers of muscles, trials, path coefficients and subjects."""
    measured = [*by_muscles(problem), *by_trials(problem), *by_modes(problem)]
    in_turn, by_vmap = by_subjects(problem)
    measured += [in_turn, by_vmap]
    metrics = [metric for kernel in measured for metric in kernel.metrics()]
    ratio = Metric(
        "growth/people/in_turn_over_vmap",
        in_turn.seconds[-1] / by_vmap.seconds[-1],
        "x",
        "higher",
        f"time of {SUBJECTS[-1]} linearizations in turn over their time in one program",
    )
    return measured, [*metrics, ratio]


def by_muscles(problem: Objective, kernels: Sequence[str] = ALL) -> list[Growth]:
    """Time kernels for increasing numbers of muscles, and so of variables."""
    muscles, trials = _problem_size(problem)
    problems = {size: tile_problem(problem, muscles=size, trials=trials) for size in _sizes(muscles)}
    return [_time_kernel("muscles", name, problems) for name in kernels]


def by_trials(problem: Objective, kernels: Sequence[str] = ALL) -> list[Growth]:
    """Time kernels for increasing numbers of trials, and so of residuals."""
    muscles, trials = _problem_size(problem)
    problems = {size: tile_problem(problem, muscles=muscles, trials=size) for size in _sizes(trials)}
    return [_time_kernel("trials", name, problems) for name in kernels]


def by_modes(problem: Objective, kernels: Sequence[str] = ALL) -> list[Growth]:
    """Time kernels for increasing numbers of free coefficients of each path, as in SGA."""
    muscles, trials = _problem_size(problem)
    problems = {size: tile_problem(problem, muscles=muscles, trials=trials, modes=size) for size in MODES}
    return [_time_kernel("modes", name, problems) for name in kernels]


def by_subjects(problem: Objective) -> tuple[Growth, Growth]:
    """Time linearizations of several subjects of one shape, in turn and in one program by `vmap`."""
    problems = [perturb_problem(problem, seed) for seed in range(SUBJECTS[-1])]
    points = [one.variables.start() for one in problems]

    def in_turn(size: int) -> Callable[[], Any]:
        pairs = list(zip(problems[:size], points[:size], strict=True))
        return lambda: [_COMPILED["linearization"](one, point) for one, point in pairs]

    def by_vmap(size: int) -> Callable[[], Any]:
        run, stacked = batched(KERNELS["linearization"], problems[:size]), jnp.stack(points[:size])
        return lambda: run(stacked)

    return (
        _time_calls("people", "linearization_in_turn", {size: in_turn(size) for size in SUBJECTS}),
        _time_calls("people", "linearization_by_vmap", {size: by_vmap(size) for size in SUBJECTS}),
    )


def _problem_size(problem: Objective) -> tuple[int, int]:
    return len(problem.initial.emg_scale), len(problem.measured)


def _sizes(present: int) -> tuple[int, ...]:
    return tuple(max(round(part * present), 1) for part in PARTS)


def _time_kernel(axis: str, kernel: str, problems: Mapping[int, Objective]) -> Growth:
    def call_of(problem: Objective) -> Callable[[], Any]:
        point = problem.variables.start()
        return lambda: _COMPILED[kernel](problem, point)

    return _time_calls(axis, kernel, {size: call_of(problem) for size, problem in problems.items()})


def _time_calls(axis: str, kernel: str, calls: Mapping[int, Callable[[], Any]]) -> Growth:
    first = {}
    for size, call in calls.items():
        began = time.perf_counter()
        jax.block_until_ready(call())
        first[size] = time.perf_counter() - began
    steady = median_seconds({str(size): call for size, call in calls.items()}, _REPEATS)
    seconds = tuple(steady[str(size)] for size in calls)
    compiling = (max(first[size] - taken, 0.0) for size, taken in zip(calls, seconds, strict=True))
    return Growth(axis, kernel, tuple(calls), seconds, tuple(compiling))
