"""Draw the pictures of the README and of the tutorial from the results of ``wrapjax demo``.

``python docs/draw_pictures.py DEMO [BROWSER]`` reads the folder that ``wrapjax demo --out DEMO`` wrote, and
writes `docs/images/`. With the program of a Chromium browser it also takes pictures of two reports.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import wrapjax
from wrapjax.geometry.exact_paths.engine import ExactPaths, nominal_parameters, wrap_at_samples
from wrapjax.geometry.exact_paths.wrapping import WRAP_PARAMETERS
from wrapjax.io.storage import read_storage
from wrapjax.jax_setup import set_up_jax
from wrapjax.osim.model import describe_model
from wrapjax.report.style import BLACK, BLUE, GRAY, VERMILION, Axes, in_style, new_figure

IMAGES = Path(__file__).parent / "images"
#: Cycle that no calibration has seen.
CYCLE = "walk_0p8_4"
#: Muscle and coordinate of the moment arm that is drawn: that with the largest error before calibration.
MUSCLE, ABOUT = "bfsh_r", "knee_angle_r"


def _read_json(file: Path) -> Any:
    return json.loads(file.read_text(encoding="utf-8"))


def draw_moments(panel: Axes, demo: Path, coordinate: str) -> None:
    """Draw one joint's moments in the cycle that was kept back: measured, by NGA and by PGA."""
    for method, color, style in (("NGA", VERMILION, "--"), ("PGA", BLUE, "-")):
        table = read_storage(demo / method / "moments" / f"{CYCLE}.sto")
        percent = np.linspace(0.0, 100.0, len(table.time))
        if method == "NGA":
            panel.plot(
                percent,
                table.values[:, table.columns.index(f"{coordinate}_moment_measured")],
                color=BLACK,
                label="measured",
            )
        panel.plot(
            percent,
            table.values[:, table.columns.index(f"{coordinate}_moment")],
            style,
            color=color,
            label=method,
        )


def draw_moment_arm(panel: Axes, demo: Path) -> None:
    """Draw one moment arm over a gait cycle with the nominal, the calibrated and the true cylinder."""
    subject = wrapjax.load_subject(demo / "virtual_subject")
    trials, model = subject.trials, describe_model(subject.model_file)
    cycle = trials.angles[trials.names.index(CYCLE)].T
    posed = ExactPaths(model, (MUSCLE,), trials.coordinates).posed(cycle)[MUSCLE]
    wraps = _read_json(demo / "demo.json")["wrap_recovery"]["wraps"]
    names = [entry.wrap for entry in model.muscle(MUSCLE).wraps]
    samples = [nominal_parameters(len(names))] + [
        np.array([[wraps[name][kind][parameter] for parameter in WRAP_PARAMETERS] for name in names])
        for kind in ("found", "true")
    ]
    arms = 1e3 * wrap_at_samples(posed, np.stack(samples)).moment_arm[..., trials.coordinates.index(ABOUT)]
    percent = np.linspace(0.0, 100.0, arms.shape[-1])
    for arm, color, style, label in zip(
        arms, (GRAY, BLUE, BLACK), (":", "-", "-"), ("model's cylinder", "PGA", "true"), strict=True
    ):
        panel.plot(percent, arm, style, color=color, label=label)


def draw_map(panel: Axes, demo: Path, speed: float) -> Any:
    """Draw the repeatable error at one speed of the person with a hidden effect; return the drawn cells."""
    rows = _read_json(demo / "gap" / "gap.json")["where"]
    names = sorted({row["coordinate"] for row in rows}, reverse=True)
    bins = sorted({tuple(row["phase_percent"]) for row in rows})
    values = np.zeros((len(names), len(bins)))
    for row in rows:
        if row["speed_m_s"] == speed:
            place = names.index(row["coordinate"]), bins.index(tuple(row["phase_percent"]))
            values[place] = row["explainable_rms_Nm"]
    edges = [*(first for first, _ in bins), bins[-1][1]]
    highest = max(row["explainable_rms_Nm"] for row in rows)
    panel.set_yticks(np.arange(len(names)) + 0.5, names, parse_math=False)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("gait cycle (%)")
    rows_edges = np.arange(len(names) + 1)
    return panel.pcolormesh(edges, rows_edges, values, cmap="YlGnBu", vmin=0.0, vmax=highest)


