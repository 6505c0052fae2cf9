"""Writes all of the walker's recordings into one C3D file: ``python walker_c3d.py RECORDINGS.npz PATH``.

A process of its own, as ezc3d cannot write where OpenSim has been imported.
"""

import sys

import numpy as np

#: Middles of two plates of 8 m by 2 m under the left and the right foot, laboratory axes (mm): x to the
#: walker's right, y ahead, z up.
MIDDLES = np.array([[-100.0, 0.0, 0.0], [100.0, 0.0, 0.0]])


def write(recordings, path):
    """Turn OpenSim's axes into a laboratory's, forces into what plates of type 2 measure, in N and N mm."""
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
    for number, middle in enumerate(MIDDLES, start=1):
        force = laboratory @ recordings["force"][number - 1]
        arm = 1000.0 * laboratory @ recordings["point"][number - 1] - middle[:, None]
        moment = np.cross(arm, force, axis=0)
        # Corners in this order give plates the laboratory's axes.
        channels += [*force, *moment]
        labels += [f"{kind}{axis}{number}" for kind in "FM" for axis in "xyz"]
        half = np.array(
            [[1000.0, 4000.0, 0], [-1000.0, 4000.0, 0], [-1000.0, -4000.0, 0], [1000.0, -4000.0, 0]]
        )
        corners.append((middle + half).T)
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
