"""Accuracy of moment arms after PGA for displaced wraps and noisy EMG.

``python -m validation.calibration.hidden_wraps --subjects 20 --emg-noise 0.10`` simulates persons with the
simulator of the blind bank, which is independent of the package (`validation.blind.hidden_wraps`): OpenSim's
paths, Millard's curves, noise of EMG and of moments. Their cylinders differ from those of the model file.
Each person is calibrated by NGA and by PGA with the exact engine, and moment arms over all recorded cycles,
with nominal cylinders (as in NGA) and with those of PGA, are compared with the true ones.

A moment arm counts as touched if the displacement of the cylinders changed it by `MINIMUM_ERROR` (mean over
frames) and its muscle wraps round a cylinder that PGA frees. A touched arm is identifiable if, with moment
noise of `NOISE` and all free variables, the Laplace approximation at the true cylinders gives a standard
deviation below a tenth of the error of the nominal arm: the rule of the test without noise. Errors are root
mean squares over arms, cycles and frames. A person without such an arm counts as one whose error did not
decrease.

With ``--tasks`` each person also does four passive rotations and isometric ramps at three angles of hip, knee
and ankle in both directions (`validation.blind.dynamometer`), and is calibrated to all of it. Moment arms are
compared over the gait cycles in either case. The distance of the cylinders from the true ones, before and
after, stands beside its bound (`validation.calibration.wrap_bounds`).

Persons and results are stored in ``--place`` and reused. Use another folder for another version of the
package.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.machine import commit, describe_machine, pin_threads, versions
from validation.calibration.wrap_bounds import (
    bound_of_distance,
    distance_to_truth,
    simulated,
    true_changes,
)
from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax

if TYPE_CHECKING:
    from wrapjax.calibration.calibration import Calibration
    from wrapjax.model.freedom import FreedWraps
    from wrapjax.path_sources.exact import ExactGeometry
    from wrapjax.subject.subject import Subject

#: Moment noise, N m, for which arms count as identifiable.
NOISE = 0.003
#: Families of curves and activation dynamics of the simulator.
CURVES = ("millard", "thelen", "spline")
#: Keys of results for identifiable and for all touched arms, with their descriptions.
_KINDS = {"told": "identifiable", "touched": "touched"}
_USES = ("calibration", "validation")


@dataclass(frozen=True)
class Question:
    """Person to simulate and calibration to evaluate.

    Parameters
    ----------
    seed
        Number of the person.
    emg_noise
        Noise as a share of the envelopes.
    curves
        One of `CURVES`.
    starts
        Starts of each calibration.
    prior
        Prior standard deviation of cylinder translations, m along each axis; None: that of the package.
    tasks
        Whether the person also does trials of a dynamometer.
    """

    seed: int
    emg_noise: float
    curves: str = CURVES[0]
    starts: int = 1
    prior: float | None = None
    tasks: bool = False

    @property
    def person(self) -> str:
        """Name of the person's folder."""
        return f"{self.curves}_{self.emg_noise:g}_{self.seed:03d}{'_tasks' if self.tasks else ''}"

    @property
    def result(self) -> str:
        """Name of the result file."""
        prior = "" if self.prior is None else f"_prior_{self.prior:g}"
        return f"{self.person}_starts_{self.starts}{prior}.json"


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    set_up_jax()
    seeds = range(options.seed, options.seed + options.subjects)
    asked = [
        Question(seed, options.emg_noise, options.curves, options.starts, options.prior, options.tasks)
        for seed in seeds
    ]
    with tempfile.TemporaryDirectory() as spare:
        found = evaluate_all(asked, options.place or Path(spare))
    totals = summary(found)
    print("\n".join(lines(totals)))
    if options.out:
        from wrapjax.io.files import write_json

        about = {
            "schema": 1,
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "asked": {key: value for key, value in vars(asked[0]).items() if key != "seed"},
            "seeds": [seeds.start, seeds.stop],
            "commit": commit(),
            "machine": describe_machine(),
            "versions": versions(),
        }
        write_json(options.out, about | {"summary": totals, "people": found})
    return 0


