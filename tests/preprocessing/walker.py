"""Simulated walker in the sagittal plane with known motion, forces and EMG, and its laboratory files.

Positions of markers and of the center of mass are computed by OpenSim; of wrapjax only the writer of tables
is used.
"""

import functools

import numpy as np
import opensim
from scipy.interpolate import CubicSpline

from tests.preprocessing.synthetic_emg import raw_emg
from wrapjax.io.storage import Storage, read_storage, write_storage

PERIOD, MASS, GRAVITY = 1.1, 70.0, 9.80665
#: Left heel strikes; the right foot's are half a period later.
STRIKES = 0.45 + PERIOD * np.arange(4)
DURATION, MARKER_RATE, FORCE_RATE, EMG_RATE = 4.3, 100.0, 1000.0, 1000.0
STANCE = 0.62
CHANNELS = {"Sol": ("soleus_l",), "RF": ("recfem_l",), "TA": ("tibant_l",)}
COORDINATES = ("hip_flexion_l", "knee_angle_l", "ankle_angle_l")


def motion(time):
    """Compute the independent coordinates of the model, rad or m."""
    values = {
        "pelvis_tilt": 0.05 * np.sin(4.0 * np.pi * time / PERIOD),
        "pelvis_tx": 0.02 * np.cos(4.0 * np.pi * time / PERIOD),
        "pelvis_ty": 0.95 - 0.025 * np.cos(4.0 * np.pi * (time - STRIKES[0]) / PERIOD + 0.6),
    }
    for side, late in (("l", 0.0), ("r", 0.5)):
        phase = 2.0 * np.pi * ((time - STRIKES[0]) / PERIOD - late)
        values[f"hip_flexion_{side}"] = 0.1 + 0.4 * np.cos(phase + 0.3)
        values[f"knee_angle_{side}"] = -0.5 + 0.3 * np.sin(phase + 0.4) - 0.1 * np.cos(2.0 * phase)
        values[f"ankle_angle_{side}"] = 0.1 * np.sin(phase - 1.0) + 0.08 * np.cos(2.0 * phase)
    return values


def _body(model, name, mass, center):
    inertia = opensim.Inertia(*(mass * np.array([0.02, 0.01, 0.02])))
    body = opensim.Body(name, mass, opensim.Vec3(*center), inertia)
    model.addBody(body)
    return body


def _pin(model, parent, where, child, coordinate, limits=(-2.5, 2.5)):
    zero = opensim.Vec3(0)
    joint = opensim.PinJoint(f"{coordinate}_joint", parent, opensim.Vec3(*where), zero, child, zero, zero)
    joint.updCoordinate().setName(coordinate)
    joint.updCoordinate().setRangeMin(limits[0])
    joint.updCoordinate().setRangeMax(limits[1])
    model.addJoint(joint)


def _markers(model, body, label, *places):
    for number, place in enumerate(places):
        model.addMarker(opensim.Marker(f"{label}{number}", body, opensim.Vec3(*place)))


def _muscle(model, name, *points):
    muscle = opensim.Millard2012EquilibriumMuscle(name, 1000.0, 0.1, 0.2, 0.0)
    for number, (body, where) in enumerate(points):
        muscle.addNewPathPoint(f"{name}-P{number}", body, opensim.Vec3(*where))
    model.addForce(muscle)


