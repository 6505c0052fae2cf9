"""What drove each muscle of a leg: an electrode, synergies of the measured EMG, or nothing.

Figures of a calibration: curves over the gait cycle.

Errors and curves in the report: moments, activations and fiber lengths.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.path_penalties import FIBER_LENGTH_RANGE
from wrapjax.calibration.result import FIBER_LIMITS, CalibrationResult, muscles_at_limits
from wrapjax.report import markup
from wrapjax.report.moment_curves import (
    MomentCurves,
    draw_spread,
    groups_by_speed,
    groups_by_speed_and_use,
    mark_gait_cycle,
    spread,
)
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    GROUP_COLORS,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    counted,
    decimals,
    in_style,
    new_figure,
    panel_grid,
)
from wrapjax.subject.subject import Subject


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
    pushing = muscles_at_limits(result)
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


ELECTRODE, SYNERGIES, NOTHING = "electrode", "synergies", "not driven"


def describe_drive(subject: Subject) -> dict[str, dict[str, str | None]]:
    """Say by muscle what drove it, and the name of the channel or of the excitation.

    Returns
    -------
    dict
        Of every muscle of the leg's model: ``by`` is `ELECTRODE`, `SYNERGIES` or `NOTHING`, ``signal`` the
        name, None where nothing did.
    """
    drive: dict[str, dict[str, str | None]] = {
        muscle: {"by": ELECTRODE, "signal": channel} for muscle, channel in subject.channel_of.items()
    }
    if subject.synergies is not None:
        for name, members in subject.synergies.groups.items():
            drive |= {muscle: {"by": SYNERGIES, "signal": name} for muscle in members}
    return drive | {muscle: {"by": NOTHING, "signal": None} for muscle in subject.undriven_muscles}


def drive_section(subject: Subject, result: CalibrationResult) -> str:
    """Write the part of the report on what drove the muscles, with excitations that nobody measured."""
    members: dict[tuple[str, str], list[str]] = {}
    for muscle, own in describe_drive(subject).items():
        members.setdefault((str(own["by"]), own["signal"] or ""), []).append(muscle)
    table = markup.table(
        ("driven by", "channel or excitation", "muscles"),
        [(*key, ", ".join(muscles)) for key, muscles in members.items()],
        caption="Every muscle of this leg's model. A muscle that nothing drives has no force, passive force "
        "included.",
    )
    if subject.synergies is None:
        return markup.section("What drove the muscles", table)
    basis, muscles = subject.synergies.basis, subject.synergies.muscles
    share = 100.0 * float(basis.explained.sum())
    return markup.section(
        "What drove the muscles",
        table,
        markup.paragraph(
            f"{counted(len(muscles), 'muscle')} without an electrode got weighted sums of "
            f"{counted(basis.count - 1, 'principal component')} of the measured EMG, which hold "
            f"{share:.0f} % of its variance over the calibration cycles. Weights are one set for all cycles "
            "and were calibrated with everything else: no EMG vouches for these excitations, they are what "
            "explains the moments. An excitation that is wrong can hide what the model lacks elsewhere."
        ),
        markup.picture(
            excitation_figure(result, {name: _signal(subject, name) for name in muscles}),
            alternative=f"Excitation of {counted(len(muscles), 'muscle')} without an electrode over the "
            "gait cycle.",
            caption="Excitation (0 to 1, no unit) of the muscles without an electrode over the gait cycle, "
            "all cycles, delay and scale included: mean and one standard deviation to either side. Small "
            "print: the excitation, which muscles may have in common. All panels have one scale.",
        ),
    )


def _signal(subject: Subject, muscle: str) -> str:
    assert subject.synergies is not None
    return next(name for name, members in subject.synergies.groups.items() if muscle in members)


def errors_section(result: CalibrationResult, summary: dict[str, Any]) -> str:
    """Write the table of moment errors."""
    columns = {
        "before: MAE": summary["before"]["mae_Nm"]["calibration"],
        "before: RMSE": summary["before"]["rmse_Nm"]["calibration"],
        "calibration: MAE": summary["mae_Nm"]["calibration"],
        "calibration: RMSE": summary["rmse_Nm"]["calibration"],
    }
    if summary["mae_Nm"]["validation"] is not None:
        columns |= {
            "validation: MAE": summary["mae_Nm"]["validation"],
            "validation: RMSE": summary["rmse_Nm"]["validation"],
        }
    peak = np.abs(result.measured).max(axis=(0, 2))
    largest = dict(zip(result.coordinates, peak.tolist(), strict=True))
    rows = [
        (
            name,
            decimals(largest.get(name)),
            *(decimals(None if column is None else column[name]) for column in columns.values()),
        )
        for name in (*result.coordinates, "mean")
    ]
    return markup.section(
        "Moment errors",
        markup.table(
            ("coordinate", "largest measured", *columns),
            rows,
            caption="Errors of joint moments in N m over all frames of the cycles: mean absolute (MAE) and "
            "root mean square (RMSE). 'Before' is the model as it came, on the calibration cycles; "
            "'largest measured' is the largest magnitude of the measured moment in any cycle.",
            total=True,
        ),
    )


def moments_section(result: MomentCurves, summary: dict[str, Any]) -> str:
    """Write the part of the report on joint moments."""
    use = "calibration" if summary["mae_Nm"]["calibration"] else "validation"
    parts = [
        f"{name} {decimals(value)} N m"
        for name, value in (summary["mae_Nm"][use] or {}).items()
        if name != "mean"
    ]
    return markup.section(
        "Joint moments",
        markup.picture(
            moment_figure(result),
            alternative="Measured and modelled joint moments over the gait cycle for each coordinate. Mean "
            f"absolute errors on {use} cycles: {', '.join(parts)}.",
            caption="Net joint moments in N m over the gait cycle: measured by inverse dynamics (black) and "
            "modelled from EMG (blue). Lines are means over cycles, bands one standard deviation to either "
            "side (no band where there is one cycle); 'error' is the mean absolute error. A positive moment "
            "acts towards larger values of the coordinate, as OpenSim defines it. Scales differ "
            "between coordinates.",
        ),
    )


def activations_section(subject: Subject, result: CalibrationResult) -> str:
    """Write the part of the report on muscle activations."""
    channel_of = dict.fromkeys(result.muscles, "synergies") | subject.channel_of
    peaks = np.asarray(result.states.activation).mean(axis=1).max(axis=-1)
    strongest = result.muscles[int(np.argmax(peaks))]
    return markup.section(
        "Muscle activations",
        markup.picture(
            activation_figure(result, channel_of),
            alternative=f"Activation of {len(result.muscles)} muscles over the gait cycle. The mean "
            f"activation of {strongest} peaks highest, at {decimals(float(peaks.max()))}.",
            caption="Muscle activation (0 to 1, no unit) over the gait cycle, all cycles: mean and one "
            "standard deviation to either side. Small print: the EMG channel that drives the muscle"
            f"{', or synergies' if subject.synergies else ''}. "
            "All panels have one scale.",
        ),
    )


def fiber_lengths_section(result: CalibrationResult) -> str:
    """Write the part of the report on normalised fiber lengths."""
    low, high = FIBER_LENGTH_RANGE
    finding = fiber_length_finding(result)
    limited = (
        ", and where hard limits (strokes) kept them on calibration cycles; diamonds: muscles that push "
        "against a limit"
        if set(FIBER_LIMITS) & muscles_at_limits(result).keys()
        else ""
    )
    return markup.section(
        "Fiber lengths",
        markup.picture(
            fiber_length_figure(result),
            alternative=f"Ranges of normalised fiber lengths of {len(result.muscles)} muscles before and "
            f"after calibration. {finding}",
            caption="Fiber length over optimal fiber length (no unit): range (bar) and mean (dot) over all "
            f"frames of all cycles, before (gray) and after calibration (blue). Shaded: {low:g} to {high:g}, "
            f"where muscles are expected to work{limited}. Dashed: optimal length, where active force is "
            f"largest. {finding}",
        ),
    )


def fiber_length_finding(result: CalibrationResult) -> str:
    """Say which muscles leave the range in which they are expected to work, and on which cycles."""
    low, high = FIBER_LENGTH_RANGE
    lengths = np.asarray(result.states.fiber.normalized_length)
    slack = result.solver.ctol  # what pushes against a limit lies on it to this
    outside = np.any((lengths < low - slack) | (lengths > high + slack), axis=2)
    leaving = [muscle for muscle, own in zip(result.muscles, outside, strict=True) if own.any()]
    if not leaving:
        return "After calibration all muscles stay within this range."
    matched = np.array([use == "calibration" for use in result.uses])
    where = "" if outside[:, matched].any() else ", on validation cycles only"
    verb = "leaves" if len(leaving) == 1 else "leave"
    return f"After calibration {', '.join(leaving)} {verb} this range{where}."