def evaluate_all(asked: Sequence[Question], place: Path) -> list[dict[str, Any]]:
    """Return the results of all persons, reading those that are stored."""
    place.mkdir(parents=True, exist_ok=True)
    results = []
    for number, one in enumerate(asked, 1):
        began = time.perf_counter()
        file = place / one.result
        stored = file.exists()
        if stored:
            result = json.loads(file.read_text(encoding="utf-8"))
        else:
            result = evaluate(one, place)
            clear_caches_near_map_limit()
        results.append(result)
        how = "stored" if stored else f"{time.perf_counter() - began:.0f} s"
        print(f"{number}/{len(asked)} {describe(result)} ({how})", file=sys.stderr, flush=True)
    return results


def evaluate(asked: Question, place: Path) -> dict[str, Any]:
    """Simulate a person unless stored, calibrate, evaluate, and store the result."""
    import wrapjax
    from wrapjax.io.files import write_json

    folder = simulated(asked.person, asked.seed, asked.emg_noise, place, asked.curves, tasks=asked.tasks)
    subject = wrapjax.load_subject(folder / "subject")
    geometry = wrapjax.exact_geometry(subject)
    before = wrapjax.calibrate(subject, "NGA", geometry, starts=asked.starts)
    freedom = geometry.freedom("PGA", subject)
    if asked.prior is not None:
        freedom = replace(freedom, wraps=with_prior(freedom.wraps, asked.prior))
    after = wrapjax.calibrate(subject, "PGA", geometry, freedom, starts=asked.starts)
    result = {
        "asked": vars(asked),
        "moments_Nm": {"NGA": moment_errors(before), "PGA": moment_errors(after)},
        "converged": {"NGA": before.status.converged, "PGA": after.status.converged},
        "seconds": {"NGA": before.result.solve_seconds, "PGA": after.result.solve_seconds},
        **compare_with_truth(subject, geometry, after, folder),
    }
    write_json(place / asked.result, result)
    return dict(json.loads((place / asked.result).read_text(encoding="utf-8")))


def with_prior(wraps: FreedWraps | None, distance: float) -> FreedWraps:
    """Set the prior standard deviation of cylinder translations (m); rotations and radii keep theirs."""
    if wraps is None:
        raise ValueError("no cylinder is free")
    along = [name.startswith("translation") for name in wraps.quantities]
    return replace(wraps, prior_sd=np.where(along, distance, wraps.prior_sd))


def moment_errors(done: Calibration) -> dict[str, float]:
    """Mean absolute moment error (N m) over coordinates and frames of gait, by what cycles are used for."""
    result = done.result
    gait = done.subject.trials.is_gait
    error = np.abs(result.measured - result.modelled)[gait].mean(axis=(1, 2))
    uses = np.array(result.uses)[gait]
    return {use: float(error[uses == use].mean()) for use in _USES}


