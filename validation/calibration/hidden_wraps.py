"""How near PGA brings moment arms to the truth where cylinders are hidden and EMG is noisy.

``python -m validation.calibration.hidden_wraps --subjects 20 --emg-noise 0.10`` makes people with the blind bank's
simulator, which shares nothing with the package (`validation.blind.hidden_wraps`): OpenSim's paths, Millard's
curves, own noise of electrodes and of moments. Their cylinders are not where the model file has them. Each
is calibrated by NGA and by PGA through the exact engine, and moment arms are held against the simulator's
over all recorded cycles, round nominal cylinders (before, as NGA has them) and round those that PGA found.

An arm counts as touched where hiding the cylinders moved it by `MINIMUM_ERROR` (mean over frames) and its
muscle runs by a cylinder that PGA frees. Of these, arms and gains can be told apart where moment noise of
`NOISE` would leave, by Laplace with the true cylinders and everything else that is free, a standard deviation
below a tenth of how far the nominal arm is from the true one: the rule of the test without noise. Errors are
root mean squares over these arms, cycles and frames. A person with no such arm counts as one whose error did
not fall.

People and results are kept in ``--place``, and what is there is not done again. It has to be the same
package: ask for another place when it changed.
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
from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax

if TYPE_CHECKING:
    from wrapjax.calibration.calibration import Calibration
    from wrapjax.model.freedom import FreedWraps
    from wrapjax.path_sources.exact import ExactGeometry
    from wrapjax.subject.subject import Subject

#: N m: by which arms and gains are told apart.
NOISE = 0.003
#: Curves and activation that the simulator can have.
CURVES = ("millard", "thelen", "spline")
_KINDS = ("told", "touched")
_USES = ("calibration", "validation")


@dataclass(frozen=True)
class Asked:
    """What is asked of a person.

    Parameters
    ----------
    seed
        Decides who it is.
    emg_noise
        Share of the envelopes.
    curves
        One of `CURVES`.
    starts
        Of each calibration.
    prior
        Deviation of the prior on where cylinders are, m along each axis; None: the package's own.
    """

    seed: int
    emg_noise: float
    curves: str = CURVES[0]
    starts: int = 1
    prior: float | None = None

    @property
    def person(self) -> str:
        """Name of the person's folder."""
        return f"{self.curves}_{self.emg_noise:g}_{self.seed:03d}"

    @property
    def result(self) -> str:
        """Name of the result's file, beside the person's."""
        prior = "" if self.prior is None else f"_prior_{self.prior:g}"
        return f"{self.person}_starts_{self.starts}{prior}.json"


def main() -> int:
    options = _parser().parse_args()
    # Before JAX is loaded, which reads it once.
    pin_threads()
    set_up_jax()
    seeds = range(options.seed, options.seed + options.subjects)
    asked = [Asked(seed, options.emg_noise, options.curves, options.starts, options.prior) for seed in seeds]
    with tempfile.TemporaryDirectory() as spare:
        found = answer_all(asked, options.place or Path(spare))
    told = summary(found)
    print("\n".join(lines(told)))
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
        write_json(options.out, about | {"summary": told, "people": found})
    return 0


def answer_all(asked: Sequence[Asked], place: Path) -> list[dict[str, Any]]:
    """Give every person's result, those kept in a folder as they are."""
    place.mkdir(parents=True, exist_ok=True)
    found = []
    for number, one in enumerate(asked, 1):
        began = time.perf_counter()
        file = place / one.result
        kept = file.exists()
        if kept:
            result = json.loads(file.read_text(encoding="utf-8"))
        else:
            result = answer(one, place)
            clear_caches_near_map_limit()
        found.append(result)
        how = "as before" if kept else f"{time.perf_counter() - began:.0f} s"
        print(f"{number}/{len(asked)} {in_words(result)} ({how})", file=sys.stderr, flush=True)
    return found


def answer(asked: Asked, place: Path) -> dict[str, Any]:
    """Make a person (unless they are there), calibrate and judge; keep the result beside them."""
    import wrapjax
    from validation.blind.hidden_wraps import hidden_wraps, write_hidden
    from wrapjax.io.files import write_json

    folder = place / asked.person
    if not folder.exists():
        write_hidden(hidden_wraps(asked.seed, asked.curves), asked.seed, asked.emg_noise, folder)
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
        **judge(subject, geometry, after, folder),
    }
    write_json(place / asked.result, result)
    return dict(json.loads((place / asked.result).read_text(encoding="utf-8")))


