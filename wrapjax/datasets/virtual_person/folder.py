"""Files of a virtual subject's folder: trials and ``subject.toml``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.datasets.virtual_person.anatomy import BODY_MASS_KG, COORDINATES
from wrapjax.datasets.virtual_person.gait import CHANNELS, WalkingCycle
from wrapjax.datasets.virtual_person.leg import on_side
from wrapjax.io.storage import Storage, write_storage
from wrapjax.subject.cycles import cycle_times

MODEL_FILE = "model.osim"
#: Number of frames of angles before and after each cycle, so that spline derivatives are accurate at its
#: ends.
MARGIN_FRAMES = 8


@dataclass(frozen=True)
class Series:
    """Series of gait cycles at one speed.

    Parameters
    ----------
    speed
        Walking speed, m/s.
    calibration, validation
        Number of cycles for calibration and for validation.
    """

    speed: float
    calibration: int
    validation: int


def trial_names(series: Sequence[Series]) -> list[str]:
    """Return the names of the trials, one for each cycle."""
    return [
        f"walk_{entry.speed:g}".replace(".", "p") + f"_{order}"
        for entry in series
        for order in range(1, entry.calibration + entry.validation + 1)
    ]


def write_trial(
    folder: Path,
    side: str,
    cycle: WalkingCycle,
    emg_time: Float[np.ndarray, " padded_frame"],
    emg: Float[np.ndarray, "channel padded_frame"],
    moments: Float[np.ndarray, "coordinate frame"],
) -> None:
    """Write a trial's angles (deg), moments (N m) and EMG envelopes."""
    limits = [(cycle.start, cycle.end)]
    (wide,) = cycle_times(limits, MARGIN_FRAMES)
    (time,) = cycle_times(limits)
    degrees = np.degrees(cycle.angles(wide)).T
    coordinates = tuple(on_side(name, side) for name in COORDINATES)
    moment_columns = tuple(f"{name}_moment" for name in coordinates)
    write_storage(folder / "angles.sto", Storage("coordinates", coordinates, wide, degrees, in_degrees=True))
    write_storage(folder / "moments.sto", Storage("inverse dynamics", moment_columns, time, moments.T))
    write_storage(folder / "emg.sto", Storage("emg envelopes", tuple(CHANNELS), emg_time, emg.T))


def settings_text(
    name: str,
    side: str,
    other_leg: str | None,
    names: Sequence[str],
    cycles: Sequence[WalkingCycle],
    series: Sequence[Series],
    *,
    missing_channels: Sequence[str] = (),
) -> str:
    """Compose ``subject.toml``.

    Parameters
    ----------
    name
        Name of the subject.
    side
        Side of the leg, ``l`` or ``r``.
    other_leg
        Folder of the other leg, relative to this one; None if there is none.
    names, cycles
        Names and gait cycles of the trials.
    series
        Series of cycles, which determine the use of each trial.
    missing_channels
        Channels that were not recorded.
    """
    uses = [
        use
        for entry in series
        for use in ["calibration"] * entry.calibration + ["validation"] * entry.validation
    ]
    quoted = ", ".join(f'"{on_side(coordinate, side)}"' for coordinate in COORDINATES)
    lines = [
        "# A virtual person, simulated by wrapjax. The true parameters are in truth.json.",
        "[subject]",
        f'name = "{name}"',
        f"mass_kg = {BODY_MASS_KG}",
        f'side = "{side}"',
        *([] if other_leg is None else [f'other_leg = "{other_leg}"']),
        "",
        "[model]",
        f'file = "{MODEL_FILE}"',
        f"coordinates = [{quoted}]",
        "",
        "[emg]",
        'kind = "envelope"',
        "[emg.channels]",
    ]
    for electrode, channel in CHANNELS.items():
        if electrode in missing_channels:
            continue
        driven = ", ".join(f'"{on_side(muscle, side)}"' for muscle in channel.scales)
        lines.append(f"{electrode} = [{driven}]")
    for trial, cycle, use in zip(names, cycles, uses, strict=True):
        lines += ["", "[[trial]]", f'name = "{trial}"', f"speed_m_s = {cycle.speed}", f'use = "{use}"']
        lines += [f'{kind} = "trials/{trial}/{kind}.sto"' for kind in ("angles", "moments", "emg")]
        lines.append(f"cycle = [{cycle.start!r}, {cycle.end!r}]")
    return "\n".join(lines) + "\n"