def compare_with_truth(
    subject: Subject, geometry: ExactGeometry, done: Calibration, folder: Path
) -> dict[str, Any]:
    """Compare moment arms and cylinders of a calibration with the true ones beside the subject folder."""
    import jax.numpy as jnp

    from wrapjax.calibration.problem import build_objective
    from wrapjax.calibration.uncertainty.identifiability import moment_arm_deviation
    from wrapjax.subject.gait_alone import with_gait_alone

    result = done.result
    wraps, moving = result.freedom.wraps, result.freedom.moving_paths
    assert wraps is not None and moving is not None, "PGA frees cylinders"
    with np.load(folder / "truth.npz") as truth:
        names, columns = truth["muscles"].tolist(), truth["coordinates"].tolist()
        rows = [names.index(name) for name in result.muscles]
        places = [columns.index(name) for name in result.coordinates]
        # Axes as in calibrations: muscle, cycle, coordinate, frame.
        true, undisplaced = (
            np.swapaxes(truth[name][:, rows][:, :, places], 0, 1) for name in ("arms", "undisplaced")
        )
    gait = subject.trials.is_gait
    nominal, found = (
        np.asarray(states.path.moment_arm)[:, gait] for states in (result.initial_states, result.states)
    )
    true_wraps = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["wraps"]
    problem = build_objective(subject, "PGA", geometry, result.freedom)
    changes = jnp.asarray(true_changes(wraps, true_wraps))
    tree = replace(problem.variables.base, path_changes=changes)
    at_truth = np.asarray(problem.start(tree))
    gait_alone = with_gait_alone(subject, "the identifiability of arms")
    walking = build_objective(gait_alone, "PGA", geometry, result.freedom)
    deviation = moment_arm_deviation(walking, np.asarray(walking.start(tree)), NOISE).mean(axis=(1, 3))
    touched, identifiable_arms = identifiable_and_touched(true, undisplaced, nominal, deviation, moving)
    names_of = [(muscle, coordinate) for muscle in result.muscles for coordinate in result.coordinates]
    return {
        "told": arm_errors(true, nominal, found, identifiable_arms),
        "touched": arm_errors(true, nominal, found, touched),
        "arms": {
            f"{names_of[at][0]} about {names_of[at][1]}": {
                "told": bool(identifiable_arms.ravel()[at]),
                "deviation_m": float(deviation.ravel()[at]),
                **arm_errors(true, nominal, found, np.arange(touched.size).reshape(touched.shape) == at),
            }
            for at in np.flatnonzero(touched)
        },
        "distance": distance_to_truth(wraps, true_wraps, np.asarray(result.parameters.path_changes))
        | {"bound": bound_of_distance(problem, at_truth, subject, wraps)},
        "wraps": {
            name: {"true": true_wraps[name], "found_change": change.tolist(), "largest_change": most.tolist()}
            for name, change, most in zip(
                wraps.names,
                wraps.changes_of(np.asarray(result.parameters.path_changes)),
                wraps.upper,
                strict=True,
            )
        },
    }


