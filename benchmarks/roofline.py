"""How near kernels come to what the machine can do: its roofline, by arithmetic and by memory.

Operations and bytes are XLA's own count for the compiled program. It counts the body of a loop once, however
often it runs (activation steps through the frames in one), nothing of what libraries are called for (LAPACK),
and transcendental functions apart. Its bytes are what each fused operation reads and writes, and much of that
never leaves the caches: a kernel can lie above the sloping part of the roof.

Williams, Waterman & Patterson 2009, doi:10.1145/1498765.1498785.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case
from benchmarks.metric import Metric
from benchmarks.timing import median_seconds
from wrapjax.geometry.engine import GEODESIC, ExactPaths, PosedPath
from wrapjax.geometry.training_samples import random_poses
from wrapjax.geometry.wrap_bounds import NARROWER, box, hammersley
from wrapjax.osim.model import describe_model
from wrapjax.subject.subject import Subject

#: Rows of the square matrices that are multiplied, and numbers in each array that is streamed (80 MB, which
#: no cache holds).
_MATRIX, _STREAM = 1024, 10_000_000
_REPEATS = 7
_POSES, _SAMPLES = 500, 40


@dataclass(frozen=True)
class Roof:
    """What the machine can do with the threads it was given.

    Parameters
    ----------
    peak
        Floating-point operations a second (float64).
    bandwidth
        Bytes a second.
    """

    peak: float
    bandwidth: float

    @property
    def ridge(self) -> float:
        """Operations a byte from which on arithmetic is what limits."""
        return self.peak / self.bandwidth

    def at(self, intensity: float) -> float:
        """Most operations a second at so many operations a byte."""
        return min(self.peak, self.bandwidth * intensity)


@dataclass(frozen=True)
class Work:
    """What one call of a kernel does, as XLA counts it, and how long it takes.

    Parameters
    ----------
    name
        Of the kernel.
    flops, transcendentals, bytes_moved
        Counted for the compiled program.
    seconds
        Median of steady calls.
    missed
        In words: what of it the count leaves out.
    """

    name: str
    flops: float
    transcendentals: float
    bytes_moved: float
    seconds: float
    missed: str

    @property
    def rate(self) -> float:
        """Operations a second."""
        return self.flops / self.seconds

    @property
    def intensity(self) -> float:
        """Operations a byte."""
        return self.flops / self.bytes_moved


def roofline(subject: Subject, case: Case) -> tuple[Roof, list[Work], list[Metric]]:
    """Measure the machine and its roof, then the kernels of a calibration and the path engine below it."""
    roof = measured_roof()
    start = case.start
    kernels: dict[str, tuple[Callable[..., Any], tuple[Any, ...]]] = {
        "residuals": (lambda problem, x: problem.residuals(x), (case.problem, start)),
        "jacobian": (lambda problem, x: problem.moment_jacobian(x), (case.problem, start)),
        "linearization": (lambda problem, x: problem.linearize(x), (case.problem, start)),
    }
    engine = _path_engine(subject)
    if engine is not None:
        kernels["path_engine"] = engine
    works = [work_of(name, function, arguments) for name, (function, arguments) in kernels.items()]
    metrics = [
        Metric(
            "roofline/peak", 1e-9 * roof.peak, "GFLOP/s", "higher", f"{_MATRIX} x {_MATRIX} float64 matmul"
        ),
        Metric("roofline/bandwidth", 1e-9 * roof.bandwidth, "GB/s", "higher", "a + s b into a, 80 MB each"),
        *(metric for work in works for metric in _metrics(work, roof)),
    ]
    return roof, works, metrics


def measured_roof() -> Roof:
    """Time what does nothing but multiply and add, and what does nothing but read and write."""
    matrix = jnp.asarray(np.random.default_rng(0).standard_normal((_MATRIX, _MATRIX)))
    multiply = jax.jit(jnp.matmul)
    first, second = np.ones(_STREAM), np.ones(_STREAM)

    # By NumPy and in place, piece by piece: XLA would ask the system for a new array with every call.
    piece, scratch = 16_384, np.empty(16_384)

    def stream() -> None:
        for begin in range(0, _STREAM, piece):
            own = slice(begin, begin + piece)
            product = scratch[: len(first[own])]
            np.multiply(second[own], 1e-3, out=product)
            first[own] += product

    seconds = median_seconds({"multiply": lambda: multiply(matrix, matrix), "stream": stream}, _REPEATS)
    return Roof(
        peak=2.0 * _MATRIX**3 / seconds["multiply"],
        bandwidth=3 * first.nbytes / seconds["stream"],
    )


def work_of(name: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Work:
    """Compile a function, have XLA count its work, and time it."""
    jitted: Any = eqx.filter_jit(function)
    program = jitted.lower(*arguments).compile()
    counted, text = program.compiled.cost_analysis(), program.compiled.as_text()
    loops, calls = len(re.findall(r" while\(", text)), len(re.findall(r" custom-call\(", text))
    turns = ", ".join(dict.fromkeys(re.findall(r'known_trip_count":{"n":"(\d+)"', text)))
    of_turns = f" of {turns} turns" if turns else ""
    seconds = median_seconds({name: lambda: program(*arguments)}, _REPEATS)[name]
    return Work(
        name=name,
        flops=counted["flops"],
        transcendentals=counted.get("transcendentals", 0.0),
        bytes_moved=counted["bytes accessed"],
        seconds=seconds,
        missed=f"loops{of_turns} counted as one turn: {loops}; library calls not counted: {calls}",
    )


def _metrics(work: Work, roof: Roof) -> list[Metric]:
    name = f"roofline/{work.name}"
    counted = f"{work.flops:.3g} operations, {work.transcendentals:.3g} transcendentals; {work.missed}"
    limit = "arithmetic" if work.intensity > roof.ridge else "memory"
    share = 100.0 * work.rate / roof.at(work.intensity)
    return [
        Metric(name, 1e-9 * work.rate, "GFLOP/s", "higher", counted),
        Metric(
            f"{name}/intensity",
            work.intensity,
            "flop/byte",
            "higher",
            f"{1e-6 * work.bytes_moved:.3g} MB; the roof turns at {roof.ridge:.2g}",
        ),
        Metric(
            f"{name}/share", share, "%", "higher", f"of the roof, where {limit} is the limit", tolerance=1.0
        ),
    ]


def _path_engine(subject: Subject) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
    """Lay the first path round one cylinder, in many poses and round it placed in many ways."""
    trials, model = subject.trials, describe_model(subject.model_file)
    coordinates = trials.moment_coordinates
    wrapped = [name for name in subject.muscles.names if model.muscle(name).wraps]
    engine = ExactPaths(model, wrapped, coordinates)
    single = next((name for name in wrapped if len(engine.wraps_of(name)) == 1), None)
    if single is None:
        return None
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    posed = engine.posed(random_poses(angles, _POSES, np.random.default_rng(0)))[single]
    lower, upper = box(max(NARROWER))
    samples = jnp.asarray((lower + (upper - lower) * hammersley(_SAMPLES))[:, None])

    def wrap(posed: PosedPath, samples: jax.Array) -> Any:
        return jax.vmap(lambda one: posed.wrapped(one, GEODESIC))(samples)

    return wrap, (posed, samples)
