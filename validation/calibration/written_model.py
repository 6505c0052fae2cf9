"""Agreement of OpenSim's paths in the model written by PGA with the calibrated paths.

``python -m validation.calibration.written_model SUBJECT`` calibrates with the exact engine, with ``--geometry
engine-parity`` by parity paths, or with ``--fit FIT`` through that surrogate. For every muscle whose wraps
changed it prints over all recorded cycles, in mm: the differences of OpenSim's lengths and moment arms (about
the coordinate with the largest difference) from those of the calibration, and of geodesic paths from these;
for muscles round several wraps, where OpenSim's moment arms are not the derivatives of its length, the
difference of -dL/dq of OpenSim's length from the calibrated moment arms; the largest step between frames of
the difference from the nominal length, in OpenSim and of the geodesic path; and the criteria of physiological
paths that OpenSim's path fails.
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
    from wrapjax.geometry.exact_paths.wrapping import WrappedPath
    from wrapjax.geometry.paths import PathState

_COLUMNS = ("length", "arm", "geodesic: length", "arm", "arm from slope", "step", "geodesic: step")
# Step of finite differences, rad: OpenSim's lengths are accurate to 1e-12 m or better.
_STEP = 1e-5


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
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
            print(f"{use}: {errors[np.array(result.uses) == use].mean():.2f} N m")
        print(
            f"{result.solution.iterations} iterations, {result.solve_seconds:.1f} s after "
            f"{result.compile_seconds:.1f} s of compilation; {done.status.value}\n"
        )
        print(f"{'muscle':16s}" + "".join(f"{name:>18s}" for name in _COLUMNS) + "  fails")
        for name, figures, faults in compare(done):
            print(f"{name:16s}" + "".join(f"{1e3 * value:18.3f}" for value in figures), "", *faults)
    return 0 if done.status.converged else 1


def compare(done: Calibration) -> Iterator[tuple[str, tuple[float, ...], list[str]]]:
    """Iterate over muscles: figures (m) in the order of the columns, and failed criteria."""
    import jax

    from wrapjax.calibration.calibration import write_calibrated_model
    from wrapjax.geometry.exact_paths.engine import PARITY, nominal_parameters, wrap_at_samples
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
        calibrated_model = Path(folder) / "calibrated.osim"
        write_calibrated_model(subject, result, calibrated_model)
        after, before = (
            analyse_muscles(file, muscles, engine.coordinates, poses, quiet=True)
            for file in (calibrated_model, subject.model_file)
        )
        slopes = _slopes(calibrated_model, several, engine.coordinates, poses, places)
    changes = np.asarray(result.parameters.path_changes)
    posed = engine.posed(poses)
    used: PathState = result.states.path
    for place, name in enumerate(muscles):
        row = result.muscles.index(name)
        count = len(engine.wraps_of(name))
        nominal = nominal_parameters(count)
        change = changes[row].reshape(-1, nominal.shape[1])[:count]
        both = np.stack([nominal, nominal + change])
        geodesic, parity = wrap_at_samples(posed[name], both), wrap_at_samples(posed[name], both, PARITY)
        # Parity paths stand for OpenSim's in the criteria, so they must agree.
        np.testing.assert_allclose(parity.length[1], after.length[:, place], atol=1e-9)
        unchanged, moved = (jax.tree.map(lambda leaf, at=at: leaf[at : at + 1], parity) for at in (0, 1))
        length = np.asarray(used.length[row]).reshape(-1)
        arms = np.moveaxis(np.asarray(used.moment_arm[row]), 1, -1).reshape(len(poses), -1)
        slope = slopes[..., several.index(name)] if name in several else arms
        figures = (
            _rms(after.length[:, place] - length).max(),
            _rms(after.moment_arm[:, places, place] - arms).max(),
            _rms(geodesic.length[1] - length).max(),
            _rms(geodesic.moment_arm[1][:, places] - arms).max(),
            _rms(slope - arms).max() if name in several else np.nan,
            _largest_step((after.length - before.length)[:, place].reshape(trials, frames)),
            _largest_step((geodesic.length[1] - geodesic.length[0]).reshape(trials, frames)),
        )
        yield name, figures, _failed_criteria(moved, unchanged, trials, frames)


def _slopes(
    file: Path,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    poses: np.ndarray,
    places: Sequence[int],
) -> np.ndarray:
    """Compute -dL/dq of OpenSim's lengths (m/rad, ``pose coordinate muscle``) by finite differences."""
    from wrapjax.osim.muscle_analysis import analyse_muscles

    if not muscles:
        return np.zeros((len(poses), len(places), 0))

    def length(shift: np.ndarray) -> np.ndarray:
        return analyse_muscles(file, muscles, coordinates, poses + shift, quiet=True).length

    steps = _STEP * np.eye(len(coordinates))
    return np.stack([(length(-steps[at]) - length(steps[at])) / (2.0 * _STEP) for at in places], axis=1)


def _failed_criteria(moved: WrappedPath, unchanged: WrappedPath, trials: int, frames: int) -> list[str]:
    """Return the criteria that a path fails in any pose or along any cycle."""
    from wrapjax.geometry.surrogates.physiological import measure_paths

    failed: dict[str, bool] = {}
    for trial in range(trials):
        cycle = slice(trial * frames, (trial + 1) * frames - 1)
        for criterion, fails in measure_paths(moved, unchanged, cycle).failed_criteria().items():
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
        help="geodesic paths (default) or parity paths",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
