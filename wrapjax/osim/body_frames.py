"""Poses of bodies and positions of markers as OpenSim computes them, to compare the skeleton with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import elements
from wrapjax.osim.motion import Mover


@dataclass(frozen=True)
class BodyFrames:
    """Poses of a model's bodies and positions of its markers, in ground's frame.

    Parameters
    ----------
    bodies, markers
        Names, in the model's order.
    rotation, origin
        Rotation matrices, whose columns are the bodies' axes, and origins (m).
    positions
        Positions of the markers, m.
    """

    bodies: tuple[str, ...]
    markers: tuple[str, ...]
    rotation: Float[np.ndarray, "pose body 3 3"]
    origin: Float[np.ndarray, "pose body 3"]
    positions: Float[np.ndarray, "pose marker 3"]


def pose_bodies(
    model_file: Path | str, coordinates: Sequence[str], poses: Float[np.ndarray, "pose coordinate"]
) -> BodyFrames:
    """Compute the poses of all bodies and the positions of all markers by OpenSim.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    coordinates
        Names of the given coordinates. Coupled ones follow them; others stay at the model's defaults.
    poses
        Values of the given coordinates, rad or m. Those of locked coordinates are ignored.
    """
    opensim = import_opensim()
    model, state = load_model(model_file)
    moving = [model.getCoordinateSet().get(name) for name in coordinates]
    mover = Mover(opensim, model, state, moving)
    bodies, markers = tuple(elements(model.getBodySet())), tuple(elements(model.getMarkerSet()))
    still = np.zeros(len(coordinates))
    rotation = np.empty((len(poses), len(bodies), 3, 3))
    origin, positions = np.empty((len(poses), len(bodies), 3)), np.empty((len(poses), len(markers), 3))
    for row, pose in enumerate(poses):
        mover.move(pose, still, still)
        for place, body in enumerate(bodies):
            transform = body.getTransformInGround(state)
            matrix = transform.R().asMat33()
            rotation[row, place] = [[matrix.get(i, j) for j in range(3)] for i in range(3)]
            origin[row, place] = transform.p().to_numpy()
        for place, marker in enumerate(markers):
            positions[row, place] = marker.getLocationInGround(state).to_numpy()
    body_names, marker_names = (tuple(part.getName() for part in parts) for parts in (bodies, markers))
    return BodyFrames(body_names, marker_names, rotation, origin, positions)
