"""Report sections of a diagnosis on the error: location, parts, and muscle forces that would remove it."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.localization import BIN_PERCENT, BINS, ErrorBudget, MuscleShare
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.report import markup
from wrapjax.report.cycle_panels import mark_gait_cycle
from wrapjax.report.diagnosis.numbers import error_locations, mean_absolute_errors, speed_label
from wrapjax.report.formatting import counted
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
    in_style,
    label_rows,
    legend_above,
    new_figure,
    panel_grid,
)

#: Color and label of each part of the error.
PARTS = {
    "bias": (PURPLE, "constant"),
    "common": (BLUE, "repeatable at all speeds"),
    "specific": ("#56B4E9", "repeatable at one speed"),
    "driven": (GREEN, "correlated with inputs"),
    "noise": ("#C4C4C4", "noise"),
}
_MOST_ROWS = 8


def location_section(result: DiagnosisResult) -> str:
    """Write the report section on the location of the error; empty if the error could not be split."""
    if result.budget is None:
        return ""
    rows = error_locations(result)
    first = rows[0]
    return markup.section(
        "Location of the error",
        markup.picture(
            map_figure(result, result.budget),
            alternative="Map of the repeatable error over coordinates and the gait cycle, by speed; it is "
            f"largest at {first['coordinate']}, {_phase(first)} of the cycle, "
            f"{speed_label(first['speed_m_s'])}: {first['explainable_rms_Nm']:.1f} N m.",
            caption="Root mean square in N m of the repeatable error, which recurs from cycle to cycle and "
            f"which a better model could explain, by coordinate and interval of {BIN_PERCENT} % of the gait "
            "cycle, which starts with heel strike. Darker colors: larger error. Hatched: less than noise.",
        ),
        markup.table(
            ("coordinate", "gait cycle", "speed", "error (N m)", "repeatable (N m)", "share (%)"),
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
            caption=f"The {_MOST_ROWS} locations with the largest repeatable error: root mean square error, "
            "its repeatable part, and the share of the mean squared repeatable error of all locations. All "
            "locations are in gap.json.",
        ),
    )


def parts_section(result: DiagnosisResult) -> str:
    """Write the report section on the parts of the error; empty if the error could not be split."""
    if result.budget is None:
        return ""
    return markup.section(
        "Parts of the error",
        markup.picture(
            parts_figure(result, result.budget),
            alternative="Mean squared error of each coordinate, split into "
            f"{', '.join(label for _, label in PARTS.values())}; mean absolute errors before and after.",
            caption="Left: mean squared error in (N m)\N{SUPERSCRIPT TWO} of the plain model on held-out "
            "cycles, as the sum of its parts. A better model could explain error that is constant, "
            "repeatable from cycle to cycle, or correlated with EMG and angles, but not noise. The parts "
            "are unbiased estimates: a small part may be estimated below zero and is then drawn to the "
            "left. Right: mean absolute error in N m before, after (with the best explanation, if there is "
            "one), and the error that normally distributed noise alone would leave.",
        ),
    )


@in_style
def map_figure(result: DiagnosisResult, budget: ErrorBudget) -> Figure:
    """Draw the repeatable error over coordinates and the gait cycle, one panel a speed."""
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
            result.error_map[row],
            cmap="YlGnBu",
            vmin=0.0,
            vmax=float(result.error_map.max()) or 1.0,
            edgecolor="white",
            linewidth=0.4,
        )
        for coordinate, number in np.argwhere(result.error_map[row] ** 2 < budget.noise[row]).tolist():
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
    figure.colorbar(image, ax=panels, label="repeatable error (N m)", aspect=12, pad=0.01)
    return figure


@in_style
def parts_figure(result: DiagnosisResult, budget: ErrorBudget) -> Figure:
    """Draw the parts of each coordinate's mean squared error, and the mean absolute errors."""
    names, pooled = result.coordinates, budget.pooled()
    rows = np.arange(len(names))
    figure = new_figure(PAGE_WIDTH, 0.34 * len(names) + 1.3)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    ends = {1: np.zeros(len(names)), -1: np.zeros(len(names))}
    for field in fields(ErrorBudget):
        color, label = PARTS[field.name]
        values = pooled[field.name]
        # Parts below zero are stacked separately, because they would hide those above zero.
        starts = np.where(values < 0.0, ends[-1], ends[1])
        left.barh(rows, values, left=starts, color=color, label=label, height=0.62)
        ends = {1: ends[1] + np.maximum(values, 0.0), -1: ends[-1] + np.minimum(values, 0.0)}
    left.axvline(0.0, color=BLACK, linewidth=0.6)
    left.set_xlabel("mean squared error ((N m)\N{SUPERSCRIPT TWO})")
    _draw_absolute_errors(right, result)
    label_rows([left, right], names)
    legend_above(figure, left, right, columns=4)
    return figure


