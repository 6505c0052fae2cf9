"""Figures of a calibration: curves over the gait cycle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.calibrate import FIBER_LENGTH_RANGE, CalibrationResult
from wrapjax.report.cycles import (
    MomentCurves,
    draw_spread,
    groups_by_speed,
    groups_by_speed_and_use,
    mark_gait_cycle,
    spread,
)
from wrapjax.report.limits import FIBER_LIMITS, pushing_muscles
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    GROUP_COLORS,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    in_style,
    new_figure,
    panel_grid,
)


@in_style
def moment_figure(result: MomentCurves) -> Figure:
    """Draw measured and modelled joint moments, one row a coordinate, one column a kind of cycles."""
    groups = groups_by_speed_and_use(result, most_speeds=2)
    wrapped = len(groups) == 1
    columns = min(3, len(result.coordinates)) if wrapped else len(groups)
    count = len(result.coordinates) * len(groups)
    figure, panels = panel_grid(
        count,
        columns,
        width=PAGE_WIDTH if columns > 1 else PAGE_WIDTH / 2,
        panel_height=1.75,
        sharex=True,
        sharey=False if wrapped else "row",
    )
    for number, panel in enumerate(panels):
        row, column = divmod(number, len(groups))
        group = groups[column]
        measured, modelled = result.measured[group.keep, row], result.modelled[group.keep, row]
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        draw_spread(panel, measured, BLACK, "measured")
        draw_spread(panel, modelled, BLUE, "modelled")
        error = np.abs(modelled - measured).mean()
        panel.set_title(f"{result.coordinates[row]}: error {error:.1f} N m", loc="left", parse_math=False)
        if not wrapped and row == 0:
            panel.annotate(
                f"{group.label} ({group.count})",
                (0.0, 1.0),
                xytext=(0, 18),
                xycoords="axes fraction",
                textcoords="offset points",
                fontweight="bold",
            )
        if number % columns == 0:
            panel.set_ylabel("moment (N m)")
        if number >= count - columns:
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


@in_style
def activation_figure(result: CalibrationResult, channel_of: dict[str, str]) -> Figure:
    """Draw muscle activations, one panel a muscle, one color a walking speed.

    Parameters
    ----------
    result
        All cycles.
    channel_of
        EMG channel that drives each muscle.
    """
    return _muscle_figure(result, np.asarray(result.states.activation), channel_of, "activation")


@in_style
def excitation_figure(result: CalibrationResult, signal_of: dict[str, str]) -> Figure:
    """Draw excitations of some muscles, one panel a muscle, one color a walking speed.

    Parameters
    ----------
    result
        All cycles.
    signal_of
        By muscle, the name of what excites it.
    """
    return _muscle_figure(result, np.asarray(result.states.excitation), signal_of, "excitation")


def _muscle_figure(
    result: CalibrationResult,
    values: Float[np.ndarray, "muscle trial frame"],
    signal_of: dict[str, str],
    label: str,
) -> Figure:
    """Draw one quantity of those muscles that a signal is named of."""
    groups = groups_by_speed(result.speeds, most=len(GROUP_COLORS))
    muscles = [muscle for muscle in result.muscles if muscle in signal_of]
    columns = 6 if len(muscles) > 12 else 4
    figure, panels = panel_grid(
        len(muscles), columns, width=PAGE_WIDTH, panel_height=1.2, sharex=True, sharey=True
    )
    highest = 0.0
    for row, (panel, muscle) in enumerate(zip(panels, muscles, strict=True)):
        for group, color in zip(groups, GROUP_COLORS, strict=False):
            curves = values[result.muscles.index(muscle), group.keep]
            draw_spread(panel, curves, color, group.label)
            highest = max(highest, float(np.nanmax(spread(curves).high, initial=0.0)))
        panel.set_title(muscle, loc="left", pad=10, parse_math=False)
        panel.text(
            0,
            1.03,
            signal_of[muscle],
            transform=panel.transAxes,
            fontsize=6.5,
            color="#555555",
            parse_math=False,
        )
        if row % columns == 0:
            panel.set_ylabel(label)
        if row >= len(panels) - columns:
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=50)
    panels[0].set_ylim((0, min(1.0, 1.05 * highest) or 1.0))
    if len(groups) > 1:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=len(groups))
    return figure


@in_style
def fiber_length_figure(result: CalibrationResult) -> Figure:
    """Draw the range of normalised fiber lengths over all cycles, before and after calibration."""
    muscles = result.muscles
    figure = new_figure(PAGE_WIDTH, 0.2 * len(muscles) + 1.2)
    panel = figure.subplots()
    panel.axvspan(*FIBER_LENGTH_RANGE, color="#F1F6FA", zorder=0)
    panel.axvline(1.0, color=GRAY, linewidth=0.8, linestyle="--", zorder=1)
    rows = np.arange(len(muscles))
    for states, shift, color, label in (
        (result.initial_states, -0.17, GRAY, "before calibration"),
        (result.states, 0.17, BLUE, "after"),
    ):
        lengths = np.asarray(states.fiber.normalized_length).reshape(len(muscles), -1)
        panel.hlines(rows + shift, lengths.min(axis=1), lengths.max(axis=1), color=color, linewidth=2.2)
        panel.plot(
            lengths.mean(axis=1), rows + shift, "o", color=color, markersize=4.2, label=label, zorder=3
        )
    pushing = pushing_muscles(result)
    in_force = [pair for pair in zip(FIBER_LIMITS, FIBER_LENGTH_RANGE, strict=True) if pair[0] in pushing]
    for name, limit in in_force:
        panel.axvline(limit, color=VERMILION, linewidth=0.8, zorder=1, label="hard limit")
        at = [muscles.index(muscle) + 0.17 for muscle in pushing[name]]
        panel.plot(
            np.full(len(at), limit),
            at,
            "D",
            color=VERMILION,
            markersize=4.5,
            label="pushes against it",
            zorder=4,
        )
    panel.set_yticks(rows, muscles, parse_math=False)
    panel.set_ylim(len(muscles) - 0.4, -0.6)
    panel.set_xlim(left=min(0.2, panel.get_xlim()[0]), right=max(1.4, panel.get_xlim()[1]))
    panel.set_xlabel("fiber length / optimal fiber length")
    panel.tick_params(axis="y", length=0)
    one_each = dict(zip(*panel.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(one_each.values(), one_each.keys(), loc="outside upper left", ncols=len(one_each))
    return figure
