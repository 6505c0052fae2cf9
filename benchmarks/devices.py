"""Speed on every device of this machine, and differences of GPU results from those of the processor."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.batching import batched
from benchmarks.case import Case
from benchmarks.engine import POSES, SAMPLES, wrap_parameter_samples, wrapping_muscles
from benchmarks.metric import Metric
from benchmarks.tiled_problems import perturb_problem
from benchmarks.timing import median_seconds
from benchmarks.wrap_surfaces import KINDS, swept_path
from validation.wrapping.single_path import COORDINATES, write_model
from wrapjax.calibration.objective import Objective
from wrapjax.geometry.exact_paths.engine import PosedPath, wrap_at_samples
from wrapjax.path_sources.muscle_paths import PosedMuscles, muscle_paths
from wrapjax.subject.subject import Subject

#: Subjects of one shape in one batch.
SUBJECTS = 32
#: Largest allowed difference of a GPU from the processor, relative to the largest number of each array.
TARGET = 1e-9
#: Least speed-up of a batch on a GPU over the same problems in turn.
BATCH_TARGET = 3
#: Poses of a path round one surface of each kind.
SURFACE_POSES = 10_000
_REPEATS = 5


def devices(subject: Subject, case: Case) -> list[Metric]:
    """Time paths, a linearization and a batch of subjects on the processor, and on a GPU if there is one.

    Parameters
    ----------
    subject
        Subject whose wrapped muscle paths are computed, in poses of its gait and at wrap parameters sampled
        over the box that fitting uses.
    case
        NGA problem of the subject.
    """
    engine, poses = wrapping_muscles(subject)
    posed = engine.posed(poses)
    paths = [posed[name] for name in engine.muscles if len(engine.wraps_of(name)) == 1]
    surfaces = {kind: path_round(kind) for kind in KINDS}
    kinds = {"cpu": jax.devices("cpu")[0]}
    try:
        kinds["gpu"] = jax.devices("gpu")[0]
    except RuntimeError:
        missing = Metric("devices/gpu", np.nan, "x", "higher", "no GPU on this machine", np.inf)
    by_kind = {kind: _measure(device, paths, surfaces, case) for kind, device in kinds.items()}
    metrics = [metric for kind in kinds for metric in by_kind[kind][1]]
    if "gpu" not in kinds:
        return [*metrics, missing]
    for name, here in by_kind["cpu"][0].items():
        metrics.append(
            Metric(
                f"devices/gpu/{name}/difference",
                _difference(by_kind["gpu"][0][name], here),
                "1",
                "lower",
                f"from the processor, relative to the largest entry of each array; target at most {TARGET:g}",
                negligible=TARGET,
            )
        )
    return metrics


def on_device(device: jax.Device, tree: Any) -> Any:
    """Put all arrays of a tree on a device."""
    return jax.tree.map(lambda leaf: jax.device_put(leaf, device) if eqx.is_array_like(leaf) else leaf, tree)


def path_round(kind: str, seed: int = 1) -> PosedMuscles:
    """Draw the shortest path round one unrestricted surface in `SURFACE_POSES` poses."""
    surface, poses = swept_path(kind, SURFACE_POSES, seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.osim"
        write_model([surface], file)
        return muscle_paths(file, coordinates=COORDINATES).posed(poses)


def _measure(
    device: jax.Device, paths: list[PosedPath], surfaces: dict[str, PosedMuscles], case: Case
) -> tuple[dict[str, Any], list[Metric]]:
    """Compute and time everything on a device; return the results by name, and the metrics."""
    with jax.default_device(device):
        paths = on_device(device, paths)
        problems = [on_device(device, perturb_problem(case.problem, seed)) for seed in range(SUBJECTS)]
        points = [on_device(device, problem.variables.start()) for problem in problems]
        linearize = eqx.filter_jit(_linearized)
        together, stacked = batched(_linearized, problems), jnp.stack(points)
        samples = wrap_parameter_samples(SAMPLES)[:, None]
        calls: dict[str, Callable[[], Any]] = {
            "engine": lambda: [wrap_at_samples(path, samples) for path in paths],
            "linearization": lambda: linearize(problems[0], points[0]),
            "in_turn": lambda: [linearize(*one) for one in zip(problems, points, strict=True)],
            "together": lambda: together(stacked),
        }
        evaluate = eqx.filter_jit(lambda posed: posed())
        for name, posed in surfaces.items():
            calls[name] = partial(evaluate, on_device(device, posed))
        results = {name: calls[name]() for name in ("engine", "linearization", "together", *surfaces)}
        seconds = median_seconds(calls, _REPEATS)
    kind = device.platform
    analyses = len(paths) * POSES * SAMPLES
    return results, [
        Metric(
            f"devices/{kind}/engine",
            1e6 * seconds["engine"] / analyses,
            "us",
            "lower",
            f"one analysis, {len(paths)} muscles round one cylinder, {POSES} poses, {SAMPLES} samples",
        ),
        *(
            Metric(
                f"devices/{kind}/{name}",
                1e6 * seconds[name] / SURFACE_POSES,
                "us",
                "lower",
                f"one shortest path with six moment arms round one {name}, {SURFACE_POSES} poses",
            )
            for name in surfaces
        ),
        Metric(f"devices/{kind}/linearization", 1e3 * seconds["linearization"], "ms", "lower", case.size),
        Metric(
            f"devices/{kind}/person",
            1e3 * seconds["together"] / SUBJECTS,
            "ms",
            "lower",
            f"a linearization of one of {SUBJECTS} subjects in one program",
        ),
        Metric(
            f"devices/{kind}/in_turn_over_vmap",
            seconds["in_turn"] / seconds["together"],
            "x",
            "higher",
            f"time of linearizations in turn over time in one program; GPU target at least {BATCH_TARGET}",
        ),
    ]


def _linearized(problem: Objective, variables: Any) -> Any:
    return problem.linearize(variables)


def _difference(actual: Any, expected: Any) -> float:
    """Compute the largest difference of two trees, relative to the largest number of each array."""
    worst = 0.0
    for one, other in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        here, there = np.asarray(other, dtype=float), np.asarray(one, dtype=float)
        size = np.abs(here[np.isfinite(here)]).max(initial=0.0) or 1.0
        same = (here == there) | (np.isnan(here) & np.isnan(there))
        worst = max(worst, float(np.where(same, 0.0, np.abs(there - here)).max(initial=0.0) / size))
    return worst
