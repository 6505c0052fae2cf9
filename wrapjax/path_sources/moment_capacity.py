"""Share of each joint's moment capacity whose muscles have no electrode, from a subject's model and poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.subject.subject import Subject

#: Number of recorded poses at which moment arms are computed.
_POSES = 12


@dataclass(frozen=True)
class UnrecordedCapacity:
    """Moment capacity of muscles without an electrode about one coordinate, in one direction.

    Parameters
    ----------
    coordinate
        Name of the coordinate.
    sign
        1 for moments towards larger values of the coordinate, -1 towards smaller ones.
    share
        Their share of the capacity of all muscles of the leg, 0 to 1.
    muscles
        Those that have most of it, at most three, the strongest first.
    """

    coordinate: str
    sign: int
    share: float
    muscles: tuple[str, ...]


def unrecorded_capacity(subject: Subject) -> tuple[UnrecordedCapacity, ...]:
    """Compute the share of each coordinate's moment capacity without EMG, in either direction.

    A muscle's capacity is its maximum isometric force times the mean over recorded poses of its moment arm in
    that direction, by OpenSim.

    Returns
    -------
    tuple of UnrecordedCapacity
        Two for each coordinate of the subject's moments.
    """
    trials = subject.trials
    poses = np.moveaxis(trials.angles, 1, 2).reshape(-1, len(trials.coordinates))
    poses = poses[np.unique(np.linspace(0, len(poses) - 1, _POSES).astype(int))]
    muscles = (*subject.muscles.names, *subject.undriven_muscles)
    force = subject.muscles.max_isometric_force
    if subject.undriven_parameters is not None:
        force = np.concatenate([force, subject.undriven_parameters.max_isometric_force])
    found = analyse_muscles(subject.model_file, muscles, trials.coordinates, poses, processes=1, quiet=True)
    driven = len(subject.muscles.names)
    rows = []
    for name in trials.moment_coordinates:
        arms = found.moment_arm[:, found.coordinates.index(name)]
        for sign in (1, -1):
            capacity = np.maximum(sign * arms, 0.0).mean(axis=0) * force
            total = float(capacity.sum())
            strongest = driven + np.argsort(capacity[driven:])[::-1][:3]
            rows.append(
                UnrecordedCapacity(
                    name,
                    sign,
                    float(capacity[driven:].sum()) / total if total > 0.0 else 0.0,
                    tuple(muscles[row] for row in strongest if capacity[row] > 0.0),
                )
            )
    return tuple(rows)
