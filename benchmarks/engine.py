"""Speed of the exact path engine and of OpenSim on the same poses and wrap parameters.

One analysis is the length and all moment arms of one muscle, in one pose, for one sample of the wrap
parameters.
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
from benchmarks.opensim_moment_arms import compute_moment_arm_seconds
from benchmarks.timing import median_seconds
from wrapjax.geometry.exact_paths.engine import GEODESIC, PARITY, ExactPaths, PosedPath, wrap_at_samples
from wrapjax.geometry.surrogates.training_samples import random_poses
from wrapjax.geometry.surrogates.wrap_bounds import NARROWER_TRANSLATIONS, hammersley, parameter_box
from wrapjax.osim.model import describe_model
from wrapjax.osim.path_engine import PathEngine
from wrapjax.subject.subject import Subject

POSES = 500
#: Samples of the wrap parameters for all analyses; with all poses 500,000 analyses of each muscle.
ALL_SAMPLES = 1000
SAMPLES = 40
#: Number of poses in which OpenSim's `computeMomentArm` is timed.
PLAIN_POSES = 50
#: OpenSim is timed on every n-th sample: it takes much longer for paths round several cylinders.
OPENSIM_STEP = {"single": 10, "several": 20}
#: Least ratio of OpenSim's time to the engine's, by number of cylinders and way of wrapping.
SPEED_TARGETS = {"single/geodesic": 300, "single/parity": 300, "several/geodesic": 50, "several/parity": 5}
SECONDS_TARGET = 120
MEMORY_TARGET_GB = 3
SEED = 20

Poses = Float[np.ndarray, "pose coordinate"]
Samples = Float[np.ndarray, "sample wrap_parameter"]
Lengths = Float[np.ndarray, "sample pose muscle"]


class OpenSimAnalyses(NamedTuple):
    """Path lengths by OpenSim (m), time of one analysis (s), and its time by `computeMomentArm` (s)."""

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
        Run all analyses instead of extrapolating their time from fewer.
    """
    engine, poses = wrapping_muscles(subject)
    wrapped = engine.muscles
    began = time.perf_counter()
    posed = engine.posed(poses)
    posing = time.perf_counter() - began
    metrics = [Metric("engine/posing", posing, "s", "lower", f"{len(wrapped)} muscles, {POSES} poses")]

    single = [name for name in wrapped if len(engine.wraps_of(name)) == 1]
    groups = {"single": single, "several": [name for name in wrapped if name not in single]}
    total = posing
    for group, muscles in groups.items():
        if muscles:
            paths = [posed[name] for name in muscles]
            group_metrics, seconds, compiling = _compare_with_opensim(
                subject, group, muscles, paths, poses, quick
            )
            metrics += group_metrics
            total += compiling + seconds * POSES * ALL_SAMPLES * len(muscles)
    how = "extrapolated from fewer samples"
    if full:
        total, how = posing + _all_analyses(list(posed.values())), "measured; compiled before"
    return [
        *metrics,
        Metric(
            "engine/all_analyses",
            total,
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
            f"of this process so far{', all analyses kept' if full else ''}; target below {MEMORY_TARGET_GB}",
        ),
    ]


def wrapping_muscles(subject: Subject) -> tuple[ExactPaths, Poses]:
    """Build the engine of a subject's wrapped muscles and draw poses of its gait."""
    trials = subject.trials
    coordinates = trials.moment_coordinates
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    model = describe_model(subject.model_file)
    wrapped = [name for name in subject.muscles.names if model.muscle(name).wraps]
    poses = random_poses(angles, POSES, np.random.default_rng(SEED))
    return ExactPaths(model, wrapped, coordinates), poses


def wrap_parameter_samples(count: int) -> Samples:
    """Sample wrap parameters evenly over the widest box that fitting uses."""
    lower, upper = parameter_box(max(NARROWER_TRANSLATIONS))
    return lower + (upper - lower) * hammersley(count)


