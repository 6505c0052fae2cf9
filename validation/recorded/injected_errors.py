"""Known errors added to the files of recorded walking, in addition to its real noise and model error.

Nothing of `wrapjax.diagnosis` is used, so that the diagnosis does not identify its own formulas.
"""

from __future__ import annotations

import re
import shutil
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, filtfilt

from wrapjax.errors import InputError, Problem
from wrapjax.io.storage import Storage, read_storage, write_storage

#: Magnitudes in prior standard deviations of the effects.
MAGNITUDES = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Cycle:
    """Recorded gait cycle; ``order`` is its place in time, from 0 (first) to 1 (last)."""

    order: float
    speed: float
    emg: Storage
    moments: Storage
    angles: Storage


@dataclass(frozen=True)
class Variant:
    """Recording with an added error.

    Parameters
    ----------
    name
        Name of its folder.
    says
        Description of the change.
    change
        Function that changes all cycles, in their order.
    effect
        Effect of the catalogue that should be found; None if there is none.
    hidden
        EMG channel that is removed; empty for none.
    """

    name: str
    says: str
    change: Callable[[Sequence[Cycle]], list[Cycle]]
    effect: str | None
    hidden: str = ""


def column(table: Storage, name: str) -> int:
    """Return the index of a column."""
    return table.columns.index(name)


def with_delay(cycles: Sequence[Cycle], seconds: float) -> list[Cycle]:
    """Delay all EMG by half the value at the slowest speed, and advance it by half at the fastest."""
    slow, fast = min(c.speed for c in cycles), max(c.speed for c in cycles)

    def shifted(cycle: Cycle) -> Cycle:
        lag = seconds * (0.5 - (cycle.speed - slow) / (fast - slow))
        time, values = cycle.emg.time, cycle.emg.values
        moved = np.stack([np.interp(time - lag, time, own) for own in values.T], axis=1)
        return replace(cycle, emg=replace(cycle.emg, values=moved))

    return [shifted(cycle) for cycle in cycles]


def with_drift(cycles: Sequence[Cycle], channel: str, change: float) -> list[Cycle]:
    """Multiply a channel by a ramp over cycles with mean one and a given change from first to last."""

    def scaled(cycle: Cycle) -> Cycle:
        values = cycle.emg.values.copy()
        values[:, column(cycle.emg, channel)] *= 1.0 + change * (cycle.order - 0.5)
        return replace(cycle, emg=replace(cycle.emg, values=values))

    return [scaled(cycle) for cycle in cycles]


def with_crosstalk(cycles: Sequence[Cycle], source: str, into: str, share: float) -> list[Cycle]:
    """Add a share of one channel to another."""

    def mixed(cycle: Cycle) -> Cycle:
        values = cycle.emg.values.copy()
        values[:, column(cycle.emg, into)] += share * values[:, column(cycle.emg, source)]
        return replace(cycle, emg=replace(cycle.emg, values=values))

    return [mixed(cycle) for cycle in cycles]


def with_spring(cycles: Sequence[Cycle], coordinate: str, stiffness: float) -> list[Cycle]:
    """Add the moment of a spring (stiffness in N m/deg, zero at angle zero) to the measured moment."""

    def sprung(cycle: Cycle) -> Cycle:
        if not cycle.angles.in_degrees:
            raise InputError(Problem(cycle.angles.name, "angles are in radians; degrees are expected"))
        angle = cycle.angles.values[:, column(cycle.angles, coordinate)]
        values = cycle.moments.values.copy()
        values[:, column(cycle.moments, f"{coordinate}_moment")] -= stiffness * np.interp(
            cycle.moments.time, cycle.angles.time, angle
        )
        return replace(cycle, moments=replace(cycle.moments, values=values))

    return [sprung(cycle) for cycle in cycles]


def with_wrong_mass(cycles: Sequence[Cycle], ratio: float) -> list[Cycle]:
    """Scale moments, as if they were normalized by body mass and multiplied by a wrong one."""
    return [
        replace(cycle, moments=replace(cycle.moments, values=ratio * cycle.moments.values))
        for cycle in cycles
    ]


