"""Small synthetic subject folder with analytic signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wrapjax.io.storage import Storage, write_storage

COORDINATES = ("hip_flexion_l", "knee_angle_l")
CHANNELS = {"RecFem": ("recfem_l",), "SemiTen": ("semiten_l",)}
#: Gait period in s; every cycle is one period of the signals.
PERIOD = 1.2
RATE = 100.0
DURATION = 4.0
CYCLES = {"walk_a": ((0.5, 1.7), (1.7, 2.9)), "walk_b": ((0.6, 1.8),)}
MASS = 70.0


def angles(time: np.ndarray) -> np.ndarray:
    """Compute joint angles in rad, one row per coordinate."""
    phase = 2.0 * np.pi * time / PERIOD
    return np.array([0.2 + 0.4 * np.cos(phase), 0.6 + 0.5 * np.sin(phase)])


def angular_velocities(time: np.ndarray) -> np.ndarray:
    """Compute the derivative of `angles` in rad/s."""
    phase = 2.0 * np.pi * time / PERIOD
    return 2.0 * np.pi / PERIOD * np.array([-0.4 * np.sin(phase), 0.5 * np.cos(phase)])


def moments(time: np.ndarray) -> np.ndarray:
    """Compute joint moments in N m, one row per coordinate."""
    phase = 2.0 * np.pi * time / PERIOD
    return np.array([40.0 * np.sin(phase), 10.0 - 30.0 * np.cos(phase)])


def emg(time: np.ndarray) -> np.ndarray:
    """Compute EMG envelopes, one row per channel."""
    phase = 2.0 * np.pi * time / PERIOD
    return np.array([0.5 + 0.4 * np.sin(phase), 0.3 - 0.2 * np.cos(phase)])


def write_subject(folder: Path) -> Path:
    """Write a valid subject (two coordinates, two muscles, three cycles) and return its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    time = np.arange(round(DURATION * RATE) + 1) / RATE
    (folder / "subject.toml").write_text(SETTINGS, encoding="utf-8")
    (folder / "model.osim").write_text(MODEL, encoding="utf-8")
    moment_columns = tuple(f"{name}_moment" for name in COORDINATES)
    for trial in CYCLES:
        place = folder / "trials" / trial
        write_storage(place / "angles.sto", Storage("angles", COORDINATES, time, angles(time).T))
        write_storage(place / "moments.sto", Storage("moments", moment_columns, time, moments(time).T))
        write_storage(place / "emg.sto", Storage("emg", tuple(CHANNELS), time, emg(time).T))
    return folder


def write_wrapped_subject(folder: Path) -> Path:
    """Write the same subject with a cylinder behind the knee that ``semiten_l`` wraps around."""
    write_subject(folder)
    model = MODEL
    for place, ending, added in (
        ('<Body name="femur_l">', "</Body>", CYLINDER),
        ('<Millard2012EquilibriumMuscle name="semiten_l">', "</GeometryPath>", PATH_WRAP),
    ):
        at = model.index(ending, model.index(place))
        model = model[:at] + added + model[at:]
    (folder / "model.osim").write_text(model, encoding="utf-8")
    return folder


def add_muscle(folder: Path, name: str, forward: float) -> None:
    """Add an undriven straight muscle, ``forward`` m in front of the joints, to the subject's model."""
    model = folder / "model.osim"
    muscle = _muscle(name, forward, 700.0, 0.12, 0.28)
    model.write_text(model.read_text().replace("</objects>\n<groups>", f"{muscle}\n</objects>\n<groups>"))


def add_muscle_parameters(folder: Path, *rows: tuple[str, float, float, float, float]) -> None:
    """Add a table of maximum force (N), fiber and slack length (m) and pennation (rad) to the subject."""
    lines = [",".join(map(str, row)) for row in rows]
    labels = "muscle,max_isometric_force_N,optimal_fiber_length_m,tendon_slack_length_m,pennation_rad"
    (folder / "muscle_parameters.csv").write_text("\n".join([labels, *lines, ""]), encoding="utf-8")
    settings = folder / "subject.toml"
    named = '[model]\nmuscle_parameters = "muscle_parameters.csv"'
    settings.write_text(settings.read_text().replace("[model]", named))


