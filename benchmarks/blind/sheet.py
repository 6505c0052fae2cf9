"""A contact sheet of cases, for a person to judge whether this is walking."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.anatomy import CHANNELS, COORDINATES

_COLORS = ("#1b6ca8", "#c4561b", "#3d8c40")


def read_columns(path: Path) -> dict[str, np.ndarray]:
    lines = path.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if line.strip() == "endheader") + 1
    values = np.array([line.split() for line in lines[start + 1 :]], float)
    return dict(zip(lines[start].split("\t"), values.T, strict=True))


def over_cycle(case: Path, kind: str, name: str) -> list[tuple[int, np.ndarray]]:
    """One signal of a case, cycle by cycle on 101 phases, each with its recording's number."""
    settings = tomllib.loads((case / "subject.toml").read_text(encoding="utf-8"))
    out = []
    for trial in settings["trial"]:
        columns = read_columns(case / trial[kind])
        recording = int(trial["name"].split("_")[1]) - 1
        for start, end in trial["cycles"]:
            time = np.linspace(start, end, 101)
            out.append((recording, np.interp(time, columns["time"], columns[name])))
    return out


def draw_sheet(bank: Path, file: Path, count: int = 6, truth: bool = True) -> None:
    """Draw moments, angles and EMG of some cases, one row a case; causes in the margin if wanted."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    cases = sorted((bank / "cases").iterdir())[:count]
    columns = [("angles", c) for c in COORDINATES if c not in ("hip_rotation_r", "subtalar_angle_r")]
    columns += [("moments", f"{c}_moment") for c in COORDINATES]
    columns += [("emg", c) for c in CHANNELS]
    figure, axes = plt.subplots(
        len(cases), len(columns), figsize=(2.0 * len(columns), 1.7 * len(cases)), squeeze=False
    )
    for row, case in zip(axes, cases, strict=True):
        settings = tomllib.loads((case / "subject.toml").read_text(encoding="utf-8"))
        mass = settings["subject"]["mass_kg"]
        for axis, (kind, name) in zip(row, columns, strict=True):
            for recording, values in over_cycle(case, kind, name):
                axis.plot(values / (mass if kind == "moments" else 1.0), lw=0.6, color=_COLORS[recording])
            axis.tick_params(labelsize=5, length=1, pad=1)
            axis.axhline(0.0, color="0.8", lw=0.5, zorder=0)
            unit = {"angles": "deg", "moments": "N m/kg", "emg": ""}[kind]
            axis.set_title(f"{name.removesuffix('_moment').removesuffix('_r')} {unit}", fontsize=6, pad=2)
        label = case.name[:6]
        if truth:
            known = json.loads((bank / "truth" / f"{case.name}.json").read_text(encoding="utf-8"))
            causes = [
                f"{c['id']} {'/'.join(c['variant'])}\n{c['amount']:.3g} {c['unit'][:18]}"
                for c in known["causes"]
            ]
            label = "\n".join(
                [f"{known['tier']}, d* {known['d_star']:.1f}, {100 * known['emg_noise']:.0f} %", *causes]
            )
        row[0].set_ylabel(label, fontsize=5)
    figure.tight_layout(pad=0.3)
    figure.savefig(file, dpi=80, metadata={"Software": None})
    plt.close(figure)


def effect_sizes(bank: Path) -> list[dict[str, Any]]:
    """What each truth's causes amount to, for a look at their sizes."""
    out = []
    for path in sorted((bank / "truth").glob("*.json")):
        known = json.loads(path.read_text(encoding="utf-8"))
        out.extend({"tier": known["tier"], **cause} for cause in known["causes"])
    return out
