"""Synthetic person: pelvis and two legs with markers, gait-like motion, and marker files made by OpenSim."""

import numpy as np
import pytest

from wrapjax.osim.body_frames import pose_bodies
from wrapjax.preprocessing.files.markers import Markers

#: Frames per second, and seconds of motion.
RATE, SECONDS = 50.0, 1.6
#: Where markers are on the bodies, m; z points to the right on both sides.
CLUSTERS = {
    "pelvis": [(0.0, 0.02, 0.13), (0.01, 0.03, -0.13), (-0.16, 0.04, 0.05), (-0.16, 0.05, -0.04)],
    "thigh": [(0.06, -0.15, 0.05), (0.03, -0.25, 0.08), (-0.05, -0.3, 0.03), (0.01, -0.4, 0.05)],
    "shank": [(0.04, -0.1, 0.03), (0.0, -0.2, 0.06), (-0.05, -0.25, 0.0), (0.01, -0.38, 0.045)],
    "foot": [(0.12, 0.01, 0.04), (0.14, 0.0, -0.03), (-0.05, 0.02, 0.01), (0.03, 0.05, 0.02)],
}
_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def _coordinates(names):
    entries = "".join(f'<Coordinate name="{name}"><range>-3 3</range></Coordinate>' for name in names)
    return f"<coordinates>{entries}</coordinates>"


def _custom(axes):
    """Axes of a custom joint from (name, coordinate or number, direction)."""
    text = ""
    for name, driven, direction in axes:
        function = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
        if not driven:
            function = "<Constant><value>0</value></Constant>"
        text += (
            f'<TransformAxis name="{name}"><coordinates>{driven}</coordinates>'
            f"<axis>{_AXES[direction]}</axis>{function}</TransformAxis>"
        )
    return f"<SpatialTransform>{text}</SpatialTransform>"


def _joint(kind, name, parent, child, where, turned, coordinates, more=""):
    return (
        f'<{kind}Joint name="{name}"><socket_parent_frame>{name}_parent</socket_parent_frame>'
        f"<socket_child_frame>{name}_child</socket_child_frame>{_coordinates(coordinates)}<frames>"
        f'<PhysicalOffsetFrame name="{name}_parent"><socket_parent>{parent}</socket_parent>'
        f"<translation>{where}</translation><orientation>{turned}</orientation></PhysicalOffsetFrame>"
        f'<PhysicalOffsetFrame name="{name}_child"><socket_parent>/bodyset/{child}</socket_parent>'
        f"<translation>0 0 0</translation><orientation>{turned}</orientation></PhysicalOffsetFrame>"
        f"</frames>{more}</{kind}Joint>"
    )


def legs_text():
    """Write the model: pelvis on ground, hips of three rotations, knees and ankles of one."""
    pelvis = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
    slots = [f"{kind}{number}" for kind in ("rotation", "translation") for number in (1, 2, 3)]
    axes = list(zip(slots, pelvis, "zxyxyz", strict=True))
    joints = _joint("Custom", "ground_pelvis", "/ground", "pelvis", "0 0 0", "0 0 0", pelvis, _custom(axes))
    bodies = ["pelvis"]
    for side, sign in (("r", 1.0), ("l", -1.0)):
        hip = [f"hip_{motion}_{side}" for motion in ("flexion", "adduction", "rotation")]
        axes = list(zip(slots, (*hip, "", "", ""), "zxyxyz", strict=True))
        thigh, shank, foot = (f"{name}_{side}" for name in ("thigh", "shank", "foot"))
        where = f"-0.07 -0.07 {0.08 * sign}"
        joints += _joint(
            "Custom", f"hip_{side}", "/bodyset/pelvis", thigh, where, "0 0 0", hip, _custom(axes)
        )
        turned = f"{0.1 * sign} {-0.05 * sign} 0"
        joints += _joint(
            "Pin", f"knee_{side}", f"/bodyset/{thigh}", shank, "0 -0.41 0", turned, [f"knee_angle_{side}"]
        )
        turned = f"{-0.1 * sign} {0.1 * sign} 0"
        joints += _joint(
            "Pin", f"ankle_{side}", f"/bodyset/{shank}", foot, "0 -0.42 0", turned, [f"ankle_angle_{side}"]
        )
        bodies += [thigh, shank, foot]
    markers = "".join(
        f'<Marker name="{name}"><socket_parent_frame>/bodyset/{body}</socket_parent_frame>'
        f"<location>{' '.join(map(str, location))}</location></Marker>"
        for name, body, location in marker_places()
    )
    parts = "".join(
        f'<Body name="{body}"><mass>5</mass><inertia>0.1 0.1 0.1 0 0 0</inertia></Body>' for body in bodies
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><OpenSimDocument Version="40600"><Model name="legs">'
        f"<BodySet><objects>{parts}</objects></BodySet><JointSet><objects>{joints}</objects></JointSet>"
        f"<MarkerSet><objects>{markers}</objects></MarkerSet></Model></OpenSimDocument>"
    )


def marker_places():
    """Yield name, body and location of each marker; the left side is the right one mirrored, nearly."""
    for place, location in enumerate(CLUSTERS["pelvis"]):
        side = "r" if location[2] > 0 else "l"
        yield f"PEL{place // 2}_{side}", "pelvis", location
    for side, sign in (("r", 1.0), ("l", -1.0)):
        for body in ("thigh", "shank", "foot"):
            for place, (x, y, z) in enumerate(CLUSTERS[body]):
                yield f"{body[:2].upper()}{place}_{side}", f"{body}_{side}", (x, y, sign * z)


def gait(coordinates, count):
    """Values of coordinates in a gait-like motion, rad and m, ``frame coordinate``."""
    phase = np.linspace(0.0, 2.0 * np.pi * SECONDS / 1.1, count)
    values = np.zeros((count, len(coordinates)))
    for column, name in enumerate(coordinates):
        shifted = phase + (np.pi if name.endswith("_l") else 0.0)
        values[:, column] = {
            "pelvis_tx": 0.8 * phase / 6.0,
            "pelvis_ty": 0.95 + 0.02 * np.sin(2.0 * phase),
            "pelvis_tz": 0.02 * np.sin(phase),
            "pelvis_tilt": 0.1 + 0.05 * np.sin(2.0 * phase),
            "pelvis_list": 0.1 * np.sin(phase),
            "pelvis_rotation": 0.15 * np.cos(phase),
            "hip_flexion": 0.15 + 0.5 * np.sin(shifted),
            "hip_adduction": 0.15 * np.cos(shifted),
            "hip_rotation": 0.2 * np.sin(shifted + 1.0),
            "knee_angle": -0.55 + 0.5 * np.sin(shifted + 2.0),
            "ankle_angle": 0.35 * np.sin(shifted + 3.0),
        }[name.removesuffix("_r").removesuffix("_l")]
    return values


def recorded_by_opensim(model_file, coordinates, motion, names):
    """Marker trajectories of a motion as OpenSim computes them."""
    frames = pose_bodies(model_file, coordinates, motion)
    order = [frames.markers.index(name) for name in names]
    time = np.arange(len(motion)) / RATE
    return Markers(tuple(names), time, np.moveaxis(frames.positions[:, order], 0, 1))


@pytest.fixture(scope="session")
def legs_model(tmp_path_factory):
    """File of the synthetic person's model."""
    file = tmp_path_factory.mktemp("legs") / "legs.osim"
    file.write_text(legs_text(), encoding="utf-8")
    return file