def build_walker():
    """Build a model of the trunk and two legs with pin joints; each patella is coupled to its knee."""
    opensim.Logger.setLevelString("Off")
    model = opensim.Model()
    model.setName("walker")
    pelvis = _body(model, "pelvis", 0.68 * MASS, (0, 0.25, 0))
    zero = opensim.Vec3(0)
    root = opensim.PlanarJoint("ground_pelvis", model.getGround(), zero, zero, pelvis, zero, zero)
    for order, name in enumerate(("pelvis_tilt", "pelvis_tx", "pelvis_ty")):
        root.upd_coordinates(order).setName(name)
    model.addJoint(root)
    _markers(model, pelvis, "P", (0.1, 0, 0.1), (0.1, 0, -0.1), (-0.1, 0.05, 0), (0, 0.5, 0))
    for side, out in (("l", -0.1), ("r", 0.1)):
        femur = _body(model, f"femur_{side}", 0.10 * MASS, (0, -0.18, 0))
        tibia = _body(model, f"tibia_{side}", 0.045 * MASS, (0, -0.18, 0))
        foot = _body(model, f"calcn_{side}", 0.012 * MASS, (0.08, 0, 0))
        patella = _body(model, f"patella_{side}", 0.003 * MASS, (0, 0, 0))
        _pin(model, pelvis, (0, -0.05, out), femur, f"hip_flexion_{side}")
        _pin(model, femur, (0, -0.42, 0), tibia, f"knee_angle_{side}")
        _pin(model, tibia, (0, -0.42, 0), foot, f"ankle_angle_{side}")
        _pin(model, femur, (0.04, -0.4, 0), patella, f"knee_angle_{side}_beta", (-99.0, 99.0))
        coupler = opensim.CoordinateCouplerConstraint()
        coupler.setName(f"patella_{side}")
        coupler.setIndependentCoordinateNames(_names(f"knee_angle_{side}"))
        coupler.setDependentCoordinateName(f"knee_angle_{side}_beta")
        coupler.setFunction(opensim.LinearFunction(0.7, 0.1))
        model.addConstraint(coupler)
        label = side.upper()
        _markers(model, femur, f"{label}T", (0.06, -0.1, 0), (-0.05, -0.3, 0), (0.03, -0.4, out / 2))
        _markers(model, tibia, f"{label}S", (0.04, -0.1, 0), (-0.04, -0.25, 0), (0, -0.4, out / 2))
        _markers(model, foot, f"{label}F", (-0.04, 0, 0), (0.15, 0.02, 0), (0.1, 0.06, out / 2))
        _muscle(model, f"soleus_{side}", (tibia, (-0.03, -0.2, 0)), (foot, (-0.04, 0.02, 0)))
        _muscle(model, f"tibant_{side}", (tibia, (0.03, -0.2, 0)), (foot, (0.05, 0.02, 0)))
        _muscle(model, f"recfem_{side}", (pelvis, (0.05, 0, out)), (tibia, (0.05, -0.05, 0)))
    model.finalizeConnections()
    return model


def _names(*names):
    array = opensim.ArrayStr()
    for name in names:
        array.append(name)
    return array


@functools.cache
def simulated_positions():
    """Compute time, marker names, and positions of markers, heels (side, frame, 3) and center of mass."""
    model = build_walker()
    state = model.initSystem()
    time = np.arange(round(DURATION * MARKER_RATE) + 1) / MARKER_RATE
    values = motion(time)
    markers = [model.getMarkerSet().get(index) for index in range(model.getMarkerSet().getSize())]
    heels = [model.getBodySet().get(f"calcn_{side}") for side in "lr"]
    found = []
    for frame in range(time.size):
        for name, series in values.items():
            model.getCoordinateSet().get(name).setValue(state, float(series[frame]), False)
        for side in "lr":
            beta = 0.7 * values[f"knee_angle_{side}"][frame] + 0.1
            model.getCoordinateSet().get(f"knee_angle_{side}_beta").setValue(state, float(beta), False)
        model.realizePosition(state)
        found.append(
            [marker.getLocationInGround(state).to_numpy() for marker in markers]
            + [heel.getPositionInGround(state).to_numpy() for heel in heels]
            + [model.calcMassCenterPosition(state).to_numpy()]
        )
    places = np.moveaxis(np.array(found), 0, 1)
    names = tuple(marker.getName() for marker in markers)
    return time, names, places[: len(names)], places[len(names) : -1], places[-1]


def load_share(time, strike):
    """Compute the share of the load on the foot that strikes at this time; it varies in double support."""
    phase = ((time - strike) / PERIOD) % 1.0
    both = STANCE - 0.5
    rise, fall = (np.clip(edge / both, 0.0, 1.0) for edge in (phase, STANCE - phase))
    return (3.0 * rise**2 - 2.0 * rise**3) * (3.0 * fall**2 - 2.0 * fall**3)


def forces(time):
    """Compute force and center of pressure of each foot that satisfy Newton's law for the center of mass."""
    frames, _, _, heels, center = simulated_positions()
    acceleration = CubicSpline(frames, center)(time, 2).T
    total = MASS * (acceleration + np.array([[0.0], [GRAVITY], [0.0]]))
    pairs = []
    shares = [load_share(time, STRIKES[0]), load_share(time, STRIKES[0] - PERIOD / 2)]
    for heel, part, strike in zip(heels, shares, (STRIKES[0], STRIKES[0] - PERIOD / 2), strict=True):
        phase = ((time - strike) / PERIOD) % 1.0
        point = CubicSpline(frames, heel)(time).T
        point[0] += -0.03 + 0.2 * np.clip(phase / STANCE, 0.0, 1.0)
        point[1] = 0.0
        pairs.append((total * part / sum(shares), point))
    return pairs


