"""Fit errors of OpenSim's PolynomialPathFitter on poses that were not used for fitting.

Run: ``python -m benchmarks.polynomial_path_fitter SUBJECT --muscles soleus_l vasmed_l --out FILE.json``

It takes about a minute for each muscle, because OpenSim computes moment arms about every coordinate.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.io.files import write_json
from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_muscles

#: Number of evaluation poses, and the seed of their random numbers.
UNSEEN_POSES, SEED = 500, 1


def fit_with_opensim(
    model_file: Path | str,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    trajectory: Float[np.ndarray, "frame coordinate"],
    half_width: Float[np.ndarray, " coordinate"],
    unseen: Float[np.ndarray, "pose coordinate"],
    *,
    samples_per_frame: int = 25,
    maximum_order: int = 5,
    threads: int = 2,
) -> dict[str, Any]:
    """Fit muscle paths by PolynomialPathFitter and compute the errors of the fits.

    Parameters
    ----------
    model_file, muscles, coordinates
        OpenSim model, and names of its muscles and coordinates.
    trajectory, half_width
        Poses (rad) that the fitter samples around, and the sampling half-width of each coordinate (rad).
    unseen
        Poses (rad) at which the fits are evaluated.
    samples_per_frame, maximum_order, threads
        Settings of the fitter (its default is 25 samples); all other settings are left at their defaults.

    Returns
    -------
    dict
        ``seconds`` of fitting and, by muscle, errors against OpenSim in mm under the names of ``fit.json``;
        moment arm errors are pooled over poses and the given coordinates that the muscle spans.
    """
    muscles, coordinates = tuple(muscles), tuple(coordinates)
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        fitter = _fitter(model_file, muscles, coordinates, trajectory, half_width)
        fitter.setOutputDirectory(folder)
        fitter.setNumSamplesPerFrame(samples_per_frame)
        fitter.setMaximumPolynomialOrder(maximum_order)
        fitter.setNumParallelThreads(threads)
        fitter.run()
        seconds = time.perf_counter() - started
        (paths,) = Path(folder).glob("*_FunctionBasedPathSet.xml")
        length, moment_arm = _evaluate(paths, muscles, coordinates, unseen)
    reference = analyse_muscles(model_file, muscles, coordinates, unseen, quiet=True)
    model = describe_model(model_file)
    errors = {}
    for index, muscle in enumerate(muscles):
        spanned = [coordinates.index(name) for name in model.spanned_by(muscle) if name in coordinates]
        length_error = 1e3 * (length - reference.length)[:, index]
        arm_error = 1e3 * (moment_arm - reference.moment_arm)[:, spanned, index]
        errors[muscle] = {
            "length_rmse_mm": np.sqrt(np.mean(length_error**2)),
            "length_max_mm": np.abs(length_error).max(),
            "moment_arm_rmse_mm": np.sqrt(np.mean(arm_error**2)),
            "moment_arm_max_mm": np.abs(arm_error).max(),
        }
    return {"seconds": seconds, "muscles": errors}


def _fitter(
    model_file: Path | str,
    muscles: tuple[str, ...],
    coordinates: tuple[str, ...],
    trajectory: Float[np.ndarray, "frame coordinate"],
    half_width: Float[np.ndarray, " coordinate"],
) -> Any:
    opensim = import_opensim()
    model, _ = load_model(model_file)
    forces = model.updForceSet()
    for index in reversed(range(forces.getSize())):
        if forces.get(index).getName() not in muscles:
            forces.remove(index)
    model.finalizeConnections()
    model.initSystem()
    # The fitter requires a column for every coordinate that is not coupled to others.
    coupled = {entry.name for entry in describe_model(model_file).coordinates if entry.coupled_to}
    known = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
    free = [coordinate for coordinate in known if coordinate.getName() not in coupled]
    table = np.tile([coordinate.getDefaultValue() for coordinate in free], (len(trajectory), 1))
    fitter = opensim.PolynomialPathFitter()
    for column, coordinate in enumerate(free):
        if coordinate.getName() in coordinates:
            given = coordinates.index(coordinate.getName())
            table[:, column] = trajectory[:, given]
            width = float(np.degrees(half_width[given]))
            path = coordinate.getAbsolutePathString()
            fitter.appendCoordinateSamplingBounds(path, opensim.Vec2(-width, width))
    values = opensim.TimeSeriesTable(
        opensim.StdVectorDouble([0.01 * frame for frame in range(len(trajectory))]),
        opensim.Matrix.createFromMat(table),
        opensim.StdVectorString([f"{coordinate.getAbsolutePathString()}/value" for coordinate in free]),
    )
    values.addTableMetaDataString("inDegrees", "no")
    fitter.setModel(opensim.ModelProcessor(model))
    fitter.setCoordinateValues(opensim.TableProcessor(values))
    return fitter


def _evaluate(
    paths: Path,
    muscles: tuple[str, ...],
    coordinates: tuple[str, ...],
    poses: Float[np.ndarray, "pose coordinate"],
) -> tuple[Float[np.ndarray, "pose muscle"], Float[np.ndarray, "pose coordinate muscle"]]:
    """Evaluate lengths and moment arms of fitted paths; coordinates that are not given are zero."""
    opensim = import_opensim()
    fitted = opensim.SetFunctionBasedPaths(str(paths))
    length = np.zeros((len(poses), len(muscles)))
    moment_arm = np.zeros((len(poses), len(coordinates), len(muscles)))
    for index in range(fitted.getSize()):
        path = fitted.get(index)
        muscle = muscles.index(path.getName().rsplit("/", 1)[-1])
        names = [entry.rsplit("/", 1)[-1] for entry in path.getCoordinatePaths()]
        function = path.getLengthFunction()
        for row, pose in enumerate(poses):
            arguments = opensim.Vector(len(names), 0.0)
            for number, name in enumerate(names):
                if name in coordinates:
                    arguments.set(number, float(pose[coordinates.index(name)]))
            length[row, muscle] = function.calcValue(arguments)
            for number, name in enumerate(names):
                if name in coordinates:
                    slope = function.calcDerivative(opensim.StdVectorInt([number]), arguments)
                    moment_arm[row, coordinates.index(name), muscle] = -slope
    return length, moment_arm


def main() -> None:
    from wrapjax import load_subject
    from wrapjax.geometry.surrogates.training_samples import angle_ranges, random_poses

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("subject", type=Path, help="subject folder")
    parser.add_argument("--muscles", nargs="+", help="muscles to fit (default: all of the subject)")
    parser.add_argument("--out", type=Path, help="JSON file to write the errors to")
    parser.add_argument("--samples-per-frame", type=int, default=25)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()

    subject = load_subject(options.subject)
    coordinates = subject.trials.moment_coordinates
    columns = [subject.trials.coordinates.index(name) for name in coordinates]
    angles = subject.trials.angles[:, columns]
    lower, upper = angle_ranges(angles)
    unseen = random_poses(angles, UNSEEN_POSES, np.random.default_rng(SEED))
    result = fit_with_opensim(
        subject.model_file,
        options.muscles or subject.muscles.names,
        coordinates,
        (0.5 * (lower + upper)).T[:-1],
        (0.5 * (upper - lower)).max(axis=1),
        unseen,
        samples_per_frame=options.samples_per_frame,
        threads=options.threads,
    )
    if options.out:
        write_json(options.out, result)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