def speeds_of_map(demo: Path) -> list[float]:
    """List the walking speeds of the diagnosed person."""
    return sorted({row["speed_m_s"] for row in _read_json(demo / "gap" / "gap.json")["where"]})


@in_style
def draw_overview(demo: Path) -> None:
    """Draw the README's picture: a moment arm, a joint moment, and the map of the remaining error."""
    figure = new_figure(10.0, 2.6)
    arm, moment, where = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.1))
    draw_moment_arm(arm, demo)
    arm.set_title(f"moment arm, {MUSCLE}, knee (mm)", loc="left", parse_math=False)
    draw_moments(moment, demo, "hip_adduction_r")
    moment.set_title("hip adduction moment (N m)", loc="left")
    image = draw_map(where, demo, speeds_of_map(demo)[-1])
    figure.colorbar(image, ax=where, label="repeatable error (N m)", pad=0.02)
    where.set_title("what is left in another person", loc="left")
    for panel in (arm, moment):
        panel.set_xlabel("gait cycle (%)")
    arm.legend(loc=(0.02, 0.1))
    moment.legend()
    figure.savefig(IMAGES / "overview.png", dpi=110)


@in_style
def draw_both_maps(demo: Path) -> None:
    """Draw the map of the remaining error at all speeds."""
    speeds = speeds_of_map(demo)
    figure = new_figure(10.0, 2.3)
    panels = figure.subplots(1, len(speeds), sharey=True)
    for panel, speed in zip(panels, speeds, strict=True):
        image = draw_map(panel, demo, speed)
        panel.set_title(f"{speed:g} m/s", loc="left")
    figure.colorbar(image, ax=panels, label="repeatable error (N m)", pad=0.01)
    figure.savefig(IMAGES / "gap_map.png", dpi=100)


@in_style
def draw_all_moments(demo: Path) -> None:
    """Draw the moments of all joints."""
    names = wrapjax.load_subject(demo / "virtual_subject").trials.moment_coordinates
    figure = new_figure(10.0, 4.4)
    for panel, name in zip(figure.subplots(2, 3, sharex=True).ravel(), names, strict=True):
        draw_moments(panel, demo, name)
        panel.set_title(name, loc="left", parse_math=False)
    figure.axes[0].legend()
    figure.supxlabel(f"gait cycle (%), validation cycle {CYCLE}", parse_math=False)
    figure.supylabel("joint moment (N m)")
    figure.savefig(IMAGES / "moments.png", dpi=100)


def take_pictures(demo: Path, browser: str) -> None:
    """Take pictures of the first part of two reports."""
    for name, page in (("report_nga", "NGA"), ("report_gap", "gap")):
        file = IMAGES / f"{name}.png"
        subprocess.run(
            [
                *(browser, "--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1120,980"),
                f"--screenshot={file}",
                (demo / page / "report.html").resolve().as_uri(),
            ],
            check=True,
            capture_output=True,
        )
        shrink(file)


def shrink(file: Path, width: int = 1120) -> None:
    """Store a picture with at most 256 colors and this width."""
    picture = Image.open(file).convert("RGB")
    if picture.width > width:
        picture = picture.resize((width, round(width * picture.height / picture.width)))
    picture.quantize(128).save(file, optimize=True)


def main(demo: Path, browser: str | None) -> None:
    """Draw all pictures."""
    set_up_jax()
    IMAGES.mkdir(exist_ok=True)
    draw_overview(demo)
    draw_all_moments(demo)
    draw_both_maps(demo)
    Image.open(demo / "wrap_recovery.png").save(IMAGES / "moment_arms.png")
    for name in ("overview", "moments", "gap_map", "moment_arms"):
        shrink(IMAGES / f"{name}.png")
    if browser:
        take_pictures(demo, browser)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else None)
