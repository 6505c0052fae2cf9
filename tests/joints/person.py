"""Synthetic person whose joints differ from the model's: markers by OpenSim, settings, and the truth."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.preprocessing.marker_legs import gait, legs_text, recorded_by_opensim
from wrapjax.geometry.marker_model import build_marker_model
from wrapjax.joints.changed_skeleton import skeleton_change
from wrapjax.joints.freed_parameters import FreedParameter, PriorWidths, frame_parameters
from wrapjax.osim.model import describe_model
from wrapjax.osim.personalised_joints import JointChanges, write_model_with_joints
from wrapjax.preprocessing.files.markers import Markers, write_trc

#: Joints that differ, and their frames' freed axes.
JOINTS = ("hip_r", "knee_r", "ankle_r")
FRAMES = 60


@dataclass(frozen=True)
class Person:
    """Files and truth of the synthetic person."""

    folder: Path
    model: Path
    true_model: Path
    markers: Markers
    parameters: tuple[FreedParameter, ...]
    truth: np.ndarray


def freed_frames(joints=JOINTS):
    """Frames of the joints: all translations, and rotations except about the axis of hinges and of balls."""
    freed = []
    for name in joints:
        for side in ("parent", "child"):
            freed += frame_parameters(name, f"{side}_translation", range(3), PriorWidths())
            if not name.startswith("hip"):
                freed += frame_parameters(name, f"{side}_orientation", (0, 1), PriorWidths())
    return tuple(freed)


def mirrored(parameters):
    """Parameters of the left side, and the signs that mirror the changes of the right one."""
    left = [replace(entry, owner=entry.owner.removesuffix("_r") + "_l") for entry in parameters]
    # z points to the right: a mirror turns translations along it round, and rotations about the other axes.
    signs = [-1.0 if (entry.axis == 2) != (entry.unit == "rad") else 1.0 for entry in parameters]
    return left, np.array(signs)


def make_person(folder, seed=0, *, both_sides=False):
    """Write the starting model, the true model, and marker files of a gait-like motion.

    With both sides, the left leg differs from the model as the right one does, mirrored.
    """
    model, true_model = folder / "start.osim", folder / "true.osim"
    model.write_text(legs_text(), encoding="utf-8")
    description = describe_model(model)
    names = tuple(marker.name for marker in description.markers)
    coordinates = tuple(entry.name for entry in description.coordinates)
    start = build_marker_model(description, coordinates, names)
    parameters = freed_frames()
    rng = np.random.default_rng(seed)
    size = np.array([0.02 if parameter.unit == "m" else np.radians(10.0) for parameter in parameters])
    truth = rng.uniform(-1.0, 1.0, len(parameters)) * size
    if both_sides:
        left, signs = mirrored(parameters)
        parameters, truth = (*parameters, *left), np.concatenate([truth, signs * truth])
    changed = skeleton_change(description, start, names, parameters).apply(start, truth).skeleton
    rows = {entry.owner: start.structure.joints.index(entry.owner) for entry in parameters}
    frames = {
        name: tuple(
            (
                np.asarray(getattr(changed, f"{side}_rotation")[row]),
                np.asarray(getattr(changed, f"{side}_origin")[row]),
            )
            for side in ("parent", "child")
        )
        for name, row in rows.items()
    }
    write_model_with_joints(model, true_model, JointChanges(frames=frames))
    markers = recorded_by_opensim(true_model, coordinates, gait(coordinates, FRAMES), names)
    write_trc(folder / "walk.trc", markers)
    return Person(folder, model, true_model, markers, parameters, truth)


def settings_text(more="", trials=""):
    """Settings file for the person's folder."""
    trial = '[[trial]]\nname = "walk"\nmarkers = "walk.trc"\n'
    joints = ", ".join(f'"{name}"' for name in JOINTS)
    return (
        f'[subject]\nname = "P"\n[model]\nfile = "start.osim"\n[joints]\nfree = [{joints}]\n'
        f"frames = 30\n{more}{trials or trial}"
    )
