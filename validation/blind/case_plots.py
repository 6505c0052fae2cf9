"""Plot of the signals of several cases, to check visually that they look like walking."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.anatomy import CHANNELS, COORDINATES

_COLORS = ("#1b6ca8", "#c4561b", "#3d8c40")


def read_columns(path: Path) -> dict[str, np.ndarray]:
    lines = path.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if line.strip() == "endheader") + 1
    values = np.array([line.split() for line in lines[start + 1 :]], float)
    return dict(zip(lines[start].split("\t"), values.T, strict=True))


def over_cycle(case: Path, kind: str, name: str) -> list[tuple[int, np.ndarray]]:
    """Read one signal of a case by cycle at 101 phases, with the number of its recording."""
    settings = tomllib.loads((case / "subject.toml").read_text(encoding="utf-8"))
    out = []
    for trial in settings["trial"]:
        columns = read_columns(case / trial[kind])
        recording = int(trial["name"].split("_")[1]) - 1
        for start, end in trial["cycles"]:
            time = np.linspace(start, end, 101)
            out.append((recording, np.interp(time, columns["time"], columns[name])))
    return out


def draw_cases(bank: Path, file: Path, count: int = 6, truth: bool = True) -> None:
    """Plot angles, moments and EMG of several cases, with their true causes as text."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    cases = sorted((bank / "cases").iterdir())[:count]
    upper = [("angles", c) for c in COORDINATES] + [("moments", f"{c}_moment") for c in COORDINATES]
    lower = [("emg", c) for c in CHANNELS]
    figure, axes = plt.subplots(
        2 * len(cases), len(lower), figsize=(1.55 * len(lower), 2.6 * len(cases)), squeeze=False
    )
    for index, case in enumerate(cases):
        settings = tomllib.loads((case / "subject.toml").read_text(encoding="utf-8"))
        mass = settings["subject"]["mass_kg"]
        # Some worlds have fewer channels.
        recorded = [signal for signal in lower if signal[1] in settings["emg"]["channels"]]
        for row, signals in zip(axes[2 * index : 2 * index + 2], (upper, recorded), strict=True):
            for axis, (kind, name) in zip(row, signals, strict=False):
                _draw_signal(axis, case, kind, name, mass)
        note = axes[2 * index, -1]
        note.axis("off")
        note.text(0, 1, _described(bank, case) if truth else case.name, fontsize=5.5, va="top", wrap=True)
    figure.tight_layout(pad=0.3)
    figure.savefig(file, dpi=90, metadata={"Software": None})
    plt.close(figure)


def _draw_signal(axis: Any, case: Path, kind: str, name: str, mass: float) -> None:
    for recording, values in over_cycle(case, kind, name):
        axis.plot(values / (mass if kind == "moments" else 1.0), lw=0.6, color=_COLORS[recording])
    axis.tick_params(labelsize=5, length=1, pad=1)
    axis.axhline(0.0, color="0.8", lw=0.5, zorder=0)
    unit = {"angles": "deg", "moments": "N m/kg", "emg": ""}[kind]
    axis.set_title(f"{name.removesuffix('_moment').removesuffix('_r')} {unit}", fontsize=6, pad=2)


def _described(bank: Path, case: Path) -> str:
    known = json.loads((bank / "truth" / f"{case.name}.json").read_text(encoding="utf-8"))
    lines = [known["tier"], f"d* {known['d_star']:.1f}, EMG noise {100 * known['emg_noise']:.0f} %"]
    for cause in known["causes"]:
        lines += ["", cause["id"], " ".join(cause["variant"]), f"{cause['amount']:.3g} {cause['unit'][:24]}"]
    return "\n".join(lines)
