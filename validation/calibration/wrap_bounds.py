"""How near moments can bring wrapping cylinders to the true ones, by walking, and with other trials.

``python -m validation.calibration.wrap_bounds --subjects 20`` simulates persons with displaced cylinders
(`validation.blind.hidden_wraps`), who also do trials of a dynamometer (`validation.blind.dynamometer`). The
distance of cylinders from the true ones is the root mean square of their parameters in standard deviations of
the displacements. Its bound is the one that the Fisher information of the moments (with `MOMENT_NOISE` in
each effective sample) and the priors of all free parameters leave at the true cylinders, by van Trees'
inequality (van Trees 1968, Detection, Estimation, and Modulation Theory, part I, section 2.4). Nothing is
calibrated.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.machine import pin_threads
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.calibration.objective import Objective
    from wrapjax.model.freedom import FreedWraps
    from wrapjax.subject.subject import Subject

#: Noise of the moments in each effective sample, N m.
MOMENT_NOISE = 3.0
#: Noise of the simulated EMG, as a share of the envelopes.
EMG_NOISE = 0.1


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    set_up_jax()
    seeds = range(options.seed, options.seed + options.subjects)
    with tempfile.TemporaryDirectory() as spare:
        found = [bounds(seed, options.place or Path(spare)) for seed in seeds]
    print("\n".join(lines(found)))
    return 0


def simulated(
    person: str, seed: int, emg_noise: float, place: Path, curves: str = "millard", *, tasks: bool
) -> Path:
    """Simulate a person with displaced cylinders unless stored, and return the folder."""
    from validation.blind.hidden_wraps import hidden_wraps, write_hidden

    folder = place / person
    if not folder.exists():
        place.mkdir(parents=True, exist_ok=True)
        write_hidden(hidden_wraps(seed, curves), seed, emg_noise, folder, tasks=tasks)
    return folder


def bounds(seed: int, place: Path) -> dict[str, float]:
    """Compute the distance of the nominal cylinders, and its bounds by walking alone and by all trials."""
    import jax.numpy as jnp

    import wrapjax
    from wrapjax.calibration.problem import build_objective
    from wrapjax.subject.gait_alone import with_gait_alone

    folder = simulated(f"millard_{EMG_NOISE:g}_{seed:03d}_tasks", seed, EMG_NOISE, place, tasks=True)
    subject = wrapjax.load_subject(folder / "subject")
    geometry = wrapjax.exact_geometry(subject)
    freedom = geometry.freedom("PGA", subject)
    assert freedom.wraps is not None, "PGA frees cylinders"
    true_wraps = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["wraps"]
    changes = true_changes(freedom.wraps, true_wraps)
    found = {"before": distance_to_truth(freedom.wraps, true_wraps, np.zeros_like(changes))["before"]}
    for name, trials in (("walking", with_gait_alone(subject, "the bound")), ("all", subject)):
        problem = build_objective(trials, "PGA", geometry, freedom)
        tree = replace(problem.variables.base, path_changes=jnp.asarray(changes))
        variables = np.asarray(problem.start(tree))
        found[name] = bound_of_distance(problem, variables, trials, freedom.wraps)
    print(f"seed {seed}: " + ", ".join(f"{key} {value:.3f}" for key, value in found.items()), flush=True)
    return found


def lines(people: Sequence[Mapping[str, float]]) -> list[str]:
    """Format the medians of the bounds, and their ratios to the distance of the nominal cylinders."""
    columns = {key: np.array([one[key] for one in people]) for key in ("before", "walking", "all")}
    medians = ", ".join(f"{key} {np.median(values):.2f}" for key, values in columns.items())
    shares = ", ".join(
        f"{key} {np.median(columns[key] / columns['before']):.2f}" for key in ("walking", "all")
    )
    return [f"median distance and bounds (SD): {medians}", f"median bound over distance: {shares}"]


def _displacements() -> np.ndarray:
    """Return the standard deviations of displacements, in the order of a cylinder's parameters."""
    from validation.blind.hidden_wraps import PLACE, RADIUS, TURN

    return np.array([PLACE, PLACE, PLACE, TURN, TURN, RADIUS])


def distance_to_truth(
    wraps: FreedWraps, true_wraps: Mapping[str, Sequence[float]], found: np.ndarray
) -> dict[str, float]:
    """Compute the distance of the cylinders from the true ones, in standard deviations of displacements."""
    from wrapjax.geometry.exact_paths.wrapping import NOMINAL

    true = np.stack([np.array(true_wraps[name]) - NOMINAL for name in wraps.names]) / _displacements()
    after = wraps.changes_of(found) / _displacements()
    distances = [float(np.sqrt(np.mean(one**2))) for one in (true, after - true)]
    return {"before": distances[0], "after": distances[1], "ratio": distances[1] / distances[0]}


def bound_of_distance(
    problem: Objective, variables: np.ndarray, subject: Subject, wraps: FreedWraps
) -> float:
    """Compute the least root mean square distance of the cylinders, in standard deviations of displacements.

    Parameters
    ----------
    problem, variables
        Calibration with free cylinders, and its variables at the true cylinders.
    subject
        Subject, whose calibration trials count by their effective samples.
    wraps
        Free cylinders; a parameter that is held stays as far away as it is.
    """
    import equinox as eqx
    import jax.numpy as jnp

    from wrapjax.calibration.objective import MOMENT_ERROR
    from wrapjax.calibration.sample_weights import samples_by_recording

    layout = problem.variables
    rows = np.asarray(eqx.filter_jit(problem.moment_jacobian)(jnp.asarray(variables)))
    samples = sum(samples_by_recording(subject.trials.used_for("calibration")).values())
    # Rows are in allowable errors, weighted by the samples that they stand for: their squares are a mean.
    information = samples * (MOMENT_ERROR / MOMENT_NOISE) ** 2 * rows.T @ rows
    width = np.asarray(layout.upper) - np.asarray(layout.lower)
    precision = np.where(layout.prior_precision > 0.0, layout.prior_precision, 1.0 / width)
    by_place = np.asarray(layout.index)[:, -layout.modes :].reshape(*wraps.places.shape, -1)
    numbers = np.stack([by_place[wraps.places == wrap][0] for wrap in range(len(wraps.names))])
    ratio = wraps.scale / _displacements()
    free = numbers < layout.count
    precision[numbers[free]] = ratio[free]
    covariance = np.linalg.inv(information + np.diag(precision**2))
    variance = np.ones(numbers.shape)
    variance[free] = np.diag(covariance)[numbers[free]] * ratio[free] ** 2
    return float(np.sqrt(variance.mean()))


def true_changes(wraps: FreedWraps, true_wraps: Mapping[str, Sequence[float]]) -> np.ndarray:
    """Return true wrap parameters as path changes: (muscle, mode), differences from nominal."""
    from wrapjax.geometry.exact_paths.wrapping import NOMINAL

    moved = np.stack([np.array(true_wraps[name]) - NOMINAL for name in wraps.names])
    changes = np.where((wraps.places >= 0)[..., None], moved[wraps.places], 0.0)
    return changes.reshape(len(changes), -1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.calibration.wrap_bounds", description=__doc__)
    parser.add_argument(
        "--subjects", type=int, default=20, metavar="N", help="number of persons (default: 20)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="number of the first (default: 0)")
    parser.add_argument("--place", type=Path, metavar="DIR", help="folder of stored persons")
    return parser


if __name__ == "__main__":
    sys.exit(main())
