"""Program that writes a small C3D file of known content: ``python c3d_file.py PATH SIGN UNIT``."""

import sys

import numpy as np

RATE, FRAMES, RATIO = 100.0, 60, 10
#: Corners of a plate of 0.6 m by 0.4 m with its center at (0.3, 0.2, 0) m in a laboratory with z up, mm.
CORNERS = np.array([[600.0, 0, 0], [600.0, 400, 0], [0.0, 400, 0], [0.0, 0, 0]]).T
PLACES = np.array([[300.0, 100.0, 900.0], [310.0, 150.0, 50.0]])


def write(path, sign, unit):
    """Write two markers (mm), a plate with 700 N of either sign beside its center, and EMG.

    ``unit`` is the unit of length that the file states, which may be wrong.
    """
    import ezc3d

    content = ezc3d.c3d()
    point, analog = content["parameters"]["POINT"], content["parameters"]["ANALOG"]
    point["RATE"]["value"], point["UNITS"]["value"] = [RATE], (unit,)
    point["LABELS"]["value"] = ("Person:KNEE", "Person:HEEL")
    positions = np.ones((4, 2, FRAMES))
    positions[:3] = PLACES.T[:, :, None]
    positions[:3, 1, 20:25] = np.nan
    content["data"]["points"] = positions
    analog["RATE"]["value"] = [RATE * RATIO]
    analog["LABELS"]["value"] = ("Fx", "Fy", "Fz", "Mx", "My", "Mz", "soleus")
    analog["UNITS"]["value"] = ("N", "N", "N", "Nmm", "Nmm", "Nmm", "V")
    values = np.zeros((1, 7, FRAMES * RATIO))
    values[0, 2] = sign * 700.0
    values[0, 3], values[0, 4] = sign * 700.0 * 50.0, -sign * 700.0 * 80.0
    values[0, 6] = np.sin(np.arange(FRAMES * RATIO))
    content["data"]["analogs"] = values
    channels = [[number] for number in range(1, 7)]
    for name, value in (("USED", [1]), ("TYPE", [2]), ("ZERO", [1, 0]), ("CHANNEL", channels)):
        content.add_parameter("FORCE_PLATFORM", name, np.array(value, float))
        content["parameters"]["FORCE_PLATFORM"][name]["type"] = 2  # whole numbers
    content.add_parameter("FORCE_PLATFORM", "CORNERS", CORNERS[:, :, None])
    content.add_parameter("FORCE_PLATFORM", "ORIGIN", np.zeros((3, 1)))
    content.write(path)


if __name__ == "__main__":
    write(sys.argv[1], float(sys.argv[2]), sys.argv[3])
