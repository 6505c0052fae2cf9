"""Markers, analog channels and force plates of ``.c3d`` files, read by ezc3d. The first frame has time zero.

The layout of a file is checked before ezc3d reads it: ezc3d trusts counts and sizes in the file, and a single
wrong byte can make it run for minutes and allocate gigabytes. The layout is that of the C3D User Guide
(https://www.c3d.org/docs/C3D_User_Guide.pdf): blocks of 512 bytes; a header; parameters, each with the offset
of the next; frames.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.files import read_content
from wrapjax.io.storage import Storage
from wrapjax.preprocessing.files.markers import METERS_PER_UNIT, Markers, check_markers
from wrapjax.preprocessing.gait.force_plates import FootForces, ForceColumns

#: Bytes of a block.
_BLOCK = 512
#: Second byte of every C3D file.
_KEY = 0x50
#: Largest number of dimensions of a parameter.
_MAX_DIMENSIONS = 7
#: Byte order by the fourth byte of the parameter section: Intel, DEC and MIPS processors.
_BYTE_ORDERS = {84: "<", 85: "<", 86: ">"}


def is_c3d(path: Path) -> bool:
    """Return whether a file is a C3D file by its name."""
    return path.suffix.lower() == ".c3d"


def check_layout(content: bytes, path: Path) -> None:
    """Check that the header, the parameters and the number of frames of a C3D file are consistent.

    Raises
    ------
    InputError
        If the file is not a C3D file, is truncated, or an offset of a parameter is invalid.
    """
    try:
        _check_content(content)
    except (ValueError, struct.error, IndexError) as error:
        raise InputError(Problem(str(path), f"cannot be read as a C3D file ({error})")) from None


def _check_content(content: bytes) -> None:
    if len(content) < 2 * _BLOCK or content[1] != _KEY or content[0] < 2:
        raise ValueError("its first bytes are not those of a C3D file")
    start = (content[0] - 1) * _BLOCK
    blocks, kind = content[start + 2], content[start + 3]
    if kind not in _BYTE_ORDERS:
        raise ValueError(f"expected 84, 85 or 86 as the processor type, found {kind}")
    order = _BYTE_ORDERS[kind]
    points, analog, first, last = struct.unpack_from(f"{order}4H", content, 2)
    data_block, samples = struct.unpack_from(f"{order}2H", content, 16)
    _check_parameters(content[start : start + max(blocks, 1) * _BLOCK], order)
    # Numbers have at least 2 bytes. Recordings of more than 65,535 frames state their length elsewhere, and
    # are longer.
    min_size = 2 * (4 * points + analog) * max(last - first + 1, 0)
    size = len(content) - (data_block - 1) * _BLOCK
    if data_block < 2 or min_size > size or (analog and analog % max(samples, 1)):
        raise ValueError(f"by its header it has at least {min_size} bytes of frames, found {max(size, 0)}")


def _check_parameters(section: bytes, order: str) -> None:
    """Check that each parameter is within the section, and its values within the parameter."""
    at = 4
    while at < len(section) and section[at] != 0:
        length, group = (
            abs(struct.unpack_from("b", section, at)[0]),
            struct.unpack_from("b", section, at + 1)[0],
        )
        name = section[at + 2 : at + 2 + length]
        here = at + 2 + length
        (step,) = struct.unpack_from(f"{order}H", section, here)
        if not name.isascii() or not name.decode("ascii").isprintable() or group == 0:
            raise ValueError(f"a parameter has no valid name, at byte {at} of the parameter section")
        end = here + step if step else len(section)
        if end > len(section) or (step and step < 3):
            raise ValueError(f"the parameter {name.decode('ascii')} extends beyond the parameter section")
        remark = here + 2  # position of the length of the description
        if group > 0:
            size, count = struct.unpack_from("bB", section, here + 2)
            sizes = section[here + 4 : here + 4 + count]
            remark = here + 4 + count + abs(size) * math.prod(sizes)
            if size not in (-1, 1, 2, 4) or count > _MAX_DIMENSIONS:
                raise ValueError(f"the parameter {name.decode('ascii')} has an unknown type")
        if remark >= end or remark + 1 + section[remark] > end:
            raise ValueError(f"the parameter {name.decode('ascii')} is longer than its offset allows")
        if step == 0:
            return
        at = end


def read_c3d_markers(path: Path) -> Markers:
    """Read all markers, in m and the laboratory's axes; prefixes such as ``Person:`` are removed from names.

    Raises
    ------
    InputError
        If the file is not a C3D file, has no markers, or its markers are refused by `check_markers`.
    """
    content = _open(path)
    points = content["data"]["points"]
    unit = _unit(content["parameters"]["POINT"], path)
    names = tuple(label.rsplit(":", 1)[-1].strip() for label in _labels(content["parameters"]["POINT"]))
    if not names or points.shape[2] == 0:
        raise InputError(Problem(str(path), "expected markers, found none"))
    time = np.arange(points.shape[2]) / float(content["parameters"]["POINT"]["RATE"]["value"][0])
    positions = np.moveaxis(points[:3, : len(names)], 0, -1) * unit
    # A marker that was not visible is NaN or, in files of older programs, at the origin.
    positions = np.where((positions == 0.0).all(axis=-1, keepdims=True), np.nan, positions)
    return check_markers(Markers(names, time, positions.astype(np.float64)), path)


def read_c3d_analog(path: Path) -> Storage:
    """Read all analog channels, in the units of the file.

    Raises
    ------
    InputError
        If the file is not a C3D file or has no analog channels.
    """
    content = _open(path)
    values = content["data"]["analogs"][0]
    labels = tuple(label.strip() for label in _labels(content["parameters"]["ANALOG"]))
    if not labels or values.shape[1] < 2:
        raise InputError(Problem(str(path), "expected analog channels, found none"))
    rate = float(content["parameters"]["ANALOG"]["RATE"]["value"][0])
    time = np.arange(values.shape[1]) / rate
    return Storage("analog", labels, time, values[: len(labels)].T.astype(np.float64))


def read_plates(path: Path, feet: dict[str, ForceColumns], axes: Float[np.ndarray, "3 3"]) -> FootForces:
    """Read the ground reaction force on each foot, summed over its force plates.

    Plates differ in the sign of their forces: if the mean vertical force of a plate points down, the sign of
    all its forces and moments is changed.

    Parameters
    ----------
    path
        File to read.
    feet
        Numbers of the force plates of each foot, by side.
    axes
        Rotation matrix from the laboratory's axes to OpenSim's.

    Raises
    ------
    InputError
        If the file is not a C3D file, lacks a plate, or has an unknown unit.
    """
    content = _open(path, plates=True)
    platforms = content["data"].get("platform", [])
    problems = [
        Problem(
            str(path), f"expected force plate {number}, found {len(platforms)} plates", f"[forces.{side}]"
        )
        for side, foot in feet.items()
        for number in foot.plates
        if number > len(platforms)
    ]
    if problems:
        raise InputError(problems)
    # ezc3d assumes m for the force plates if the file states no unit.
    _unit(content["parameters"]["POINT"], path)
    rate = float(content["parameters"]["ANALOG"]["RATE"]["value"][0])
    wrench = [
        np.sum([_wrench(platforms[number - 1], axes, path) for number in foot.plates], axis=0)
        for foot in feet.values()
    ]
    time = np.arange(wrench[0].shape[1]) / rate
    return FootForces(tuple(feet), time, np.array(wrench))


def _wrench(platform: Any, axes: Float[np.ndarray, "3 3"], path: Path) -> Float[np.ndarray, "6 sample"]:
    length_unit = platform["unit_position"].strip().lower()
    if length_unit not in METERS_PER_UNIT:
        message = f"expected {', '.join(METERS_PER_UNIT)} as the unit of force plates' corners"
        message = f"{message}, found '{length_unit}'"
        raise InputError(Problem(str(path), message))
    moment_unit = platform["unit_moment"].strip().lower().removeprefix("n").lstrip(".* ")
    if platform["unit_force"].strip().lower() != "n" or moment_unit not in METERS_PER_UNIT:
        found = f"{platform['unit_force']} and {platform['unit_moment']}"
        raise InputError(Problem(str(path), f"expected forces in N and moments in Nmm or Nm, found {found}"))
    force = axes @ platform["force"]
    center = axes @ np.nan_to_num(platform["center_of_pressure"]) * METERS_PER_UNIT[length_unit]
    free = axes @ np.nan_to_num(platform["Tz"]) * METERS_PER_UNIT[moment_unit]
    wrench = np.concatenate([np.cross(center, force, axis=0) + free, force])
    return wrench * (-1.0 if wrench[4].sum() < 0.0 else 1.0)


def _open(path: Path, plates: bool = False) -> Any:
    check_layout(read_content(path, "a .c3d file"), path)
    import ezc3d

    try:
        return ezc3d.c3d(str(path), extract_forceplat_data=plates)
    except (OSError, ValueError, RuntimeError, KeyError, IndexError, TypeError) as error:
        message = f"cannot be read as a C3D file ({' '.join(str(error).split())})"
        raise InputError(Problem(str(path), message)) from None


def _labels(group: Any) -> list[str]:
    """List all labels; those beyond the first 255 are in ``LABELS2`` and so on."""
    keys = ["LABELS", *(f"LABELS{number}" for number in range(2, 20))]
    return [label for key in keys if key in group for label in group[key]["value"]]


def _unit(group: Any, path: Path) -> float:
    units = group["UNITS"]["value"] if "UNITS" in group else []
    unit = units[0].strip().lower() if len(units) else ""
    if unit not in METERS_PER_UNIT:
        found = f"'{unit}'" if unit else "none"
        message = f"expected one of {', '.join(METERS_PER_UNIT)} as POINT:UNITS, found {found}"
        raise InputError(Problem(str(path), message))
    return METERS_PER_UNIT[unit]