SETTINGS = f"""[subject]
name = "synthetic"
mass_kg = {MASS}
side = "l"

[model]
file = "model.osim"
coordinates = ["hip_flexion_l", "knee_angle_l"]

[emg]
kind = "envelope"
[emg.channels]
RecFem = ["recfem_l"]
SemiTen = ["semiten_l"]

[[trial]]
name = "walk_a"
use = "calibration"
speed_m_s = 1.1
angles = "trials/walk_a/angles.sto"
moments = "trials/walk_a/moments.sto"
emg = "trials/walk_a/emg.sto"
cycles = [[0.5, 1.7], [1.7, 2.9]]

[[trial]]
name = "walk_b"
use = "validation"
angles = "trials/walk_b/angles.sto"
moments = "trials/walk_b/moments.sto"
emg = "trials/walk_b/emg.sto"
cycle = [0.6, 1.8]
"""


def _body(name: str) -> str:
    return f"""<Body name="{name}">
 <mass>5</mass><mass_center>0 -0.2 0</mass_center><inertia>0.1 0.1 0.1 0 0 0</inertia>
</Body>"""


def _pin(name: str, parent: str, child: str, coordinate: str, drop: float) -> str:
    offset = parent.rsplit("/", 1)[-1] + "_offset"
    return f"""<PinJoint name="{name}">
 <socket_parent_frame>{offset}</socket_parent_frame>
 <socket_child_frame>{child}_offset</socket_child_frame>
 <coordinates><Coordinate name="{coordinate}">
  <default_value>0.1</default_value><range>-2 2</range><locked>false</locked>
 </Coordinate></coordinates>
 <frames>
  <PhysicalOffsetFrame name="{offset}">
   <socket_parent>{parent}</socket_parent><translation>0 {drop} 0</translation>
  </PhysicalOffsetFrame>
  <PhysicalOffsetFrame name="{child}_offset">
   <socket_parent>/bodyset/{child}</socket_parent>
  </PhysicalOffsetFrame>
 </frames>
</PinJoint>"""


def _muscle(name: str, forward: float, force: float, fiber: float, tendon: float) -> str:
    points = (("/ground", 0.0), ("/bodyset/tibia_l", -0.05))
    path = "".join(
        f"""<PathPoint name="{name}-P{number}">
 <socket_parent_frame>{frame}</socket_parent_frame><location>{forward} {height} 0</location>
</PathPoint>"""
        for number, (frame, height) in enumerate(points, start=1)
    )
    return f"""<Millard2012EquilibriumMuscle name="{name}">
 <GeometryPath name="path"><PathPointSet><objects>{path}</objects></PathPointSet></GeometryPath>
 <max_isometric_force>{force}</max_isometric_force>
 <optimal_fiber_length>{fiber}</optimal_fiber_length>
 <tendon_slack_length>{tendon}</tendon_slack_length>
 <pennation_angle_at_optimal>0.1</pennation_angle_at_optimal>
</Millard2012EquilibriumMuscle>"""


CYLINDER = """<WrapObjectSet name="wrapobjectset"><objects><WrapCylinder name="ST_at_condyles_l">
 <active>true</active><xyz_body_rotation>0 0 0</xyz_body_rotation><translation>-0.01 -0.4 0</translation>
 <quadrant>-x</quadrant><radius>0.035</radius><length>0.2</length>
</WrapCylinder></objects></WrapObjectSet>"""
PATH_WRAP = """<PathWrapSet><objects><PathWrap name="pathwrap">
 <wrap_object>ST_at_condyles_l</wrap_object>
</PathWrap></objects></PathWrapSet>"""

#: Thigh and shank with two pin joints, one muscle in front and one behind. OpenSim 4 can read it.
MODEL = f"""<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000">
<Model name="synthetic">
<BodySet name="bodyset"><objects>{_body("femur_l")}{_body("tibia_l")}</objects></BodySet>
<JointSet name="jointset"><objects>
{_pin("hip_l", "/ground", "femur_l", "hip_flexion_l", 0.0)}
{_pin("knee_l", "/bodyset/femur_l", "tibia_l", "knee_angle_l", -0.4)}
</objects></JointSet>
<ForceSet name="forceset">
<objects>
{_muscle("recfem_l", 0.05, 1500.0, 0.1, 0.3)}
{_muscle("semiten_l", -0.05, 900.0, 0.15, 0.25)}
</objects>
<groups>
<ObjectGroup name="ThighActivationGroupL"><members> recfem_l semiten_l</members></ObjectGroup>
</groups>
</ForceSet>
</Model>
</OpenSimDocument>
"""
