"""Recordings of a subject folder, and copies of the folder with changed recordings.

Moments are changed through OpenSim's inverse dynamics: the difference between the solutions with changed and
with recorded inputs is added to the moments of the folder.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.storage import Storage, read_storage, write_storage

#: Cut-off of the angles in inverse dynamics, Hz.
_LOWPASS = 6.0
#: Coordinates that are translations: the tables have these in m.
_TRANSLATION = re.compile(r"_t[xyz]$")


@dataclass(frozen=True)
class Recording:
    """Tables of one recording.

    Parameters
    ----------
    speed
        Walking speed, m/s; NaN where unknown.
    cycles
        Start and end of each of its cycles, s, in their order in time.
    orders
        Place of each cycle in the session: 0 for the first, 1 for the last.
    emg, moments, angles, forces
        Tables; forces are None where there are none.
    files
        File of each table, by its key in ``subject.toml``, relative to the folder; that of external loads
        is ``external_loads``.
    """

    speed: float
    cycles: tuple[tuple[float, float], ...]
    orders: tuple[float, ...]
    emg: Storage
    moments: Storage
    angles: Storage
    forces: Storage | None
    files: Mapping[str, str]

    @property
    def has_loads(self) -> bool:
        """Whether inverse dynamics can be computed from it."""
        return self.forces is not None and "external_loads" in self.files

    def order_at(self, time: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
        """Interpolate the place in the session between the middles of the cycles."""
        return np.interp(time, np.mean(self.cycles, axis=1), self.orders)


def read_recordings(folder: Path) -> list[Recording]:
    """Read the recordings of a valid subject folder, in the order of its trials."""
    trials = settings_of(folder)["trial"]
    by_file: dict[str, list[Mapping[str, Any]]] = {}
    for trial in trials:
        by_file.setdefault(trial["emg"], []).append(trial)
    cycles = [
        sorted(
            tuple(pair) for trial in own for pair in trial.get("cycles", [trial.get("cycle", (-np.inf,) * 2)])
        )
        for own in by_file.values()
    ]
    ends = np.cumsum([0, *map(len, cycles)])
    orders = np.linspace(0.0, 1.0, ends[-1]) if ends[-1] > 1 else np.zeros(1)
    found = []
    for number, (own, pairs) in enumerate(zip(by_file.values(), cycles, strict=True)):
        files = {key: name for key, name in own[0].items() if key in _KEYS}
        tables = {key: read_storage(folder / files[key]) for key in ("emg", "moments", "angles")}
        forces = files.get("ground_forces")
        found.append(
            Recording(
                speed=float(own[0].get("speed_m_s", np.nan)),
                cycles=tuple(pairs),
                orders=tuple(orders[ends[number] : ends[number + 1]].tolist()),
                forces=None if forces is None else read_storage(folder / forces, trust_row_count=False),
                files=files,
                **tables,
            )
        )
    return found


_KEYS = ("emg", "moments", "angles", "ground_forces", "external_loads")


def add_subjects_argument(parser: argparse.ArgumentParser, people: Sequence[str]) -> None:
    """Add ``--subjects``, subject folders; by default these folders of $WRAPJAX_DATA."""
    data = os.environ.get("WRAPJAX_DATA")
    parser.add_argument(
        "--subjects",
        type=Path,
        nargs="+",
        metavar="FOLDER",
        default=[Path(data) / name for name in people] if data else None,
        required=data is None,
        help=f"subject folders (default: {', '.join(people)} of $WRAPJAX_DATA)",
    )


def settings_of(folder: Path) -> dict[str, Any]:
    """Read the settings of a subject folder."""
    return tomllib.loads((folder / "subject.toml").read_text(encoding="utf-8"))


def write_changed(
    source: Path,
    folder: Path,
    changed: Sequence[Recording],
    mass_factors: Mapping[str, float],
    hidden: str = "",
) -> None:
    """Write a copy of a subject folder with changed recordings.

    Moments are those of ``changed``, plus the difference that changed forces, angles and masses make in
    inverse dynamics, where external loads are given.

    Parameters
    ----------
    source, folder
        Subject folder, and the copy.
    changed
        Recordings, in the order of `read_recordings`.
    mass_factors
        Factor on mass and moments of inertia of bodies of the model, by name of the body.
    hidden
        EMG channel that is removed; empty for none.

    Raises
    ------
    InputError
        If the channel or a body does not exist, or inverse dynamics fail.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder)
    if hidden:
        _hide(folder / "subject.toml", hidden)
    model = settings_of(source)["model"]["file"]
    if mass_factors:
        _scale_masses(folder / model, mass_factors)
    for before, after in zip(read_recordings(source), changed, strict=True):
        write_storage(folder / after.files["emg"], after.emg)
        write_storage(folder / after.files["angles"], after.angles)
        if after.forces is not None:
            write_storage(folder / after.files["ground_forces"], after.forces)
        moments = after.moments
        if after.has_loads and (
            mass_factors or after.forces is not before.forces or after.angles is not before.angles
        ):
            difference = _inverse_dynamics(folder, model, after) - _inverse_dynamics(source, model, before)
            moments = replace(moments, values=moments.values + difference)
        write_storage(folder / after.files["moments"], moments)


def _inverse_dynamics(folder: Path, model: str, recording: Recording) -> Float[np.ndarray, "frame column"]:
    """Solve inverse dynamics at the times of the moments; columns are those of the moments."""
    from wrapjax.osim.tools import solve_inverse_dynamics

    angles = recording.angles
    factor = np.pi / 180.0 if angles.in_degrees else 1.0
    values = [
        column if _TRANSLATION.search(name) else factor * column
        for name, column in zip(angles.columns, angles.values.T, strict=True)
    ]
    solved = solve_inverse_dynamics(
        folder / model,
        angles.columns,
        angles.time,
        np.stack(values),
        folder / recording.files["external_loads"],
        _LOWPASS,
    )
    moments = recording.moments
    zero = np.zeros(moments.time.size)
    return np.stack(
        [
            np.interp(moments.time, angles.time, solved[name]) if name in solved else zero
            for name in moments.columns
        ],
        axis=1,
    )


def _hide(settings: Path, channel: str) -> None:
    text, found = re.subn(
        rf'(?m)^"?{re.escape(channel)}"?\s*=.*\n', "", settings.read_text(encoding="utf-8"), count=1
    )
    if not found:
        raise InputError(Problem(str(settings), f"there is no channel '{channel}' to hide"))
    settings.write_text(text, encoding="utf-8")


def _scale_masses(model: Path, factors: Mapping[str, float]) -> None:
    tree = ET.parse(model)
    bodies = {body.get("name"): body for body in tree.iter("Body")}
    for name, factor in factors.items():
        if name not in bodies:
            raise InputError(Problem(str(model), f"there is no body '{name}'"))
        for tag in ("mass", "inertia"):
            entry = bodies[name].find(tag)
            if entry is not None and entry.text:
                entry.text = " ".join(f"{factor * float(value):.10g}" for value in entry.text.split())
    tree.write(model, encoding="utf-8", xml_declaration=True)
