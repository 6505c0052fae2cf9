"""Poses at which muscle paths are analysed to fit polynomials, and to test them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.training_samples import fastest_cycle_poses, random_poses
from wrapjax.subject.subject import Subject

#: Poses for training: random ones in the walking belt, beside the frames of one smooth cycle.
TRAINING_POSES = 400
#: Poses that fitting never sees.
VALIDATION_POSES = 500


class FitPoses(NamedTuple):
    """Poses of a fit (rad or m), and the recorded ones."""

    training: Float[np.ndarray, "pose coordinate"]
    validation: Float[np.ndarray, "pose coordinate"]
    recorded: Float[np.ndarray, "pose coordinate"]


#: Which of the training poses are frames of one cycle, in order.
SMOOTH_POSES = slice(TRAINING_POSES, None)


def fit_poses(subject: Subject, coordinates: Sequence[str], seed: int) -> FitPoses:
    """Draw the poses of a fit; the same seed gives the same ones."""
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
