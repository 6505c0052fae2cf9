"""Where the error is: a map over coordinates, phases and speeds, and the parts it is made of.

Which muscle forces would take the error away.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.error_budget import BIN_PERCENT, BINS, Budget
from wrapjax.diagnosis.result import DiagnosisResult, MuscleShare
from wrapjax.report import markup
from wrapjax.report.diagnosis_numbers import mean_absolute_errors, speed_label, where
from wrapjax.report.moment_curves import mark_gait_cycle
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    LIGHT_GRAY,
    PAGE_WIDTH,
    PURPLE,
    VERMILION,
    Axes,
    Figure,
    counted,
    in_style,
    new_figure,
    panel_grid,
)

#: Colors of the parts of the error, and what the page calls them.
PARTS = {
    "bias": (PURPLE, "constant"),
    "common": (BLUE, "repeats at all speeds"),
    "specific": ("#56B4E9", "repeats at one speed"),
    "driven": (GREEN, "follows the inputs"),
    "noise": ("#C4C4C4", "noise"),
}
_MOST_ROWS = 8


def where_section(result: DiagnosisResult) -> list[str]:
    """Write the part of the report on where the error is; nothing where it could not be split."""
    if result.budget is None:
        return []
    rows = where(result)
    first = rows[0]
    return [
        markup.section(
            "Where the error is",
            markup.picture(
                map_figure(result, result.budget),
                alternative="Map of the error that repeats, over coordinates and the gait cycle, by speed; "
                f"it is largest at {first['coordinate']}, {_phase(first)} of the cycle, "
                f"{speed_label(first['speed_m_s'])}: {first['explainable_rms_Nm']:.1f} N m.",
                caption="Root mean square in N m of the error that repeats from cycle to cycle, which a "
                f"better model could explain, by coordinate and {BIN_PERCENT} % of the gait cycle, which "
                "starts with heel strike. The darker, the more is missing from the model there. Hatched: "
                "less than noise.",
            ),
            markup.table(
                ("coordinate", "gait cycle", "speed", "error (N m)", "repeats (N m)", "share (%)"),
                [
                    (
                        row["coordinate"],
                        _phase(row),
                        speed_label(row["speed_m_s"]),
                        f"{row['rms_Nm']:.1f}",
                        f"{row['explainable_rms_Nm']:.1f}",
                        f"{100.0 * row['share_of_gap']:.1f}",
                    )
                    for row in rows[:_MOST_ROWS]
                ],
                caption=f"The {_MOST_ROWS} places with most of it: root mean square error, the part of it "
                "that repeats, and its share of all that does. All places are in gap.json.",
            ),
        ),
        markup.section(
            "What the error is made of",
            markup.picture(
                parts_figure(result, result.budget),
                alternative="Mean square error of each coordinate, split into "
                f"{', '.join(label for _, label in PARTS.values())}; beside it mean absolute errors before "
                "and after.",
                caption="Left: mean squared error in (N m)\N{SUPERSCRIPT TWO} of the plain model on cycles "
                "that it was not fitted to, in parts that add up to it. What is constant, repeats from cycle "
                "to cycle or follows EMG and angles could be explained by a better model; noise could not. "
                "Parts are estimates without bias: one that is small may come out below zero, and is drawn "
                "so, to the left. Right: mean absolute error in N m before, after (with the best "
                "explanation, where there is one), and what noise alone would leave if it were normal.",
            ),
        ),
    ]


@in_style
def map_figure(result: DiagnosisResult, budget: Budget) -> Figure:
    """Draw the error that repeats over coordinates and the gait cycle, one panel a speed."""
    from matplotlib.patches import Rectangle

    speeds, names = len(result.budget_speeds), result.coordinates
    columns = min(speeds, 3)
    figure, panels = panel_grid(
        speeds, columns, width=PAGE_WIDTH, panel_height=0.32 * len(names) + 0.6, sharey=True
    )
    edges = np.linspace(0.0, 100.0, BINS + 1)
    for row, panel in enumerate(panels):
        image = panel.pcolormesh(
            edges,
            np.arange(len(names) + 1),
            result.map[row],
            cmap="YlGnBu",
            vmin=0.0,
            vmax=float(result.map.max()) or 1.0,
            edgecolor="white",
            linewidth=0.4,
        )
        for coordinate, number in np.argwhere(result.map[row] ** 2 < budget.noise[row]).tolist():
            panel.add_patch(
                Rectangle(
                    (edges[number], coordinate),
                    BIN_PERCENT,
                    1.0,
                    facecolor="none",
                    edgecolor="#A8A8A8",
                    hatch="////",
                    linewidth=0.0,
                )
            )
        panel.set_title(speed_label(float(result.budget_speeds[row])), loc="left")
        panel.set_yticks(np.arange(len(names)) + 0.5, names, parse_math=False)
        panel.set_ylim(len(names), 0)
        panel.tick_params(axis="y", length=0)
        panel.spines[["left", "bottom"]].set_visible(False)
        panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.colorbar(image, ax=panels, label="error that repeats (N m)", aspect=12, pad=0.01)
    return figure


@in_style
def parts_figure(result: DiagnosisResult, budget: Budget) -> Figure:
    """Draw the parts of each coordinate's mean squared error, and mean absolute errors beside them."""
    names, pooled = result.coordinates, budget.pooled()
    rows = np.arange(len(names))
    figure = new_figure(PAGE_WIDTH, 0.34 * len(names) + 1.3)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    ends = {1: np.zeros(len(names)), -1: np.zeros(len(names))}
    for field in fields(Budget):
        color, label = PARTS[field.name]
        values = pooled[field.name]
        # Parts below zero have a stack of their own, or they would hide those above.
        starts = np.where(values < 0.0, ends[-1], ends[1])
        left.barh(rows, values, left=starts, color=color, label=label, height=0.62)
        ends = {1: ends[1] + np.maximum(values, 0.0), -1: ends[-1] + np.minimum(values, 0.0)}
    left.axvline(0.0, color=BLACK, linewidth=0.6)
    left.set_xlabel("mean squared error ((N m)\N{SUPERSCRIPT TWO})")
    left.set_yticks(rows, names, parse_math=False)
    left.set_ylim(len(names) - 0.4, -0.6)
    left.tick_params(axis="y", length=0)
    _draw_absolute(right, result)
    handles, labels = left.get_legend_handles_labels()
    more = right.get_legend_handles_labels()
    figure.legend(handles + more[0], labels + more[1], loc="outside upper left", ncols=4)
    return figure


