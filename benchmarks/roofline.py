"""Roofline of the machine, and the operation rates of the kernels below it.

The roofline is the highest rate that arithmetic and memory bandwidth allow at a given number of operations
per byte (Williams, Waterman & Patterson 2009, doi:10.1145/1498765.1498785). Operations and bytes are counted
by XLA for the compiled program. XLA counts the body of a loop once, however often it runs (activation
dynamics loop over frames), nothing of library calls (LAPACK), and transcendental functions separately. Its
bytes are those that each fused operation reads and writes; most of them stay in the caches, so a kernel can
lie above the sloping part of the roofline.
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
from wrapjax.geometry.exact_paths.engine import GEODESIC, ExactPaths, PosedPath
from wrapjax.geometry.surrogates.training_samples import random_poses
from wrapjax.geometry.surrogates.wrap_bounds import NARROWER_TRANSLATIONS, hammersley, parameter_box
from wrapjax.osim.model import describe_model
from wrapjax.subject.subject import Subject

#: Rows of the square matrices that are multiplied, and numbers in each streamed array (80 MB, larger than any
#: cache).
_MATRIX, _STREAM = 1024, 10_000_000
_REPEATS = 7
_POSES, _SAMPLES = 500, 40


@dataclass(frozen=True)
class Roof:
    """Highest rates of the machine with the threads in use.

    Parameters
    ----------
    peak
        Floating-point operations per second (float64).
    bandwidth
        Memory bandwidth, bytes per second.
    """

    peak: float
    bandwidth: float

    @property
    def ridge(self) -> float:
        """Operations per byte above which arithmetic is the limit."""
        return self.peak / self.bandwidth

    def at(self, intensity: float) -> float:
        """Return the highest operations per second at a number of operations per byte."""
        return min(self.peak, self.bandwidth * intensity)


@dataclass(frozen=True)
class Work:
    """Work of one call of a kernel as counted by XLA, and its time.

    Parameters
    ----------
    name
        Name of the kernel.
    flops, transcendentals, bytes_moved
        Counts for the compiled program.
    seconds
        Median time of calls after the first.
    missed
        Description of the work that the count omits.
    """

    name: str
    flops: float
    transcendentals: float
    bytes_moved: float
    seconds: float
    missed: str

    @property
    def rate(self) -> float:
        """Operations per second."""
        return self.flops / self.seconds

    @property
    def intensity(self) -> float:
        """Operations per byte."""
        return self.flops / self.bytes_moved


def roofline(subject: Subject, case: Case) -> tuple[Roof, list[Work], list[Metric]]:
    """Measure the machine's roofline, and the kernels of a calibration and the path engine."""
    roof = measure_roof()
    start = case.start
    kernels: dict[str, tuple[Callable[..., Any], tuple[Any, ...]]] = {
        "residuals": (lambda problem, x: problem.residuals(x), (case.problem, start)),
        "jacobian": (lambda problem, x: problem.moment_jacobian(x), (case.problem, start)),
        "linearization": (lambda problem, x: problem.linearize(x), (case.problem, start)),
    }
    engine = _path_engine(subject)
    if engine is not None:
        kernels["path_engine"] = engine
    works = [measure_work(name, function, arguments) for name, (function, arguments) in kernels.items()]
    metrics = [
        Metric(
            "roofline/peak", 1e-9 * roof.peak, "GFLOP/s", "higher", f"{_MATRIX} x {_MATRIX} float64 matmul"
        ),
        Metric("roofline/bandwidth", 1e-9 * roof.bandwidth, "GB/s", "higher", "a + s b into a, 80 MB each"),
        *(metric for work in works for metric in _metrics(work, roof)),
    ]
    return roof, works, metrics


def measure_roof() -> Roof:
    """Measure peak arithmetic by a matrix product and bandwidth by an array update."""
    matrix = jnp.asarray(np.random.default_rng(0).standard_normal((_MATRIX, _MATRIX)))
    multiply = jax.jit(jnp.matmul)
    first, second = np.ones(_STREAM), np.ones(_STREAM)

    # By NumPy, in place and in pieces: XLA would allocate a new array at every call.
    piece, scratch = 16_384, np.empty(16_384)

    def stream() -> None:
        for begin in range(0, _STREAM, piece):
            span = slice(begin, begin + piece)
            product = scratch[: len(first[span])]
            np.multiply(second[span], 1e-3, out=product)
            first[span] += product

    seconds = median_seconds({"multiply": lambda: multiply(matrix, matrix), "stream": stream}, _REPEATS)
    return Roof(
        peak=2.0 * _MATRIX**3 / seconds["multiply"],
        bandwidth=3 * first.nbytes / seconds["stream"],
    )


def measure_work(name: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Work:
    """Compile a function, count its work by XLA, and time it."""
    jitted: Any = eqx.filter_jit(function)
    program = jitted.lower(*arguments).compile()
    counted, text = program.compiled.cost_analysis(), program.compiled.as_text()
    loops, calls = len(re.findall(r" while\(", text)), len(re.findall(r" custom-call\(", text))
    turns = ", ".join(dict.fromkeys(re.findall(r'known_trip_count":{"n":"(\d+)"', text)))
    of_turns = f" of {turns} iterations" if turns else ""
    seconds = median_seconds({name: lambda: program(*arguments)}, _REPEATS)[name]
    return Work(
        name=name,
        flops=counted["flops"],
        transcendentals=counted.get("transcendentals", 0.0),
        bytes_moved=counted["bytes accessed"],
        seconds=seconds,
        missed=f"loops{of_turns} counted as one iteration: {loops}; library calls not counted: {calls}",
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
            f"{1e-6 * work.bytes_moved:.3g} MB; ridge of the roofline at {roof.ridge:.2g}",
        ),
        Metric(f"{name}/share", share, "%", "higher", f"of the roofline, limited by {limit}", tolerance=1.0),
    ]


def _path_engine(subject: Subject) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
    """Compute the first path round one cylinder in many poses and for many wrap parameters."""
    trials, model = subject.trials, describe_model(subject.model_file)
    coordinates = trials.moment_coordinates
    wrapped = [name for name in subject.muscles.names if model.muscle(name).wraps]
    engine = ExactPaths(model, wrapped, coordinates)
    single = next((name for name in wrapped if len(engine.wraps_of(name)) == 1), None)
    if single is None:
        return None
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    posed = engine.posed(random_poses(angles, _POSES, np.random.default_rng(0)))[single]
    lower, upper = parameter_box(max(NARROWER_TRANSLATIONS))
    samples = jnp.asarray((lower + (upper - lower) * hammersley(_SAMPLES))[:, None])

    def wrap(posed: PosedPath, samples: jax.Array) -> Any:
        return jax.vmap(lambda one: posed.wrapped(one, GEODESIC))(samples)

    return wrap, (posed, samples)