def volts(seed=0):
    """Generate EMG of `CHANNELS` in V; the calf is active late in stance."""
    time, carrier = raw_emg(DURATION, len(CHANNELS), seed, EMG_RATE)
    phase = (time - STRIKES[0]) / PERIOD % 1.0
    calf = np.exp(-(((phase - 0.40) / 0.09) ** 2))
    noise = np.random.default_rng(seed + 100).standard_normal(time.size)
    carrier[0] = 3e-4 * calf * np.diff(noise, prepend=0.0) + 2e-6 * noise
    return time, carrier


def write_trc(path, time, names, places, unit="mm"):
    """Write markers as camera software does."""
    scale = {"mm": 1000.0, "m": 1.0}[unit]
    rows = [
        f"{frame + 1}\t{at:.5f}\t" + "\t".join(f"{value * scale:.5f}" for value in places[:, frame].ravel())
        for frame, at in enumerate(time)
    ]
    head = [
        "PathFileType\t4\t(X/Y/Z)\twalk.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"100\t100\t{time.size}\t{len(names)}\t{unit}\t100\t1\t{time.size}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{n + 1}" for n in range(len(names)) for axis in "XYZ"),
        "",
    ]
    path.write_text("\n".join(head + rows) + "\n", encoding="utf-8")


def write_laboratory(folder):
    """Write model, markers, forces, EMG and laboratory settings, and return the settings file."""
    folder.mkdir(parents=True, exist_ok=True)
    build_walker().printToXML(str(folder / "scaled.osim"))
    time, names, places, _, _ = simulated_positions()
    write_trc(folder / "walk.trc", time, names, places)
    sample = np.arange(round(DURATION * FORCE_RATE) + 1) / FORCE_RATE
    columns, series = [], []
    for foot, (force, point) in zip(("left", "right"), forces(sample), strict=True):
        columns += [f"{foot}_{kind}{axis}" for kind in "vp" for axis in "xyz"]
        series += [*force, *point]
    write_storage(folder / "forces.mot", Storage("forces", tuple(columns), sample, np.array(series).T))
    emg_time, emg = volts()
    write_storage(folder / "emg.sto", Storage("emg", tuple(CHANNELS), emg_time, emg.T))
    settings = folder / "prepare.toml"
    settings.write_text(SETTINGS, encoding="utf-8")
    return settings


def write_laboratory_with_angles(folder):
    """Write the same with the true angles in place of markers, and return the settings file."""
    settings = write_laboratory(folder)
    time = simulated_positions()[0]
    angles = motion(time)
    write_storage(
        folder / "angles.sto", Storage("angles", tuple(angles), time, np.array(list(angles.values())).T)
    )
    replace_text(settings, ('markers = "walk.trc"', 'angles = "angles.sto"'))
    return settings


def change_table(settings, name, change):
    """Change time and columns (by name) of a table beside the settings."""
    file = settings.parent / name
    table = read_storage(file)
    time, columns = change(table.time, dict(zip(table.columns, table.values.T, strict=True)))
    write_storage(file, Storage(table.name, tuple(columns), time, np.array(list(columns.values())).T))


def replace_text(settings, *pairs):
    """Replace parts of the settings, which they must have."""
    text = settings.read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    settings.write_text(text)


SETTINGS = f"""[subject]
name = "walker"
mass_kg = {MASS}
side = "l"

[model]
file = "scaled.osim"
coordinates = ["hip_flexion_l", "knee_angle_l", "ankle_angle_l"]

[forces.l]
body = "calcn_l"
force = "left_v"
point = "left_p"
[forces.r]
body = "calcn_r"
force = "right_v"
point = "right_p"

[emg]
unit = "V"
[emg.channels]
Sol = ["soleus_l"]
RF = ["recfem_l"]
TA = ["tibant_l"]

[[trial]]
name = "walk"
use = "calibration"
speed_m_s = 1.2
markers = "walk.trc"
forces = "forces.mot"
emg = "emg.sto"
"""