def _draw_absolute(panel: Axes, result: DiagnosisResult) -> None:
    rows = np.arange(len(result.coordinates))
    errors = mean_absolute_errors(result)
    before, after, floor = (
        np.array([errors[which][name] for name in result.coordinates])
        for which in ("before", "after", "floor")
    )
    panel.hlines(rows, floor, before, color=LIGHT_GRAY, linewidth=1.6, zorder=0)
    panel.plot(floor, rows, "|", color=GRAY, markersize=11, markeredgewidth=2, label="noise alone")
    panel.plot(before, rows, "o", color=VERMILION, markersize=5.5, label="before")
    if np.isfinite(after).all():
        panel.plot(after, rows, "D", color=BLUE, markersize=4.5, label="after")
    panel.set_xlim(0.0, 1.08 * float(np.nanmax(np.concatenate([before, after, floor]), initial=0.0)) or 1.0)
    panel.set_xlabel("mean absolute error (N m)")
    panel.tick_params(axis="y", length=0)


def _phase(row: dict) -> str:
    first, last = row["phase_percent"]
    return f"{first}\N{EN DASH}{last} %"


#: Where moment arms tell less of a muscle's part than this, its forces are not to be believed.
RESOLVED = 0.5
_WORDS = "resolution below 0.5"


def muscles_section(result: DiagnosisResult) -> list[str]:
    """Write the part of the report on muscles; nothing where it could not be told."""
    share = result.muscles
    if share is None or not share.muscles:
        return []
    most = np.abs(share.force).max(axis=(1, 2))
    seen = resolved(share)
    place = int(np.argmax(np.where(seen, most, -1.0)))
    first = (
        f"the largest change that can be told is {most[place]:.0f} N, of {share.muscles[place]}"
        if seen.any()
        else "none can be told"
    )
    return [
        markup.section(
            "Which muscles",
            markup.picture(
                muscle_figure(result, share),
                alternative=f"Map of the change of force by muscle and gait cycle; {first}.",
                caption="Change of muscle force in N that would take the explainable error away, mean over "
                "the cycles of each speed: blue, more force than the plain model gives; red, less. Muscles "
                "with like moment arms cannot be told apart by moments. Hatched, with names in gray: muscles "
                f"of whose part less than half can be told ({_WORDS}), not to be read. "
                f"{counted(int(seen.sum()), 'muscle')} of {len(seen)} can be told.",
            ),
        )
    ]


