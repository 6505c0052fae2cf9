"""Time of OpenSim's muscle analysis by one call of ``computeMomentArm`` for each moment arm."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.osim.loading import load_model


def compute_moment_arm_seconds(
    model_file: Path | str,
    coordinates: Sequence[str],
    spans: Mapping[str, Sequence[str]],
    poses: Float[np.ndarray, "pose coordinate"],
) -> float:
    """Compute the mean time (s) of the length and all moment arms of one muscle in one pose.

    `wrapjax.osim` does the same many times faster, except for paths that only ``computeMomentArm`` handles.
    Setting the pose is not timed: its share for each muscle depends on the number of muscles.

    Parameters
    ----------
    model_file
        OpenSim model.
    coordinates, poses
        Names of the coordinates, and their values, rad or m.
    spans
        Coordinates on which the length of each muscle depends, by muscle.
    """
    model, state = load_model(model_file)
    coordinate_set, muscle_set = model.getCoordinateSet(), model.getMuscles()
    posed = [coordinate_set.get(name) for name in coordinates]
    analysed = [
        (muscle_set.get(name), [coordinate_set.get(spanned) for spanned in span])
        for name, span in spans.items()
    ]
    taken = 0.0
    for pose in poses:
        for coordinate, value in zip(posed, pose, strict=True):
            coordinate.setValue(state, float(value), False)
        model.assemble(state)
        model.realizePosition(state)
        began = time.perf_counter()
        for muscle, about in analysed:
            muscle.getLength(state)
            for coordinate in about:
                muscle.computeMomentArm(state, coordinate)
        taken += time.perf_counter() - began
    return taken / (len(poses) * len(analysed))
