"""Calibrate by PGA and ask OpenSim whether the model that is written has the paths that were calibrated.

``python -m benchmarks.personalised SUBJECT`` goes through the exact engine, with ``--fit FIT`` through that
surrogate. For every muscle whose cylinders moved, over all recorded cycles, it prints in mm: how far
OpenSim's lengths and moment arms (those about the coordinate where it is most) are from the calibration's,
and the shortest path's likewise; how far the difference from the nominal length steps from frame to frame, in
OpenSim and of the shortest path; and which criteria of a physiological path are failed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.machine import pin_threads
from benchmarks.subjects import default_subject
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    import jax

    from wrapjax.api import Calibration
    from wrapjax.geometry import PathState

_COLUMNS = ("length", "arm", "shortest: length", "arm", "step", "shortest: step")


def main() -> int:
    options = _parser().parse_args()
    # Before JAX is loaded, which reads it once.
    pin_threads()
    set_up_jax()
    import wrapjax
    from wrapjax.api import load_fit

    with default_subject(options.subject) as folder:
        subject = wrapjax.load_subject(folder)
        source = load_fit(options.fit, subject) if options.fit else wrapjax.exact_geometry(subject)
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

    from wrapjax.api.calibrating.personalised import write_model
    from wrapjax.api.paths.exact import engine_of, recorded
    from wrapjax.geometry.engine import nominal_parameters, wrap_at_samples
    from wrapjax.geometry.physiological import measure_paths
    from wrapjax.osim import analyse_muscles

    subject, result = done.subject, done.result
    wraps, moving = result.freedom.wraps, result.freedom.moving_paths
    assert wraps is not None and moving is not None, "PGA frees cylinders"
    engine = engine_of(subject)
    angles, _ = recorded(subject.trials, engine.coordinates)
    trials, _, frames = angles.shape
    poses = np.moveaxis(angles, 1, -1).reshape(trials * frames, -1)
    muscles = tuple(np.array(result.muscles)[moving].tolist())
    with tempfile.TemporaryDirectory() as folder:
        personalised = Path(folder) / "personalised.osim"
        write_model(subject, result, personalised)
        after, before = (
            analyse_muscles(file, muscles, engine.coordinates, poses, quiet=True)
            for file in (personalised, subject.model_file)
        )
    places = [engine.coordinates.index(name) for name in result.coordinates]
    changes = np.asarray(result.parameters.path_changes)
    posed = engine.posed(poses)
    used: PathState = result.states.path
    for place, name in enumerate(muscles):
        row = result.muscles.index(name)
        count = len(engine.wraps_of(name))
        nominal = nominal_parameters(count)
        own = changes[row].reshape(-1, nominal.shape[1])[:count]
        found = wrap_at_samples(posed[name], np.stack([nominal, nominal + own]))
        usual, moved = (jax.tree.map(lambda leaf, at=at: leaf[at : at + 1], found) for at in (0, 1))
        faults = measure_paths(moved, usual, slice(0, 0)).faults()
        length = np.asarray(used.length[row]).reshape(-1)
        arms = np.moveaxis(np.asarray(used.moment_arm[row]), 1, -1).reshape(len(poses), -1)
        figures = (
            _rms(after.length[:, place] - length).max(),
            _rms(after.moment_arm[:, places, place] - arms).max(),
            _rms(found.length[1] - length).max(),
            _rms(found.moment_arm[1][:, places] - arms).max(),
            _largest_step((after.length - before.length)[:, place].reshape(trials, frames)),
            _largest_step((found.length[1] - found.length[0]).reshape(trials, frames)),
        )
        yield name, figures, [criterion for criterion, failed in faults.items() if failed.any()]


def _rms(errors: np.ndarray | jax.Array) -> np.ndarray:
    return np.atleast_1d(np.sqrt(np.mean(np.asarray(errors) ** 2, axis=0)))


def _largest_step(change: np.ndarray | jax.Array) -> float:
    return float(np.abs(np.diff(np.asarray(change), axis=1)).max())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.personalised", description=__doc__)
    parser.add_argument("subject", type=Path, nargs="?", metavar="SUBJECT", help="subject folder")
    parser.add_argument("--fit", type=Path, metavar="FIT", help="go through this fit (default: the engine)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
