"""Fit errors and times of the surrogate and of OpenSim's PolynomialPathFitter."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from benchmarks.metric import INFORMATION, Metric
from benchmarks.polynomial_path_fitter import SEED, UNSEEN_POSES, fit_with_opensim
from wrapjax.geometry.surrogates.surrogate import fit_surrogate
from wrapjax.geometry.surrogates.training_samples import angle_ranges, fastest_cycle_poses, random_poses
from wrapjax.osim.model import describe_model, spanned_coordinates
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.path_sources.path_fitting import path_errors
from wrapjax.path_sources.path_samples import TRAINING_POSES
from wrapjax.subject.subject import Subject

#: Muscles with broad origins, paths over the pelvic brim, paths that lift off their wrap, knee and ankle.
DEFAULT_MUSCLES = ("iliacus", "psoas", "glmax1", "glmax2", "recfem", "vasmed", "semimem", "gasmed")

_QUANTITIES = ("length_rmse_mm", "length_max_mm", "moment_arm_rmse_mm", "moment_arm_max_mm")


def default_muscles(subject: Subject) -> tuple[str, ...]:
    """Return those of `DEFAULT_MUSCLES` that the subject has."""
    return tuple(
        name for name in subject.muscles.names if name.removesuffix(f"_{subject.side}") in DEFAULT_MUSCLES
    )


def surrogates(
    subject: Subject, muscles: Sequence[str], *, quick: bool = False, samples_per_frame: int = 25
) -> list[Metric]:
    """Fit the same muscles both ways on one thread, and evaluate both on the same held-out poses.

    Parameters
    ----------
    subject
        Subject whose cycles define the range of poses.
    muscles
        Muscles to fit; OpenSim's fitter takes about a minute for each.
    quick
        Fit the first two muscles only, with few samples by OpenSim.
    samples_per_frame
        Setting of OpenSim's fitter; 25 is its default.
    """
    muscles = tuple(muscles)[: 2 if quick else None]
    if quick:
        samples_per_frame = 3
    trials = subject.trials
    coordinates = trials.moment_coordinates
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    unseen = random_poses(angles, UNSEEN_POSES, np.random.default_rng(SEED))

    began = time.perf_counter()
    training = np.concatenate(
        [
            random_poses(angles, TRAINING_POSES, np.random.default_rng(SEED + 1)),
            fastest_cycle_poses(angles, trials.time[:, -1] - trials.time[:, 0]),
        ]
    )
    known = analyse_muscles(subject.model_file, muscles, coordinates, training, processes=1, quiet=True)
    analysed = time.perf_counter()
    surrogate = fit_surrogate(
        muscles,
        coordinates,
        spanned_coordinates(subject.model_file, muscles),
        training,
        known.length,
        known.moment_arm,
    )
    fitted = time.perf_counter()
    reference = analyse_muscles(subject.model_file, muscles, coordinates, unseen, processes=1, quiet=True)
    wrapped = {muscle.name: bool(muscle.wraps) for muscle in describe_model(subject.model_file).muscles}
    ours = path_errors(surrogate, unseen, reference, slice(None), wrapped)

    lower, upper = angle_ranges(angles)
    opensim = fit_with_opensim(
        subject.model_file,
        muscles,
        coordinates,
        (0.5 * (lower + upper)).T[:-1],
        (0.5 * (upper - lower)).max(axis=1),
        unseen,
        samples_per_frame=samples_per_frame,
        threads=1,
    )
    count = f"{len(muscles)} muscles, one thread"
    metrics = [
        Metric("surrogate/seconds", fitted - began, "s", "lower", f"{count}; OpenSim's analysis included"),
        Metric("surrogate/fit_seconds", fitted - analysed, "s", "lower", "of these, fitting and pruning"),
        Metric(
            "surrogate/opensim_seconds",
            opensim["seconds"],
            "s",
            "lower",
            f"{count}; PolynomialPathFitter, {samples_per_frame} samples a frame",
            INFORMATION,
        ),
        Metric(
            "surrogate/opensim_slower",
            opensim["seconds"] / (fitted - began),
            "x",
            "higher",
            "time of OpenSim over time of wrapjax",
        ),
    ]
    for muscle in muscles:
        for quantity in _QUANTITIES:
            theirs = float(opensim["muscles"][muscle][quantity])
            name = quantity.removesuffix("_mm")
            metrics.append(
                Metric(
                    f"surrogate/{muscle}/{name}",
                    float(getattr(ours[muscle], quantity)),
                    "mm",
                    "lower",
                    f"PolynomialPathFitter: {theirs:.3f}",
                )
            )
    return metrics
