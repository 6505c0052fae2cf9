"""Writer of models with personalised joints: bodies scaled by OpenSim, then frames and markers moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_atomically
from wrapjax.osim.loading import failure_reason, import_opensim, load_model
from wrapjax.osim.model import add_marker_set, read_pose

Frame = tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]


@dataclass(frozen=True)
class JointChanges:
    """Changes of a model's skeleton.

    Parameters
    ----------
    scales
        Factors on a body's size along its axes, by body.
    frames
        Pose of a joint's parent and child frame in their bodies after scaling, by joint: rotation
        matrix and origin (m).
    markers
        Location of a marker on its body after scaling, m, by marker.
    """

    scales: Mapping[str, Float[np.ndarray, " 3"]] = field(default_factory=dict)
    frames: Mapping[str, tuple[Frame, Frame]] = field(default_factory=dict)
    markers: Mapping[str, Float[np.ndarray, " 3"]] = field(default_factory=dict)


def write_model_with_joints(
    model_file: Path | str,
    out_file: Path | str,
    changes: JointChanges,
    marker_set: Path | str | None = None,
) -> None:
    """Write a model with changed joints and markers.

    Bodies are scaled by OpenSim's own function with the masses kept, so that joints, muscle points, wrapping
    surfaces, optimal fiber and tendon slack lengths scale as in its scale tool. Frames and markers are placed
    after that. Muscle points and wrapping surfaces stay where they are on their bodies.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    out_file
        File to write, atomically.
    changes
        Scales, frames and markers.
    marker_set
        Marker set to add to the model (.xml).

    Raises
    ------
    InputError
        If the model cannot be loaded, or OpenSim cannot build the changed model.
    """
    opensim = import_opensim()
    model, state = load_model(model_file)
    if marker_set is not None:
        state = add_marker_set(model, marker_set)
    try:
        _scale(opensim, model, state, changes.scales)
        for name, (parent, child) in changes.frames.items():
            joint = model.updJointSet().get(name)
            for socket, frame in (("parent_frame", parent), ("child_frame", child)):
                _place_frame(opensim, model, joint, socket, frame)
        model.finalizeFromProperties()
        model.finalizeConnections()
        for name, location in changes.markers.items():
            marker = model.updMarkerSet().get(name)
            in_body = marker.getParentFrame().findTransformInBaseFrame()
            marker.set_location(in_body.shiftBaseStationToFrame(opensim.Vec3(*map(float, location))))
        model.initSystem()
    except RuntimeError as error:
        message = f"OpenSim cannot build the model with changed joints ({failure_reason(error)})"
        raise InputError(Problem(str(model_file), message)) from error

    def write(temporary: Path) -> None:
        model.printToXML(str(temporary))

    write_atomically(Path(out_file), write)


def _scale(opensim: Any, model: Any, state: Any, scales: Mapping[str, Float[np.ndarray, " 3"]]) -> None:
    if not scales:
        return
    factors = opensim.ScaleSet()
    for body, values in scales.items():
        scale = opensim.Scale()
        scale.setName(f"scale_{body}")
        scale.setSegmentName(body)
        scale.setScaleFactors(opensim.Vec3(*map(float, values)))
        scale.setApply(True)
        factors.cloneAndAppend(scale)
    model.scale(state, factors, True)


def _place_frame(opensim: Any, model: Any, joint: Any, socket: str, frame: Frame) -> None:
    """Place a joint's frame, in a new offset frame if the joint is attached to a body itself."""
    rotation, origin = frame
    current = joint.getParentFrame() if socket == "parent_frame" else joint.getChildFrame()
    offset = opensim.PhysicalOffsetFrame.safeDownCast(current)
    if offset is None:
        name = f"{joint.getName()}_{socket}"
        offset = opensim.PhysicalOffsetFrame(name, current, opensim.Transform())
        joint.addFrame(offset)
        joint.connectSocket_parent_frame(offset) if socket == "parent_frame" else (
            joint.connectSocket_child_frame(offset)
        )
        offset = opensim.PhysicalOffsetFrame.safeDownCast(
            joint.upd_frames(joint.getProperty_frames().size() - 1)
        )
        base = opensim.Transform()
    else:
        base = offset.getParentFrame().findTransformInBaseFrame()
    pose = read_pose(base)
    turned = np.asarray(pose.rotation).T @ rotation
    moved = np.asarray(pose.rotation).T @ (origin - np.asarray(pose.translation))
    angles = Rotation.from_matrix(turned).as_euler("XYZ")
    offset.set_translation(opensim.Vec3(*map(float, moved)))
    offset.set_orientation(opensim.Vec3(*map(float, angles)))
