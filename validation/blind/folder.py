"""Subject folder of a case, in which only the signals depend on the cause.

Text files of a kind are padded to one size, and all files have one time stamp and the same names in every
case.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from validation.blind.anatomy import CHANNELS, COORDINATES, Leg
from validation.blind.gait import FILE_RATE, RATE
from validation.blind.leg_file import leg_text
from validation.blind.opensim_leg import ALL_COORDINATES
from validation.blind.worlds import USUAL_GAIT

FILE_STEP = int(RATE / FILE_RATE)
_STAMP = 946_684_800  # 2000-01-01
_SIZES = {".osim": 40_960, ".toml": 6_144, ".xml": 1_536}
_GROUND = [f"ground_force_r_{kind}{axis}" for kind in "vp" for axis in "xyz"]
_GROUND += [f"ground_torque_r_{axis}" for axis in "xyz"]
_LOADS = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000">
<ExternalLoads name="ground"><objects><ExternalForce name="right_foot">
<applied_to_body>calcn_r</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body>
<point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>ground_force_r_v</force_identifier>
<point_identifier>ground_force_r_p</point_identifier>
<torque_identifier>ground_torque_r_</torque_identifier>
</ExternalForce></objects><groups /><datafile>ground_forces.mot</datafile></ExternalLoads>
</OpenSimDocument>
"""


def write_folder(
    folder: Path,
    nominal: Leg,
    paretic: bool,
    speeds: Sequence[float],
    uses: list[list[tuple[float, float]]],
    recorded: dict[str, np.ndarray],
    calibration: int = USUAL_GAIT.calibration,
    unrecorded: Sequence[str] = (),
) -> None:
    """Write a subject folder.

    ``recorded`` has moments, emg, pose and ground, each (recording, row, frame) on the fine time base;
    ``calibration`` is the number of calibration cycles of each recording. ``unrecorded`` channels are left
    out.
    """
    channels = {name: muscles for name, muscles in CHANNELS.items() if name not in unrecorded}
    chosen = [row for row, name in enumerate(CHANNELS) if name in channels]
    folder.mkdir(parents=True)
    _text(folder / "model.osim", leg_text(nominal), "<!--", "-->")
    _text(
        folder / "subject.toml",
        _settings(folder.name, nominal, paretic, speeds, uses, calibration, channels),
        "#",
        "",
    )
    rotational = np.array(
        [not name.startswith("pelvis_t") or name == "pelvis_tilt" for name in ALL_COORDINATES]
    )
    angles = np.where(rotational[None, :, None], np.degrees(recorded["pose"]), recorded["pose"])
    for index in range(len(speeds)):
        place = folder / "trials" / f"walk_{index + 1}"
        place.mkdir(parents=True)
        write_table(place / "angles.sto", "coordinates", ALL_COORDINATES, angles[index], True)
        write_table(
            place / "moments.sto", "moments", [f"{c}_moment" for c in COORDINATES], recorded["moments"][index]
        )
        write_table(place / "emg.sto", "envelopes", tuple(channels), recorded["emg"][index][chosen])
        write_table(place / "ground_forces.mot", "ground", _GROUND, recorded["ground"][index])
        _text(place / "external_loads.xml", _LOADS, "<!--", "-->")
    for path in sorted(folder.rglob("*"), reverse=True):
        os.utime(path, (_STAMP, _STAMP))
    os.utime(folder, (_STAMP, _STAMP))


def _text(path: Path, text: str, opening: str, closing: str) -> None:
    """Write text, padded by a comment to the size of all files of this kind."""
    size = _SIZES[path.suffix]
    room = size - len(text.encode()) - len(opening) - len(closing) - 1
    if room < 0:
        raise ValueError(f"{path.name} is {-room} bytes larger than {size}")
    path.write_text(text + opening + " " * room + closing + "\n", encoding="utf-8", newline="\n")


def write_table(
    path: Path, name: str, columns: Sequence[str], values: np.ndarray, degrees: bool = False
) -> None:
    """Write an OpenSim storage file of values (row, frame) on the fine time base."""
    rows = values[:, ::FILE_STEP].T
    time = np.arange(rows.shape[0]) / FILE_RATE
    lines = [name, "version=1", f"nRows={rows.shape[0]}", f"nColumns={len(columns) + 1}"]
    lines += [f"inDegrees={'yes' if degrees else 'no'}", "endheader", "\t".join(["time", *columns])]
    # Adding zero removes the sign of -0; seven digits are the same on every machine.
    lines += [
        "\t".join([f"{t:8.4f}", *(f"{v + 0.0:14.6e}" for v in row)])
        for t, row in zip(time, rows, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _settings(name, leg, paretic, speeds, uses, calibration, channels) -> str:
    quoted = ", ".join(f'"{coordinate}"' for coordinate in COORDINATES)
    lines = [
        "[subject]",
        f'name = "{name}"',
        f"mass_kg = {leg.mass:.3f}",
        'side = "r"',
        f"paretic = {str(paretic).lower()}",
        "",
        "[model]",
        'file = "model.osim"',
        f"coordinates = [{quoted}]",
        "",
        "[emg]",
        'kind = "envelope"',
        "[emg.channels]",
    ]
    for channel, muscles in channels.items():
        driven = ", ".join(f'"{muscle}_r"' for muscle in muscles)
        lines.append(f"{channel} = [{driven}]")
    for index, (speed, pairs) in enumerate(zip(speeds, uses, strict=True)):
        last = index == len(speeds) - 1
        split = {
            "calibration": [] if last else pairs[:calibration],
            "validation": pairs if last else pairs[calibration:],
        }
        for use, some in split.items():
            if not some:
                continue
            shown = ", ".join(f"[{a:.4f}, {b:.4f}]" for a, b in some)
            lines += ["", "[[trial]]", f'name = "walk_{index + 1}_{use}"', f"speed_m_s = {speed:.3f}"]
            lines += [f'use = "{use}"']
            lines += [
                f'{kind} = "trials/walk_{index + 1}/{kind}.sto"' for kind in ("angles", "moments", "emg")
            ]
            lines.append(f'ground_forces = "trials/walk_{index + 1}/ground_forces.mot"')
            lines.append(f'external_loads = "trials/walk_{index + 1}/external_loads.xml"')
            lines.append(f"cycles = [{shown}]")
    return "\n".join(lines) + "\n"