def identifiable_and_touched(
    true: np.ndarray,
    undisplaced: np.ndarray,
    nominal: np.ndarray,
    deviation: np.ndarray,
    moving: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Find touched arms, and those of them that are identifiable: (muscle, coordinate) each.

    Parameters
    ----------
    true, undisplaced, nominal
        Moment arms (m), (muscle, cycle, coordinate, frame): true, before the displacement, and nominal.
    deviation
        Posterior standard deviation of the moment arms (m), (muscle, coordinate).
    moving
        Whether the path of a muscle can change, (muscle,).
    """
    from wrapjax.demonstration.wrap_recovery import MINIMUM_ERROR, identifiable

    def mean_difference(others: np.ndarray) -> np.ndarray:
        return np.abs(others - true).mean(axis=(1, 3))

    touched = (mean_difference(undisplaced) > MINIMUM_ERROR) & moving[:, None]
    return touched, touched & identifiable(mean_difference(nominal), deviation)


def arm_errors(
    true: np.ndarray, before: np.ndarray, after: np.ndarray, chosen: np.ndarray
) -> dict[str, float | int | None]:
    """Compute root mean square errors (m) over chosen arms (muscle, coordinate), and their ratio."""
    if not chosen.any():
        return {"arms": 0, "before_m": None, "after_m": None, "ratio": None}
    one, other = (
        float(np.sqrt(np.mean(np.swapaxes(arms - true, 1, 2)[chosen] ** 2))) for arms in (before, after)
    )
    return {"arms": int(chosen.sum()), "before_m": one, "after_m": other, "ratio": other / one}


def summary(people: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarize the decrease of moment arm errors, and mean moment errors (N m)."""
    return {kind: decrease([one[kind]["ratio"] for one in people]) for kind in _KINDS} | {
        "moments_Nm": {
            method: {use: float(np.mean([one["moments_Nm"][method][use] for one in people])) for use in _USES}
            for method in ("NGA", "PGA")
        },
        "distance": decrease([one["distance"]["ratio"] for one in people])
        | {
            "bound_ratio": float(
                np.median([one["distance"]["bound"] / one["distance"]["before"] for one in people])
            ),
            "over_bound": float(
                np.median([one["distance"]["after"] / one["distance"]["bound"] for one in people])
            ),
        },
        "converged": sum(one["converged"]["PGA"] for one in people),
    }


def decrease(ratios: Sequence[float | None]) -> dict[str, Any]:
    """Count ratios below one and compute their median, with distribution-free 95 % intervals.

    None stands for a person without an arm to evaluate: it counts as no decrease, and not for the median.
    """
    from scipy.stats import binomtest, quantile_test

    known = np.array([one for one in ratios if one is not None], dtype=float)
    count = int((known < 1.0).sum())
    share = binomtest(count, len(ratios)).proportion_ci(0.95)
    median = quantile_test(known, p=0.5).confidence_interval(0.95) if known.size else (None, None)
    return {
        "fallen": count,
        "of": len(ratios),
        "share_interval": [float(share.low), float(share.high)],
        "judged": int(known.size),
        "median_ratio": float(np.median(known)) if known.size else None,
        "median_interval": [None if end is None or np.isnan(end) else float(end) for end in median],
    }


def describe(result: Mapping[str, Any]) -> str:
    """Describe the result of a person in one line."""
    moments = result["moments_Nm"]
    shown = [f"seed {result['asked']['seed']}:"]
    for kind in _KINDS:
        own = result[kind]
        errors = (
            "none"
            if own["ratio"] is None
            else (f"{1e3 * own['before_m']:.2f} -> {1e3 * own['after_m']:.2f} mm ({own['ratio']:.2f})")
        )
        shown.append(f"{_KINDS[kind]} {own['arms']} arms {errors};")
    own = result["distance"]
    shown.append(f"cylinders {own['before']:.2f} -> {own['after']:.2f} SD, bound {own['bound']:.2f};")
    for use in _USES:
        shown.append(f"{use} {moments['NGA'][use]:.2f} -> {moments['PGA'][use]:.2f} N m")
    return " ".join(shown)


def lines(totals: Mapping[str, Any]) -> list[str]:
    """Format a summary, one line for each quantity."""
    shown = []
    for kind, what in zip(_KINDS, ("identifiable arms", "all touched arms"), strict=True):
        own = totals[kind]
        ratio = "" if own["median_ratio"] is None else f", median ratio {own['median_ratio']:.2f}"
        ends = [end for end in own["median_interval"] if end is not None]
        interval = f" ({ends[0]:.2f} to {ends[1]:.2f})" if len(ends) == 2 else ""
        shown.append(f"{what}: errors decrease in {own['fallen']} of {own['of']}{ratio}{interval}")
    own = totals["distance"]
    shown.append(
        f"distance of cylinders from the true ones: decreases in {own['fallen']} of {own['of']}, "
        f"median ratio {own['median_ratio']:.2f}; bound {own['bound_ratio']:.2f}; "
        f"{own['over_bound']:.2f} times the bound"
    )
    for use in _USES:
        nga, pga = (totals["moments_Nm"][method][use] for method in ("NGA", "PGA"))
        shown.append(f"{use} cycles: NGA {nga:.2f}, PGA {pga:.2f} N m ({100 * (pga / nga - 1):+.1f} %)")
    return shown


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.calibration.hidden_wraps", description=__doc__
    )
    parser.add_argument(
        "--subjects", type=int, default=20, metavar="N", help="number of persons (default: 20)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="number of the first person (default: 0)"
    )
    parser.add_argument(
        "--emg-noise", type=float, default=0.10, metavar="SHARE", help="EMG noise (default: 0.10)"
    )
    parser.add_argument("--curves", choices=CURVES, default=CURVES[0], help=f"default: {CURVES[0]}")
    parser.add_argument(
        "--starts", type=int, default=1, metavar="N", help="starts of each calibration (default: 1)"
    )
    parser.add_argument(
        "--prior",
        type=float,
        metavar="M",
        help="prior SD of cylinder translations (default: that of the package)",
    )
    parser.add_argument("--tasks", action="store_true", help="also trials of a dynamometer")
    parser.add_argument("--place", type=Path, metavar="DIR", help="folder of stored persons and results")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file to write the results to")
    return parser


if __name__ == "__main__":
    sys.exit(main())
