"""Program that writes the walker's recordings into a C3D file: ``python walker_c3d.py RECORDINGS.npz PATH``.

It runs in a separate process, as ezc3d cannot write after OpenSim has been imported.
"""

import sys

import numpy as np

#: Centers of two plates of 8 m by 2 m under the left and the right foot, mm, in laboratory axes: x to the
#: right of the walker, y forward, z up.
CENTERS = np.array([[-100.0, 0.0, 0.0], [100.0, 0.0, 0.0]])


def write(recordings, path):
    """Rotate to laboratory axes, and convert forces to signals of force plates of type 2, N and N mm."""
    import ezc3d

    laboratory = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    content = ezc3d.c3d()
    point, analog = content["parameters"]["POINT"], content["parameters"]["ANALOG"]
    places = 1000.0 * recordings["markers"] @ laboratory.T
    names = [f"Walker:{name}" for name in recordings["names"]]
    point["RATE"]["value"], point["UNITS"]["value"], point["LABELS"]["value"] = [100.0], ("mm",), tuple(names)
    content["data"]["points"] = np.ones((4, len(names), places.shape[1]))
    content["data"]["points"][:3] = np.moveaxis(places, -1, 0)
    channels, labels, corners = [], [], []
    for number, center in enumerate(CENTERS, start=1):
        force = laboratory @ recordings["force"][number - 1]
        arm = 1000.0 * laboratory @ recordings["point"][number - 1] - center[:, None]
        moment = np.cross(arm, force, axis=0)
        # With corners in this order the plates have the axes of the laboratory.
        channels += [*force, *moment]
        labels += [f"{kind}{axis}{number}" for kind in "FM" for axis in "xyz"]
        half = np.array(
            [[1000.0, 4000.0, 0], [-1000.0, 4000.0, 0], [-1000.0, -4000.0, 0], [1000.0, -4000.0, 0]]
        )
        corners.append((center + half).T)
    channels += list(recordings["emg"])
    labels += list(recordings["channels"])
    count = 10 * places.shape[1]
    analog["RATE"]["value"], analog["LABELS"]["value"] = [1000.0], tuple(labels)
    analog["UNITS"]["value"] = tuple(
        "N" if row < 12 and row % 6 < 3 else "Nmm" if row < 12 else "V" for row in range(len(labels))
    )
    padded = [np.pad(row, (0, max(0, count - row.size)), mode="edge")[:count] for row in channels]
    content["data"]["analogs"] = np.array(padded)[None]
    order = np.arange(1.0, 13.0).reshape(2, 6).T
    for name, value in (("USED", [2]), ("TYPE", [2, 2]), ("ZERO", [1, 0]), ("CHANNEL", order)):
        content.add_parameter("FORCE_PLATFORM", name, np.array(value, float))
        content["parameters"]["FORCE_PLATFORM"][name]["type"] = 2  # whole numbers
    content.add_parameter("FORCE_PLATFORM", "CORNERS", np.moveaxis(np.array(corners), 0, -1))
    content.add_parameter("FORCE_PLATFORM", "ORIGIN", np.zeros((3, 2)))
    content.write(path)


if __name__ == "__main__":
    write(np.load(sys.argv[1]), sys.argv[2])
