"""Calibrate by PGA and ask OpenSim whether the model that is written has the paths that were calibrated.

``python -m validation.calibration.written_model SUBJECT`` goes through the exact engine, with ``--geometry
engine-parity`` by OpenSim's way of wrapping, with ``--fit FIT`` through that surrogate. For every muscle
whose cylinders moved, over all recorded cycles, it prints in mm: how far OpenSim's lengths and moment arms
(those about the coordinate where it is most) are from the calibration's, and the shortest path's likewise;
how far the negative slope of OpenSim's length is from the calibration's moment arms, for muscles with
several cylinders, where OpenSim's moment arms are not that slope; how far the difference from the nominal
length steps from frame to frame, in OpenSim and of the shortest path; and which criteria of a
physiological path OpenSim's path fails.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.machine import pin_threads
from benchmarks.subjects import default_subject
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    import jax

    from wrapjax.calibration.calibration import Calibration
    from wrapjax.geometry.paths import PathState
    from wrapjax.geometry.wrapping import WrappedPath

_COLUMNS = ("length", "arm", "shortest: length", "arm", "arm from slope", "step", "shortest: step")
# Of the differences that slopes are taken from, rad: OpenSim's lengths are good to 1e-12 m or better.
_STEP = 1e-5


def main() -> int:
    options = _parser().parse_args()
    # Before JAX is loaded, which reads it once.
    pin_threads()
    set_up_jax()
    import wrapjax
    from wrapjax.path_sources.polynomial_fit import load_fit

    with default_subject(options.subject) as folder:
        subject = wrapjax.load_subject(folder)
        source = (
            load_fit(options.fit, subject)
            if options.fit
            else wrapjax.exact_geometry(subject, options.geometry)
        )
        done = wrapjax.calibrate(subject, "PGA", source, starts=1)
        result = done.result
        errors = np.abs(result.measured - result.modelled).mean(axis=(1, 2))
        for use in ("calibration", "validation"):
            own = errors[np.array(result.uses) == use]
            print(f"{use}: {own.mean():.2f} N m")
        print(
            f"{result.solution.iterations} iterations, {result.solve_seconds:.1f} s after "
            f"{result.compile_seconds:.1f} s of compiling; {done.status.value}\n"
        )
        print(f"{'muscle':16s}" + "".join(f"{name:>18s}" for name in _COLUMNS) + "  fails")
        for name, figures, faults in compare(done):
            print(f"{name:16s}" + "".join(f"{1e3 * value:18.3f}" for value in figures), "", *faults)
    return 0 if done.status.converged else 1


def compare(done: Calibration) -> Iterator[tuple[str, tuple[float, ...], list[str]]]:
    """Give figures (m) in the order of the columns, and failed criteria, muscle by muscle."""
    import jax

    from wrapjax.calibration.calibration import write_calibrated_model
    from wrapjax.geometry.engine import PARITY, nominal_parameters, wrap_at_samples
    from wrapjax.osim.muscle_analysis import analyse_muscles
    from wrapjax.path_sources.exact import build_engine, recorded_motion

    subject, result = done.subject, done.result
    wraps, moving = result.freedom.wraps, result.freedom.moving_paths
    assert wraps is not None and moving is not None, "PGA frees cylinders"
    engine = build_engine(subject)
    angles, _ = recorded_motion(subject.trials, engine.coordinates)
    trials, _, frames = angles.shape
    poses = np.moveaxis(angles, 1, -1).reshape(trials * frames, -1)
    muscles = tuple(np.array(result.muscles)[moving].tolist())
    several = tuple(name for name in muscles if len(engine.wraps_of(name)) > 1)
    places = [engine.coordinates.index(name) for name in result.coordinates]
    with tempfile.TemporaryDirectory() as folder:
        personalised = Path(folder) / "personalised.osim"
        write_calibrated_model(subject, result, personalised)
        after, before = (
            analyse_muscles(file, muscles, engine.coordinates, poses, quiet=True)
            for file in (personalised, subject.model_file)
        )
        slopes = _slopes(personalised, several, engine.coordinates, poses, places)
    changes = np.asarray(result.parameters.path_changes)
    posed = engine.posed(poses)
    used: PathState = result.states.path
    for place, name in enumerate(muscles):
        row = result.muscles.index(name)
        count = len(engine.wraps_of(name))
        nominal = nominal_parameters(count)
        own = changes[row].reshape(-1, nominal.shape[1])[:count]
        both = np.stack([nominal, nominal + own])
        found, opensims = wrap_at_samples(posed[name], both), wrap_at_samples(posed[name], both, PARITY)
        # What judges OpenSim's path is OpenSim's path.
        np.testing.assert_allclose(opensims.length[1], after.length[:, place], atol=1e-9)
        usual, moved = (jax.tree.map(lambda leaf, at=at: leaf[at : at + 1], opensims) for at in (0, 1))
        length = np.asarray(used.length[row]).reshape(-1)
        arms = np.moveaxis(np.asarray(used.moment_arm[row]), 1, -1).reshape(len(poses), -1)
        slope = slopes[..., several.index(name)] if name in several else arms
        figures = (
            _rms(after.length[:, place] - length).max(),
            _rms(after.moment_arm[:, places, place] - arms).max(),
            _rms(found.length[1] - length).max(),
            _rms(found.moment_arm[1][:, places] - arms).max(),
            _rms(slope - arms).max() if name in several else np.nan,
            _largest_step((after.length - before.length)[:, place].reshape(trials, frames)),
            _largest_step((found.length[1] - found.length[0]).reshape(trials, frames)),
        )
        yield name, figures, _faults(moved, usual, trials, frames)


def _slopes(
    file: Path,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    poses: np.ndarray,
    places: Sequence[int],
) -> np.ndarray:
    """-dL/dq of OpenSim's lengths (m/rad, ``pose coordinate muscle``), by differences."""
    from wrapjax.osim.muscle_analysis import analyse_muscles

    if not muscles:
        return np.zeros((len(poses), len(places), 0))

    def length(shift: np.ndarray) -> np.ndarray:
        return analyse_muscles(file, muscles, coordinates, poses + shift, quiet=True).length

    steps = _STEP * np.eye(len(coordinates))
    return np.stack([(length(-steps[at]) - length(steps[at])) / (2.0 * _STEP) for at in places], axis=1)


def _faults(moved: WrappedPath, usual: WrappedPath, trials: int, frames: int) -> list[str]:
    """Name the criteria that a path fails, in any pose or along any cycle."""
    from wrapjax.geometry.physiological import measure_paths

    failed: dict[str, bool] = {}
    for trial in range(trials):
        cycle = slice(trial * frames, (trial + 1) * frames - 1)
        for criterion, fails in measure_paths(moved, usual, cycle).failed_criteria().items():
            failed[criterion] = failed.get(criterion, False) or bool(fails.any())
    return [criterion for criterion, fails in failed.items() if fails]


def _rms(errors: np.ndarray | jax.Array) -> np.ndarray:
    return np.atleast_1d(np.sqrt(np.mean(np.asarray(errors) ** 2, axis=0)))


def _largest_step(change: np.ndarray | jax.Array) -> float:
    return float(np.abs(np.diff(np.asarray(change), axis=1)).max())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.calibration.written_model", description=__doc__
    )
    parser.add_argument("subject", type=Path, nargs="?", metavar="SUBJECT", help="subject folder")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--fit", type=Path, metavar="FIT", help="go through this fit")
    source.add_argument(
        "--geometry",
        choices=("engine", "engine-parity"),
        default="engine",
        help="by the shortest way (default), or by OpenSim's",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
