"""Program that writes analog channels alone as a C3D file: ``python analog_file.py PATH TABLE RATE``."""

import sys

import numpy as np


def write(path, table, rate):
    """Write the columns of a comma-separated table, sampled at a rate (Hz), as channels in V."""
    import ezc3d

    with open(table, encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        values = np.loadtxt(file, delimiter=",")
    content = ezc3d.c3d()
    analog = content["parameters"]["ANALOG"]
    content["parameters"]["POINT"]["RATE"]["value"] = [rate]
    content["parameters"]["POINT"]["UNITS"]["value"] = ("mm",)
    analog["RATE"]["value"] = [rate]
    analog["LABELS"]["value"] = tuple(names)
    analog["UNITS"]["value"] = ("V",) * len(names)
    content["data"]["points"] = np.ones((4, 0, len(values)))
    content["data"]["analogs"] = values.T[None]
    content.write(path)


if __name__ == "__main__":
    write(sys.argv[1], sys.argv[2], float(sys.argv[3]))