def _draw_absolute_errors(panel: Axes, result: DiagnosisResult) -> None:
    rows = np.arange(len(result.coordinates))
    errors = mean_absolute_errors(result)
    before, after, floor = (
        np.array([errors[which][name] for name in result.coordinates])
        for which in ("before", "after", "floor")
    )
    panel.hlines(rows, floor, before, color=LIGHT_GRAY, linewidth=1.6, zorder=0)
    panel.plot(floor, rows, "|", color=GRAY, markersize=11, markeredgewidth=2, label="noise floor")
    panel.plot(before, rows, "o", color=VERMILION, markersize=5.5, label="before")
    if np.isfinite(after).all():
        panel.plot(after, rows, "D", color=BLUE, markersize=4.5, label="after")
    panel.set_xlim(0.0, 1.08 * float(np.nanmax(np.concatenate([before, after, floor]), initial=0.0)) or 1.0)
    panel.set_xlabel("mean absolute error (N m)")


def _phase(row: dict) -> str:
    first, last = row["phase_percent"]
    return f"{first}\N{EN DASH}{last} %"


#: Resolution below which the force change of a muscle cannot be interpreted.
RESOLVED = 0.5


def muscles_section(result: DiagnosisResult) -> str:
    """Write the report section on muscle forces; empty if they could not be computed."""
    share = result.muscle_share
    if share is None or not share.muscles:
        return ""
    most = np.abs(share.force).max(axis=(1, 2))
    identified = resolved(share)
    place = int(np.argmax(np.where(identified, most, -1.0)))
    first = (
        f"the largest identifiable change is {most[place]:.0f} N, of {share.muscles[place]}"
        if identified.any()
        else "no change is identifiable"
    )
    return markup.section(
        "Muscle forces that would remove the error",
        markup.picture(
            muscle_figure(result, share),
            alternative=f"Map of the change of force by muscle and gait cycle; {first}.",
            caption="Change of muscle force in N that would remove the explainable error, mean over the "
            "cycles of each speed: blue, more force than in the plain model; red, less. Moments cannot "
            "distinguish muscles with similar moment arms. Hatched, with names in gray: muscles of whose "
            f"contribution less than half is identifiable (resolution below {RESOLVED:g}); these cannot be "
            f"interpreted. The changes of {counted(int(identified.sum()), 'muscle')} of {len(identified)} "
            "are identifiable.",
        ),
    )


def resolved(share: MuscleShare) -> Bool[np.ndarray, " muscle"]:
    """Mark the muscles whose force change is identifiable from moments."""
    return share.resolution >= RESOLVED


@in_style
def muscle_figure(result: DiagnosisResult, share: MuscleShare) -> Figure:
    """Draw the change of force by muscle and phase, one panel a speed."""
    from matplotlib.patches import Rectangle

    order = _order(share)
    force, identified = share.force[order], resolved(share)[order]
    names = [share.muscles[row] for row in order]
    speeds = force.shape[1]
    columns = min(3, speeds)
    figure, panels = panel_grid(
        speeds, columns, width=PAGE_WIDTH, panel_height=0.19 * len(names) + 0.7, sharey=True
    )
    labels = _speeds(result, speeds)
    largest = _largest(force[identified]) or _largest(force) or 1.0
    edges = np.linspace(0.0, 100.0, force.shape[2] + 1)
    for number, panel in enumerate(panels):
        image = panel.pcolormesh(
            edges,
            np.arange(len(names) + 1),
            force[:, number],
            cmap="RdBu",
            vmin=-largest,
            vmax=largest,
            # Drawn as an image, because thousands of cells as paths would need megabytes.
            rasterized=True,
        )
        for row in np.flatnonzero(~identified).tolist():
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
        if number % columns == 0:  # other panels show no names
            for name, known in zip(panel.get_yticklabels(), identified.tolist(), strict=True):
                name.set_color(BLACK if known else GRAY)
        panel.set_ylim(len(names), 0)
        panel.tick_params(axis="y", length=0)
        panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.colorbar(image, ax=panels, label="change of force (N)", aspect=30, pad=0.01, extend="both")
    return figure


def _order(share: MuscleShare) -> Int[np.ndarray, " muscle"]:
    """Order muscles: identifiable muscles first, then by the size of the change."""
    return np.lexsort((-np.abs(share.force).max(axis=(1, 2)), ~resolved(share)))


def _largest(force: Float[np.ndarray, "muscle speed phase"]) -> float:
    return float(np.abs(force).max(initial=0.0))


def _speeds(result: DiagnosisResult, count: int) -> list[str]:
    """Write the speeds of the calibration cycles; empty labels if their number differs from ``count``."""
    calibrated = np.array([use == "calibration" for use in result.uses], dtype=bool)
    speeds = np.unique(result.speeds[calibrated]).tolist()  # NaNs count as one, the last
    return [speed_label(speed) for speed in speeds] if len(speeds) == count else [""] * count