def with_filter(cycles: Sequence[Cycle], kind: str, hertz: float) -> list[Cycle]:
    """Filter one kind of signal again (zero-phase, low-pass), and leave the others unchanged."""

    def smoothed(cycle: Cycle) -> Cycle:
        table: Storage = getattr(cycle, kind)
        rate = (table.time.size - 1) / (table.time[-1] - table.time[0])
        values = filtfilt(*butter(2, hertz, fs=rate), table.values, axis=0)
        filtered = np.maximum(values, 0.0) if kind == "emg" else values
        changed: dict[str, Any] = {kind: replace(table, values=filtered)}
        return replace(cycle, **changed)

    return [smoothed(cycle) for cycle in cycles]


def injections(side: str) -> list[Variant]:
    """List four errors at three magnitudes; the prior SDs are 20 ms, 30 %, 15 % and 1.5 N m/deg."""
    found = []
    for size in MAGNITUDES:
        delay, drift, share, stiffness = 0.020 * size, 0.30 * size, 0.15 * size, 1.5 * size
        found += [
            Variant(
                f"delay_{size:g}",
                f"EMG {1000 * delay:g} ms later at the slowest speed than at the fastest",
                partial(with_delay, seconds=delay),
                "speed_dependent_delay",
            ),
            Variant(
                f"drift_{size:g}",
                f"gain of Sol {100 * drift:g} % up from the first cycle to the last",
                partial(with_drift, channel="Sol", change=drift),
                "emg_drift",
            ),
            Variant(
                f"crosstalk_{size:g}",
                f"{100 * share:g} % of Sol heard by TibAnt",
                partial(with_crosstalk, source="Sol", into="TibAnt", share=share),
                "emg_crosstalk",
            ),
            Variant(
                f"spring_{size:g}",
                f"spring of {stiffness:g} N m/deg at the ankle",
                partial(with_spring, coordinate=f"ankle_angle_{side}", stiffness=stiffness),
                "ankle_foot_orthosis",
            ),
        ]
    return found


def knock_outs() -> list[Variant]:
    """List typical laboratory mistakes and missing electrodes."""
    return [
        *(
            Variant(f"without_{name}", f"no electrode {name}", list, "missing_drive", hidden=name)
            for name in ("TibPost", "GlutMed")
        ),
        Variant(
            "wrong_mass",
            "moments scaled by a mass 15 % too large",
            partial(with_wrong_mass, ratio=1.15),
            None,
        ),
        Variant(
            "smooth_moments",
            "moments filtered once more, at 3 Hz",
            partial(with_filter, kind="moments", hertz=3.0),
            None,
        ),
        Variant(
            "smooth_emg", "EMG filtered once more, at 3 Hz", partial(with_filter, kind="emg", hertz=3.0), None
        ),
    ]


def write_variant(source: Path, folder: Path, variant: Variant) -> None:
    """Write a copy of a subject folder with an added error.

    Raises
    ------
    InputError
        If cycles share files, or the channel to remove does not exist.
    """
    settings = tomllib.loads((source / "subject.toml").read_text(encoding="utf-8"))
    trials = settings["trial"]
    if len({trial["emg"] for trial in trials}) < len(trials):
        raise InputError(Problem(str(source), "several trials share a file; each cycle needs its own"))
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder)
    cycles = [
        Cycle(
            number / max(1, len(trials) - 1),
            float(trial.get("speed_m_s", np.nan)),
            *(read_storage(source / trial[kind]) for kind in ("emg", "moments", "angles")),
        )
        for number, trial in enumerate(trials)
    ]
    for trial, cycle in zip(trials, variant.change(cycles), strict=True):
        write_storage(folder / trial["emg"], cycle.emg)
        write_storage(folder / trial["moments"], cycle.moments)
    if variant.hidden:
        _hide(folder / "subject.toml", variant.hidden)


def _hide(settings: Path, channel: str) -> None:
    text, found = re.subn(
        rf"(?m)^{re.escape(channel)}\s*=.*\n", "", settings.read_text(encoding="utf-8"), count=1
    )
    if not found:
        raise InputError(Problem(str(settings), f"there is no channel '{channel}' to hide"))
    settings.write_text(text, encoding="utf-8")