def _compare_with_opensim(
    subject: Subject,
    group: str,
    muscles: Sequence[str],
    paths: Sequence[PosedPath],
    poses: Poses,
    quick: bool,
) -> tuple[list[Metric], float, float]:
    """Time both; return the metrics and the seconds of one geodesic analysis and of compiling it."""
    samples = wrap_parameter_samples(SAMPLES)
    by_opensim = _analyse_by_opensim(subject, muscles, poses, samples[:: OPENSIM_STEP[group]])
    counted = f"{len(muscles)} muscles, {POSES} poses"
    metrics = [
        Metric(
            f"engine/{group}/opensim",
            1e6 * by_opensim.seconds,
            "us",
            "lower",
            f"one analysis; {counted}, every {OPENSIM_STEP[group]}th sample, one process",
            INFORMATION,
        ),
        Metric(
            f"engine/{group}/opensim_plain",
            1e6 * by_opensim.plain_seconds,
            "us",
            "lower",
            f"one analysis by computeMomentArm, without setting the pose; {PLAIN_POSES} poses",
            INFORMATION,
        ),
    ]
    seconds, compiling = {}, {}
    for wrapping in (GEODESIC, PARITY):
        name = f"{group}/{wrapping.name}"

        def wrap_all(wrapping=wrapping):
            return [wrap_at_samples(path, _for_all_wraps(path, samples), wrapping) for path in paths]

        began = time.perf_counter()
        wrapped_paths = wrap_all()
        first = time.perf_counter() - began
        steady = median_seconds({name: wrap_all}, repeats=1 if quick else 5)[name]
        seconds[name] = steady / (len(muscles) * POSES * SAMPLES)
        compiling[name] = max(first - steady, 0.0)
        metrics += [
            Metric(f"engine/{name}", 1e6 * seconds[name], "us", "lower", f"one analysis; {SAMPLES} samples"),
            Metric(f"engine/{name}/compile", compiling[name], "s", "lower", "first call minus later ones"),
            Metric(
                f"engine/{name}/opensim_slower",
                by_opensim.seconds / seconds[name],
                "x",
                "higher",
                f"time of OpenSim over time of the engine; target at least {SPEED_TARGETS[name]}",
            ),
            Metric(
                f"engine/{name}/opensim_plain_slower",
                by_opensim.plain_seconds / seconds[name],
                "x",
                "higher",
                "time of OpenSim's computeMomentArm over time of the engine",
            ),
        ]
        if wrapping is PARITY:
            ours = np.stack([path.length[:: OPENSIM_STEP[group]] for path in wrapped_paths], axis=-1)
            difference = float(np.abs(ours - by_opensim.length).max())
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
    """Repeat the samples for every wrap of a path."""
    return np.repeat(samples[:, None], path.surfaces.radius.shape[0], axis=1)


def _analyse_by_opensim(
    subject: Subject, muscles: Sequence[str], poses: Poses, samples: Samples
) -> OpenSimAnalyses:
    model = describe_model(subject.model_file)
    coordinates = subject.trials.moment_coordinates
    spans = {
        name: tuple(spanned for spanned in model.spanned_by(name) if spanned in coordinates)
        for name in muscles
    }
    wraps = {entry.wrap for name in muscles for entry in model.muscle(name).wraps}
    opensim = PathEngine(subject.model_file, coordinates, spans)
    opensim.analyse(poses[:2])
    began = time.perf_counter()
    lengths = []
    for sample in samples:
        opensim.place(dict.fromkeys(wraps, sample))
        lengths.append(opensim.analyse(poses)[0])
    taken = time.perf_counter() - began
    plain = compute_moment_arm_seconds(subject.model_file, coordinates, spans, poses[:: POSES // PLAIN_POSES])
    return OpenSimAnalyses(np.stack(lengths), taken / (len(samples) * len(poses) * len(muscles)), plain)


def _all_analyses(paths: Sequence[PosedPath]) -> float:
    """Time all analyses (s), keeping lengths and moment arms as the fit of a surrogate does."""
    samples = wrap_parameter_samples(ALL_SAMPLES)
    results = []
    began = time.perf_counter()
    for path in paths:
        found = wrap_at_samples(path, _for_all_wraps(path, samples), GEODESIC)
        results.append((found.length, found.moment_arm))
    return time.perf_counter() - began


def _peak_memory_gb() -> float:
    # Linux reports KiB, macOS bytes.
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e9