def with_prior(wraps: FreedWraps | None, distance: float) -> FreedWraps:
    """Expect cylinders within so many m of where they are, along each axis; turns and radii as they were."""
    if wraps is None:
        raise ValueError("no cylinder is free")
    along = [name.startswith("translation") for name in wraps.quantities]
    return replace(wraps, prior_sd=np.where(along, distance, wraps.prior_sd))


def moment_errors(done: Calibration) -> dict[str, float]:
    """Mean absolute moment error (N m) over coordinates and frames, by what cycles are used for."""
    result = done.result
    error = np.abs(result.measured - result.modelled).mean(axis=(1, 2))
    uses = np.array(result.uses)
    return {use: float(error[uses == use].mean()) for use in _USES}


def judge(subject: Subject, geometry: ExactGeometry, done: Calibration, folder: Path) -> dict[str, Any]:
    """Hold a calibration's arms and cylinders against the truth beside the subject's folder."""
    import jax.numpy as jnp

    from wrapjax.calibration.problem import build_objective
    from wrapjax.calibration.uncertainty.identifiability import moment_arm_deviation

    result = done.result
    wraps, moving = result.freedom.wraps, result.freedom.moving_paths
    assert wraps is not None and moving is not None, "PGA frees cylinders"
    with np.load(folder / "truth.npz") as kept:
        names, columns = kept["muscles"].tolist(), kept["coordinates"].tolist()
        rows = [names.index(name) for name in result.muscles]
        places = [columns.index(name) for name in result.coordinates]
        # As calibrations have them: muscle, cycle, coordinate, frame.
        true, undisplaced = (
            np.swapaxes(kept[name][:, rows][:, :, places], 0, 1) for name in ("arms", "undisplaced")
        )
    believed, found = (
        np.asarray(states.path.moment_arm) for states in (result.initial_states, result.states)
    )
    true_wraps = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["wraps"]
    problem = build_objective(subject, "PGA", geometry, result.freedom)
    changes = jnp.asarray(true_changes(wraps, true_wraps))
    tree = replace(problem.variables.base, path_changes=changes)
    deviation = moment_arm_deviation(problem, np.asarray(problem.start(tree)), NOISE).mean(axis=(1, 3))
    touched, told = arms_that_count(true, undisplaced, believed, deviation, moving)
    names_of = [(muscle, coordinate) for muscle in result.muscles for coordinate in result.coordinates]
    return {
        "told": arm_errors(true, believed, found, told),
        "touched": arm_errors(true, believed, found, touched),
        "arms": {
            f"{names_of[at][0]} about {names_of[at][1]}": {
                "told": bool(told.ravel()[at]),
                "deviation_m": float(deviation.ravel()[at]),
                **arm_errors(true, believed, found, np.arange(touched.size).reshape(touched.shape) == at),
            }
            for at in np.flatnonzero(touched)
        },
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


def true_changes(wraps: FreedWraps, true_wraps: Mapping[str, Sequence[float]]) -> np.ndarray:
    """Put true cylinders where calibrations have theirs: (muscle, mode), differences from nominal."""
    from wrapjax.geometry.wrapping import NOMINAL

    moved = np.stack([np.array(true_wraps[name]) - NOMINAL for name in wraps.names])
    changes = np.where((wraps.places >= 0)[..., None], moved[wraps.places], 0.0)
    return changes.reshape(len(changes), -1)


def arms_that_count(
    true: np.ndarray,
    undisplaced: np.ndarray,
    believed: np.ndarray,
    deviation: np.ndarray,
    moving: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Tell which arms are touched, and which of these can be told from gains: (muscle, coordinate) each.

    Parameters
    ----------
    true, undisplaced, believed
        Moment arms (m), (muscle, cycle, coordinate, frame): the person's, the same before cylinders were
        displaced, and nominal ones.
    deviation
        What the moments leave open of them (m), (muscle, coordinate).
    moving
        Whether a muscle's path may move at all, (muscle,).
    """
    from wrapjax.demonstration.wrap_recovery import MINIMUM_ERROR, identifiable

    def apart(others: np.ndarray) -> np.ndarray:
        return np.abs(others - true).mean(axis=(1, 3))

    touched = (apart(undisplaced) > MINIMUM_ERROR) & moving[:, None]
    return touched, touched & identifiable(apart(believed), deviation)


def arm_errors(
    true: np.ndarray, before: np.ndarray, after: np.ndarray, chosen: np.ndarray
) -> dict[str, float | int | None]:
    """Root mean square errors (m) over chosen arms (muscle, coordinate), and the ratio of after to before."""
    if not chosen.any():
        return {"arms": 0, "before_m": None, "after_m": None, "ratio": None}
    one, other = (
        float(np.sqrt(np.mean(np.swapaxes(arms - true, 1, 2)[chosen] ** 2))) for arms in (before, after)
    )
    return {"arms": int(chosen.sum()), "before_m": one, "after_m": other, "ratio": other / one}


def summary(people: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Sum up: in how many errors of arms fell, the median ratio, and moment errors (N m, means)."""
    return {kind: fallen([one[kind]["ratio"] for one in people]) for kind in _KINDS} | {
        "moments_Nm": {
            method: {use: float(np.mean([one["moments_Nm"][method][use] for one in people])) for use in _USES}
            for method in ("NGA", "PGA")
        },
        "converged": sum(one["converged"]["PGA"] for one in people),
    }


def fallen(ratios: Sequence[float | None]) -> dict[str, Any]:
    """Count ratios below one; give their median, and intervals of 95 % of either that assume no distribution.

    None is a person of whom nothing could be judged: it counts as not fallen, and not for the median.
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


def in_words(result: Mapping[str, Any]) -> str:
    """Write a person's result in a line."""
    moments = result["moments_Nm"]
    shown = [f"seed {result['asked']['seed']}:"]
    for kind in _KINDS:
        own = result[kind]
        errors = (
            "none"
            if own["ratio"] is None
            else (f"{1e3 * own['before_m']:.2f} -> {1e3 * own['after_m']:.2f} mm ({own['ratio']:.2f})")
        )
        shown.append(f"{kind} {own['arms']} arms {errors};")
    for use in _USES:
        shown.append(f"{use} {moments['NGA'][use]:.2f} -> {moments['PGA'][use]:.2f} N m")
    return " ".join(shown)


def lines(told: Mapping[str, Any]) -> list[str]:
    """Write a summary in sentences."""
    shown = []
    for kind, what in zip(_KINDS, ("arms that can be told from gains", "all touched arms"), strict=True):
        own = told[kind]
        ratio = "" if own["median_ratio"] is None else f", median ratio {own['median_ratio']:.2f}"
        ends = [end for end in own["median_interval"] if end is not None]
        interval = f" ({ends[0]:.2f} to {ends[1]:.2f})" if len(ends) == 2 else ""
        shown.append(f"{what}: errors fall in {own['fallen']} of {own['of']}{ratio}{interval}")
    for use in _USES:
        nga, pga = (told["moments_Nm"][method][use] for method in ("NGA", "PGA"))
        shown.append(f"{use} cycles: NGA {nga:.2f}, PGA {pga:.2f} N m ({100 * (pga / nga - 1):+.1f} %)")
    return shown


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.calibration.hidden_wraps", description=__doc__
    )
    parser.add_argument("--subjects", type=int, default=20, metavar="N", help="people (default: 20)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the first person (default: 0)")
    parser.add_argument("--emg-noise", type=float, default=0.10, metavar="SHARE", help="default: 0.10")
    parser.add_argument("--curves", choices=CURVES, default=CURVES[0], help=f"default: {CURVES[0]}")
    parser.add_argument("--starts", type=int, default=1, metavar="N", help="of each calibration (default: 1)")
    parser.add_argument(
        "--prior", type=float, metavar="M", help="deviation of cylinders' places (default: the package's)"
    )
    parser.add_argument("--place", type=Path, metavar="DIR", help="where people and results are kept")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="where to write the result")
    return parser


if __name__ == "__main__":
    sys.exit(main())