def resolved(share: MuscleShare) -> Bool[np.ndarray, " muscle"]:
    """Mark the muscles whose part moment arms can tell."""
    return share.resolution >= RESOLVED


@in_style
def muscle_figure(result: DiagnosisResult, share: MuscleShare) -> Figure:
    """Draw the change of force by muscle and phase, one panel a speed."""
    from matplotlib.patches import Rectangle

    order = _order(share)
    force, seen = share.force[order], resolved(share)[order]
    names = [share.muscles[row] for row in order]
    speeds = force.shape[1]
    columns = min(3, speeds)
    figure, panels = panel_grid(
        speeds, columns, width=PAGE_WIDTH, panel_height=0.19 * len(names) + 0.7, sharey=True
    )
    labels = _speeds(result, speeds)
    largest = _largest(force[seen]) or _largest(force) or 1.0
    edges = np.linspace(0.0, 100.0, force.shape[2] + 1)
    for number, panel in enumerate(panels):
        image = panel.pcolormesh(
            edges,
            np.arange(len(names) + 1),
            force[:, number],
            cmap="RdBu",
            vmin=-largest,
            vmax=largest,
            # As an image: thousands of cells would be megabytes of paths.
            rasterized=True,
        )
        for row in np.flatnonzero(~seen).tolist():
            panel.add_patch(
                Rectangle(
                    (0.0, row),
                    100.0,
                    1.0,
                    facecolor="#FFFFFFB0",
                    edgecolor=GRAY,
                    hatch="////",
                    linewidth=0.0,
                )
            )
        panel.set_title(labels[number], loc="left")
        panel.set_yticks(np.arange(len(names)) + 0.5, names, parse_math=False)
        if number % columns == 0:  # the others' names are not shown
            for name, clear in zip(panel.get_yticklabels(), seen.tolist(), strict=True):
                name.set_color(BLACK if clear else GRAY)
        panel.set_ylim(len(names), 0)
        panel.tick_params(axis="y", length=0)
        panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.colorbar(image, ax=panels, label="change of force (N)", aspect=30, pad=0.01, extend="both")
    return figure


def _order(share: MuscleShare) -> Int[np.ndarray, " muscle"]:
    """Put those that can be told first, the largest change first."""
    return np.lexsort((-np.abs(share.force).max(axis=(1, 2)), ~resolved(share)))


def _largest(force: Float[np.ndarray, "muscle speed phase"]) -> float:
    return float(np.abs(force).max(initial=0.0))


def _speeds(result: DiagnosisResult, count: int) -> list[str]:
    """Name the speeds that muscles were calibrated at; not at all if these are others."""
    calibrated = np.array([use == "calibration" for use in result.uses], dtype=bool)
    speeds = np.unique(result.speeds[calibrated]).tolist()  # NaNs count as one, the last
    return [speed_label(speed) for speed in speeds] if len(speeds) == count else [""] * count
