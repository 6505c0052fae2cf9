"""How fast the exact engine lays wrapping paths, one OpenSim process on the same poses and samples beside.

An analysis is the length and all moment arms of one muscle, in one pose, round cylinders at one sample of
their parameters.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from benchmarks.metric import INFORMATION, Metric
from benchmarks.plain_opensim import plain_seconds
from benchmarks.timing import median_seconds
from wrapjax.geometry.engine import GEODESIC, PARITY, ExactPaths, PosedPath, wrap_at_samples
from wrapjax.geometry.training_samples import random_poses
from wrapjax.geometry.wrap_bounds import NARROWER, box, hammersley
from wrapjax.osim.model import describe_model
from wrapjax.osim.path_engine import PathEngine
from wrapjax.subject.subject import Subject

POSES = 500
#: Samples that all poses are analysed at, of every wrapped muscle: 500,000 analyses a muscle.
ALL_SAMPLES = 1000
SAMPLES = 40
#: OpenSim's `computeMomentArm` is timed in so many poses.
PLAIN_POSES = 50
#: OpenSim is timed on every so manyth of the samples; paths round several cylinders take it much longer.
OPENSIM_STEP = {"single": 10, "several": 20}
#: How many times as fast as OpenSim, by number of cylinders and way of wrapping.
SPEED_TARGETS = {"single/geodesic": 300, "single/parity": 300, "several/geodesic": 50, "several/parity": 5}
SECONDS_TARGET = 120
MEMORY_TARGET_GB = 3
SEED = 20

Poses = Float[np.ndarray, "pose coordinate"]
Samples = Float[np.ndarray, "sample wrap_parameter"]
Lengths = Float[np.ndarray, "sample pose muscle"]


class Judged(NamedTuple):
    """What OpenSim found, how long one analysis took it (s), and how long by `computeMomentArm`."""

    length: Lengths
    seconds: float
    plain_seconds: float


def engine_speed(subject: Subject, *, quick: bool = False, full: bool = False) -> list[Metric]:
    """Time the engine and OpenSim on a subject's wrapped muscles, in poses of its gait.

    Parameters
    ----------
    quick
        One repeat instead of five.
    full
        Do all analyses, rather than conclude from fewer how long they would take.
    """
    engine, poses = wrapping_muscles(subject)
    wrapped = engine.muscles
    began = time.perf_counter()
    posed = engine.posed(poses)
    posing = time.perf_counter() - began
    metrics = [Metric("engine/posing", posing, "s", "lower", f"{len(wrapped)} muscles, {POSES} poses")]

    single = [name for name in wrapped if len(engine.wraps_of(name)) == 1]
    groups = {"single": single, "several": [name for name in wrapped if name not in single]}
    whole = posing
    for group, muscles in groups.items():
        if muscles:
            paths = [posed[name] for name in muscles]
            own, seconds, compiling = _beside_opensim(subject, group, muscles, paths, poses, quick)
            metrics += own
            whole += compiling + seconds * POSES * ALL_SAMPLES * len(muscles)
    how = "concluded from fewer samples"
    if full:
        whole, how = posing + _all_analyses(list(posed.values())), "measured; compiled before"
    return [
        *metrics,
        Metric(
            "engine/all_analyses",
            whole,
            "s",
            "lower",
            f"{POSES * ALL_SAMPLES:,} for each of {len(wrapped)} muscles, geodesic; {how}; "
            f"target at most {SECONDS_TARGET}",
        ),
        Metric(
            "engine/peak_memory",
            _peak_memory_gb(),
            "GB",
            "lower",
            f"of this process until now{', all analyses kept' if full else ''}; "
            f"target below {MEMORY_TARGET_GB}",
        ),
    ]


def wrapping_muscles(subject: Subject) -> tuple[ExactPaths, Poses]:
    """Give the engine of a subject's wrapped muscles, and poses of its gait."""
    trials = subject.trials
    coordinates = trials.moment_coordinates
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    model = describe_model(subject.model_file)
    wrapped = [name for name in subject.muscles.names if model.muscle(name).wraps]
    poses = random_poses(angles, POSES, np.random.default_rng(SEED))
    return ExactPaths(model, wrapped, coordinates), poses


def samples_in_the_box(count: int) -> Samples:
    """Spread samples of wrap parameters over the widest box that fitting tries."""
    lower, upper = box(max(NARROWER))
    return lower + (upper - lower) * hammersley(count)


