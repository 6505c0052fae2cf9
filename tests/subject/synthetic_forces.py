"""Ground reaction forces on the synthetic leg, as functions of time."""

import numpy as np

from tests.subject import synthetic
from tests.subject.synthetic import write_subject
from wrapjax.io.storage import Storage, write_storage
from wrapjax.subject.subject import load_subject as load_subject

#: Point of application of the ground reaction force, m, and moment about it, N m.
POINT, TORQUE = np.array([0.1, -0.75, 0.05]), np.array([1.0, 5.0, -2.0])
COLUMNS = tuple(f"foot_{kind}{axis}" for kind in "vpt" for axis in "xyz")
LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="loads"><objects><ExternalForce name="foot">
<applied_to_body>tibia_l</applied_to_body><force_identifier>foot_v</force_identifier>
<point_identifier>foot_p</point_identifier><torque_identifier>foot_t</torque_identifier>
</ExternalForce></objects></ExternalLoads></OpenSimDocument>"""


def force(time):
    """Compute the ground reaction force on the foot, N, which is in contact for most of a cycle."""
    phase = 2.0 * np.pi * (np.asarray(time) - 0.5) / synthetic.PERIOD
    load = np.maximum(np.sin(phase - 0.3) + 0.6, 0.0) ** 2
    return np.array([-60.0 * load * np.cos(phase), 300.0 * load, 20.0 * load])


def with_forces(folder):
    """Write and load the synthetic subject with ground reaction forces."""
    write_subject(folder)
    add_forces(folder)
    return load_subject(folder)


def add_forces(folder, seconds=4.0):
    """Write ground reaction forces, and name them in the settings of every trial that has EMG."""
    time = np.arange(round(2000 * seconds) + 1) / 2000.0
    still = np.ones((time.size, 3))
    values = np.concatenate([force(time).T, POINT * still, TORQUE * still], axis=1)
    write_storage(folder / "forces.mot", Storage("forces", COLUMNS, time, values))
    (folder / "loads.xml").write_text(LOADS, encoding="utf-8")
    settings = folder / "subject.toml"
    files = '\nground_forces = "forces.mot"\nexternal_loads = "loads.xml"\nemg ='
    settings.write_text(settings.read_text().replace("\nemg =", files))
