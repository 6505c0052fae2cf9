"""The same code on every device of this machine: how fast, and whether a GPU says what the processor says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.batching import batched
from benchmarks.case import Case
from benchmarks.engine import POSES, SAMPLES, samples_in_the_box, wrapping_muscles
from benchmarks.metric import Metric
from benchmarks.tiled import another_person
from benchmarks.timing import median_seconds
from wrapjax.calibration.objective import Objective
from wrapjax.geometry.engine import PosedPath, wrap_at_samples
from wrapjax.subject.subject import Subject

#: People of one shape in one batch.
PEOPLE = 32
#: How far a GPU may be from the processor, relative to the largest number of each array.
TARGET = 1e-9
#: How many times as fast a batch on a GPU is as one after the other.
BATCH_TARGET = 3
_REPEATS = 5


def devices(subject: Subject, case: Case) -> list[Metric]:
    """Time paths, a linearization and a batch of people on the processor, and on a GPU if there is one.

    Parameters
    ----------
    subject
        Whose wrapped muscles are laid, in poses of its gait and at samples over the box of fitting.
    case
        Its NGA problem.
    """
    engine, poses = wrapping_muscles(subject)
    posed = engine.posed(poses)
    paths = [posed[name] for name in engine.muscles if len(engine.wraps_of(name)) == 1]
    kinds = {"cpu": jax.devices("cpu")[0]}
    try:
        kinds["gpu"] = jax.devices("gpu")[0]
    except RuntimeError:
        missing = Metric("devices/gpu", np.nan, "x", "higher", "no GPU on this machine", np.inf)
    found = {kind: _on(device, paths, case) for kind, device in kinds.items()}
    metrics = [metric for kind in kinds for metric in found[kind][1]]
    if "gpu" not in kinds:
        return [*metrics, missing]
    for name, here in found["cpu"][0].items():
        metrics.append(
            Metric(
                f"devices/gpu/{name}/difference",
                _difference(found["gpu"][0][name], here),
                "1",
                "lower",
                f"from the processor, of the largest number of each array; target at most {TARGET:g}",
                negligible=TARGET,
            )
        )
    return metrics


def on_device(device: jax.Device, tree: Any) -> Any:
    """Put all arrays of a tree on a device."""
    return jax.tree.map(lambda leaf: jax.device_put(leaf, device) if eqx.is_array_like(leaf) else leaf, tree)


def _on(device: jax.Device, paths: list[PosedPath], case: Case) -> tuple[dict[str, Any], list[Metric]]:
    """Give what is calculated on a device, and how long it takes there."""
    with jax.default_device(device):
        paths = on_device(device, paths)
        people = [on_device(device, another_person(case.problem, seed)) for seed in range(PEOPLE)]
        points = [on_device(device, person.variables.start()) for person in people]
        linearize = eqx.filter_jit(_linearized)
        together, stacked = batched(_linearized, people), jnp.stack(points)
        samples = samples_in_the_box(SAMPLES)[:, None]
        calls: dict[str, Callable[[], Any]] = {
            "engine": lambda: [wrap_at_samples(path, samples) for path in paths],
            "linearization": lambda: linearize(people[0], points[0]),
            "in_turn": lambda: [linearize(*one) for one in zip(people, points, strict=True)],
            "together": lambda: together(stacked),
        }
        found = {name: calls[name]() for name in ("engine", "linearization", "together")}
        seconds = median_seconds(calls, _REPEATS)
    kind = device.platform
    analyses = len(paths) * POSES * SAMPLES
    return found, [
        Metric(
            f"devices/{kind}/engine",
            1e6 * seconds["engine"] / analyses,
            "us",
            "lower",
            f"an analysis, {len(paths)} muscles of one cylinder, {POSES} poses, {SAMPLES} samples",
        ),
        Metric(f"devices/{kind}/linearization", 1e3 * seconds["linearization"], "ms", "lower", case.size),
        Metric(
            f"devices/{kind}/person",
            1e3 * seconds["together"] / PEOPLE,
            "ms",
            "lower",
            f"a linearization of one of {PEOPLE} people in one program",
        ),
        Metric(
            f"devices/{kind}/in_turn_over_vmap",
            seconds["in_turn"] / seconds["together"],
            "x",
            "higher",
            f"the same one after the other over all together; target on a GPU at least {BATCH_TARGET}",
        ),
    ]


def _linearized(problem: Objective, variables: Any) -> Any:
    return problem.linearize(variables)


def _difference(found: Any, expected: Any) -> float:
    """Largest relative difference of two trees, each array by its largest number."""
    worst = 0.0
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        here, there = np.asarray(other, dtype=float), np.asarray(one, dtype=float)
        size = np.abs(here[np.isfinite(here)]).max(initial=0.0) or 1.0
        same = (here == there) | (np.isnan(here) & np.isnan(there))
        worst = max(worst, float(np.where(same, 0.0, np.abs(there - here)).max(initial=0.0) / size))
    return worst