def _beside_opensim(
    subject: Subject,
    group: str,
    muscles: Sequence[str],
    paths: Sequence[PosedPath],
    poses: Poses,
    quick: bool,
) -> tuple[list[Metric], float, float]:
    """Measure both; give also the seconds of one geodesic analysis, and those of compiling it."""
    samples = samples_in_the_box(SAMPLES)
    judged = _judge(subject, muscles, poses, samples[:: OPENSIM_STEP[group]])
    counted = f"{len(muscles)} muscles, {POSES} poses"
    metrics = [
        Metric(
            f"engine/{group}/opensim",
            1e6 * judged.seconds,
            "us",
            "lower",
            f"an analysis; {counted}, every {OPENSIM_STEP[group]}th sample, one process",
            INFORMATION,
        ),
        Metric(
            f"engine/{group}/opensim_plain",
            1e6 * judged.plain_seconds,
            "us",
            "lower",
            f"an analysis by computeMomentArm, posing not counted; {PLAIN_POSES} poses",
            INFORMATION,
        ),
    ]
    seconds, compiling = {}, {}
    for wrapping in (GEODESIC, PARITY):
        name = f"{group}/{wrapping.name}"

        def wrap_all(wrapping=wrapping):
            return [wrap_at_samples(path, _for_all_wraps(path, samples), wrapping) for path in paths]

        began = time.perf_counter()
        found = wrap_all()
        first = time.perf_counter() - began
        steady = median_seconds({name: wrap_all}, repeats=1 if quick else 5)[name]
        seconds[name] = steady / (len(muscles) * POSES * SAMPLES)
        compiling[name] = max(first - steady, 0.0)
        metrics += [
            Metric(f"engine/{name}", 1e6 * seconds[name], "us", "lower", f"an analysis; {SAMPLES} samples"),
            Metric(f"engine/{name}/compile", compiling[name], "s", "lower", "the first call over later ones"),
            Metric(
                f"engine/{name}/opensim_slower",
                judged.seconds / seconds[name],
                "x",
                "higher",
                f"its time over ours; target at least {SPEED_TARGETS[name]}",
            ),
            Metric(
                f"engine/{name}/opensim_plain_slower",
                judged.plain_seconds / seconds[name],
                "x",
                "higher",
                "its time by computeMomentArm, over ours",
            ),
        ]
        if wrapping is PARITY:
            ours = np.stack([path.length[:: OPENSIM_STEP[group]] for path in found], axis=-1)
            difference = float(np.abs(ours - judged.length).max())
            metrics.append(
                Metric(
                    f"engine/{name}/length_max",
                    1e3 * difference,
                    "mm",
                    "lower",
                    "difference from OpenSim",
                    negligible=1e-6,
                )
            )
    return metrics, seconds[f"{group}/geodesic"], compiling[f"{group}/geodesic"]


def _for_all_wraps(path: PosedPath, samples: Samples) -> Float[np.ndarray, "sample wrap wrap_parameter"]:
    """Give every cylinder of a path the same parameters."""
    return np.repeat(samples[:, None], path.surfaces.radius.shape[0], axis=1)


def _judge(subject: Subject, muscles: Sequence[str], poses: Poses, samples: Samples) -> Judged:
    model = describe_model(subject.model_file)
    coordinates = subject.trials.moment_coordinates
    spans = {name: tuple(own for own in model.spanned_by(name) if own in coordinates) for name in muscles}
    wraps = {entry.wrap for name in muscles for entry in model.muscle(name).wraps}
    opensim = PathEngine(subject.model_file, coordinates, spans)
    opensim.analyse(poses[:2])
    began = time.perf_counter()
    lengths = []
    for sample in samples:
        opensim.place(dict.fromkeys(wraps, sample))
        lengths.append(opensim.analyse(poses)[0])
    taken = time.perf_counter() - began
    plain = plain_seconds(subject.model_file, coordinates, spans, poses[:: POSES // PLAIN_POSES])
    return Judged(np.stack(lengths), taken / (len(samples) * len(poses) * len(muscles)), plain)


def _all_analyses(paths: Sequence[PosedPath]) -> float:
    """Do all of them and keep what a surrogate is fitted to; give the seconds taken."""
    samples = samples_in_the_box(ALL_SAMPLES)
    kept = []
    began = time.perf_counter()
    for path in paths:
        found = wrap_at_samples(path, _for_all_wraps(path, samples), GEODESIC)
        kept.append((found.length, found.moment_arm))
    return time.perf_counter() - began


def _peak_memory_gb() -> float:
    # Linux counts in KiB, macOS in bytes.
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e9
