"""Poses in which muscle paths are computed to fit polynomials and to validate them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.training_samples import fastest_cycle_poses, random_poses
from wrapjax.subject.subject import Subject

#: Number of random training poses near the recorded ones, in addition to the frames of one smooth cycle.
TRAINING_POSES = 400
#: Number of poses for validation.
VALIDATION_POSES = 500


class FitPoses(NamedTuple):
    """Training and validation poses of a fit, and the recorded poses (rad or m)."""

    training: Float[np.ndarray, "pose coordinate"]
    validation: Float[np.ndarray, "pose coordinate"]
    recorded: Float[np.ndarray, "pose coordinate"]


#: Training poses that are the frames of one cycle, in order.
SMOOTH_POSES = slice(TRAINING_POSES, None)


def fit_poses(subject: Subject, coordinates: Sequence[str], seed: int) -> FitPoses:
    """Draw the poses of a fit; they are determined by the seed.

    Parameters
    ----------
    subject
        Subject with recorded cycles.
    coordinates
        Names of the coordinates.
    seed
        Seed of the random poses.
    """
    trials = subject.trials
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    generator = np.random.default_rng(seed)
    training = np.concatenate(
        [
            random_poses(angles, TRAINING_POSES, generator),
            fastest_cycle_poses(angles, trials.time[:, -1] - trials.time[:, 0]),
        ]
    )
    validation = random_poses(angles, VALIDATION_POSES, generator)
    return FitPoses(training, validation, np.moveaxis(angles, 1, 2).reshape(-1, len(coordinates)))
