"""OpenSim used the obvious way: each moment arm asked for by itself."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.osim.loading import load_model


def plain_seconds(
    model_file: Path | str,
    coordinates: Sequence[str],
    spans: Mapping[str, Sequence[str]],
    poses: Float[np.ndarray, "pose coordinate"],
) -> float:
    """Time the length and all moment arms of one muscle in one pose (s), on average.

    `wrapjax.osim` does the same thing many times faster, but for paths that only this way gets right.
    Putting the model into poses is not counted: how long that takes a muscle depends on how many there are.

    Parameters
    ----------
    coordinates, poses
        Their values, rad or m.
    spans
        The muscles, and the coordinates that each one's length depends on.
    """
    model, state = load_model(model_file)
    coordinate_set, muscle_set = model.getCoordinateSet(), model.getMuscles()
    given = [coordinate_set.get(name) for name in coordinates]
    asked = [
        (muscle_set.get(name), [coordinate_set.get(own) for own in span]) for name, span in spans.items()
    ]
    taken = 0.0
    for pose in poses:
        for coordinate, value in zip(given, pose, strict=True):
            coordinate.setValue(state, float(value), False)
        model.assemble(state)
        model.realizePosition(state)
        began = time.perf_counter()
        for muscle, about in asked:
            muscle.getLength(state)
            for coordinate in about:
                muscle.computeMomentArm(state, coordinate)
        taken += time.perf_counter() - began
    return taken / (len(poses) * len(asked))
