"""Report sections of a calibration on moments, muscle drive, activations and fiber lengths."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.calibration_result import FIBER_LIMITS, CalibrationResult, muscles_at_limits
from wrapjax.calibration.path_penalties import FIBER_LENGTH_RANGE
from wrapjax.report import markup
from wrapjax.report.cycle_panels import (
    MomentCurves,
    draw_spread,
    groups_by_speed,
    groups_by_speed_and_use,
    label_gait_cycles,
    moment_grid,
    spread,
)
from wrapjax.report.formatting import counted, decimals
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    GROUP_COLORS,
    PAGE_WIDTH,
    PALE_BLUE,
    VERMILION,
    Figure,
    draw_zero_line,
    head_column,
    in_style,
    label_rows,
    legend_above,
    new_figure,
    panel_grid,
)
from wrapjax.subject.subject import Subject


@in_style
def moment_figure(result: MomentCurves) -> Figure:
    """Draw measured and modelled joint moments, one row a coordinate, one column a group of cycles."""
    groups = groups_by_speed_and_use(result, most_speeds=2)
    figure, panels, columns = moment_grid(len(result.coordinates), len(groups), panel_height=1.75)
    for number, panel in enumerate(panels):
        row, column = divmod(number, len(groups))
        group = groups[column]
        measured, modelled = result.measured[group.keep, row], result.modelled[group.keep, row]
        draw_zero_line(panel)
        draw_spread(panel, measured, BLACK, "measured")
        draw_spread(panel, modelled, BLUE, "modelled")
        error = np.abs(modelled - measured).mean()
        panel.set_title(f"{result.coordinates[row]}: error {error:.1f} N m", loc="left", parse_math=False)
        if len(groups) > 1 and row == 0:
            head_column(panel, f"{group.label} ({group.count})")
    label_gait_cycles(panels, columns, y="moment (N m)")
    legend_above(figure, panels[0])
    return figure


def driving_signals(subject: Subject, result: CalibrationResult) -> dict[str, str]:
    """Name the EMG channel, or synergies, that drive each muscle."""
    return dict.fromkeys(result.muscles, "synergies") | subject.channel_of


@in_style
def activation_figure(result: CalibrationResult, channel_of: dict[str, str]) -> Figure:
    """Draw muscle activations, one panel a muscle, one color a walking speed.

    Parameters
    ----------
    result
        Result of the calibration.
    channel_of
        EMG channel that drives each muscle.
    """
    return _muscle_figure(result, np.asarray(result.states.activation), channel_of, "activation")


@in_style
def excitation_figure(result: CalibrationResult, signal_of: dict[str, str]) -> Figure:
    """Draw excitations of selected muscles, one panel a muscle, one color a walking speed.

    Parameters
    ----------
    result
        Result of the calibration.
    signal_of
        Name of the excitation of each selected muscle.
    """
    return _muscle_figure(result, np.asarray(result.states.excitation), signal_of, "excitation")


def _muscle_figure(
    result: CalibrationResult,
    values: Float[np.ndarray, "muscle trial frame"],
    signal_of: dict[str, str],
    label: str,
) -> Figure:
    """Draw one quantity of the muscles of ``signal_of``, with the signal's name in each panel."""
    groups = groups_by_speed(result.speeds, most=len(GROUP_COLORS))
    muscles = [muscle for muscle in result.muscles if muscle in signal_of]
    columns = 6 if len(muscles) > 12 else 4
    figure, panels = panel_grid(
        len(muscles), columns, width=PAGE_WIDTH, panel_height=1.2, sharex=True, sharey=True
    )
    highest = 0.0
    for panel, muscle in zip(panels, muscles, strict=True):
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
    label_gait_cycles(panels, columns, y=label, step=50)
    panels[0].set_ylim((0, min(1.0, 1.05 * highest) or 1.0))
    if len(groups) > 1:
        legend_above(figure, panels[0])
    return figure


@in_style
def fiber_length_figure(result: CalibrationResult) -> Figure:
    """Draw the range of normalised fiber lengths over all cycles, before and after calibration."""
    muscles = result.muscles
    figure = new_figure(PAGE_WIDTH, 0.2 * len(muscles) + 1.2)
    panel = figure.subplots()
    panel.axvspan(*FIBER_LENGTH_RANGE, color=PALE_BLUE, zorder=0)
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
    imposed = [pair for pair in zip(FIBER_LIMITS, FIBER_LENGTH_RANGE, strict=True) if pair[0] in pushing]
    for name, limit in imposed:
        panel.axvline(limit, color=VERMILION, linewidth=0.8, zorder=1, label="hard limit")
        at = [muscles.index(muscle) + 0.17 for muscle in pushing[name]]
        panel.plot(
            np.full(len(at), limit),
            at,
            "D",
            color=VERMILION,
            markersize=4.5,
            label="limit active",
            zorder=4,
        )
    label_rows([panel], muscles)
    panel.set_xlim(left=min(0.2, panel.get_xlim()[0]), right=max(1.4, panel.get_xlim()[1]))
    panel.set_xlabel("fiber length / optimal fiber length")
    legend_above(figure, panel)
    return figure


ELECTRODE, SYNERGIES, NOTHING = "electrode", "synergies", "not driven"


def describe_drive(subject: Subject) -> dict[str, dict[str, str | None]]:
    """Describe what drove each muscle of the leg's model, for ``summary.json``.

    Returns
    -------
    dict
        By muscle: ``by`` is `ELECTRODE`, `SYNERGIES` or `NOTHING`, ``signal`` the name of the EMG channel or
        of the excitation, None for an undriven muscle.
    """
    drive: dict[str, dict[str, str | None]] = {
        muscle: {"by": ELECTRODE, "signal": channel} for muscle, channel in subject.channel_of.items()
    }
    if subject.synergies is not None:
        for name, members in subject.synergies.groups.items():
            drive |= {muscle: {"by": SYNERGIES, "signal": name} for muscle in members}
    return drive | {muscle: {"by": NOTHING, "signal": None} for muscle in subject.undriven_muscles}


def drive_section(subject: Subject, result: CalibrationResult) -> str:
    """Write the report section on what drove the muscles, with the excitations made from synergies."""
    members: dict[tuple[str, str], list[str]] = {}
    for muscle, drive in describe_drive(subject).items():
        members.setdefault((str(drive["by"]), drive["signal"] or ""), []).append(muscle)
    table = markup.table(
        ("driven by", "channel or excitation", "muscles"),
        [(*key, ", ".join(muscles)) for key, muscles in members.items()],
        caption="Every muscle of this leg's model. A muscle that is not driven has no force, not even "
        "passive force.",
    )
    if subject.synergies is None:
        return markup.section("Drive of the muscles", table)
    basis, muscles = subject.synergies.basis, subject.synergies.muscles
    share = 100.0 * float(basis.explained.sum())
    return markup.section(
        "Drive of the muscles",
        table,
        markup.paragraph(
            f"The excitations of {counted(len(muscles), 'muscle')} without an electrode are weighted sums of "
            f"{counted(basis.count - 1, 'principal component')} of the measured EMG, which explain "
            f"{share:.0f} % of its variance over the calibration cycles. The weights are the same in all "
            "cycles and were calibrated together with the other parameters. These excitations are not "
            "supported by an EMG recording; they are those that explain the moments best. A wrong excitation "
            "can conceal an error of the model elsewhere."
        ),
        markup.picture(
            excitation_figure(result, {name: _signal(subject, name) for name in muscles}),
            alternative=f"Excitation of {counted(len(muscles), 'muscle')} without an electrode over the "
            "gait cycle.",
            caption="Excitation (0 to 1, no unit) of the muscles without an electrode over the gait cycle, "
            "all cycles, delay and scale included: mean ± one standard deviation. Small print: name of the "
            "excitation, which several muscles may share. All panels have the same scale.",
        ),
    )


def _signal(subject: Subject, muscle: str) -> str:
    assert subject.synergies is not None
    return next(name for name, members in subject.synergies.groups.items() if muscle in members)


def errors_section(result: CalibrationResult, summary: dict[str, Any]) -> str:
    """Write the report section with the table of moment errors."""
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
    peak = np.nanmax(np.abs(result.measured), axis=(0, 2))
    largest = dict(zip(result.coordinates, peak.tolist(), strict=True))
    rows = [
        (
            name,
            decimals(largest.get(name)),
            *(decimals(None if column is None else column.get(name)) for column in columns.values()),
        )
        for name in (*result.coordinates, "mean")
    ]
    return markup.section(
        "Moment errors",
        markup.table(
            ("coordinate", "largest measured", *columns),
            rows,
            caption="Errors of joint moments in N m over all frames of the cycles: mean absolute (MAE) and "
            "root mean square (RMSE). 'Before' is the model before calibration, on the calibration cycles; "
            "'largest measured' is the largest magnitude of the measured moment in any cycle.",
            total=True,
        ),
    )


def moments_section(result: MomentCurves, summary: dict[str, Any]) -> str:
    """Write the report section on joint moments."""
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
            "modelled from EMG (blue). Lines are means over cycles, bands ± one standard deviation (no band "
            "for a single cycle); 'error' is the mean absolute error. A positive moment acts towards larger "
            "values of the coordinate, as OpenSim defines it. Scales differ between coordinates.",
        ),
    )


def activations_section(subject: Subject, result: CalibrationResult) -> str:
    """Write the report section on muscle activations."""
    peaks = np.asarray(result.states.activation).mean(axis=1).max(axis=-1)
    strongest = result.muscles[int(np.argmax(peaks))]
    return markup.section(
        "Muscle activations",
        markup.picture(
            activation_figure(result, driving_signals(subject, result)),
            alternative=f"Activation of {len(result.muscles)} muscles over the gait cycle. The mean "
            f"activation of {strongest} peaks highest, at {decimals(float(peaks.max()))}.",
            caption="Muscle activation (0 to 1, no unit) over the gait cycle, all cycles: mean ± one "
            "standard deviation. Small print: the EMG channel that drives the "
            f"muscle{', or synergies' if subject.synergies else ''}. All panels have the same scale.",
        ),
    )


def fiber_lengths_section(result: CalibrationResult) -> str:
    """Write the report section on normalised fiber lengths."""
    low, high = FIBER_LENGTH_RANGE
    finding = fiber_length_finding(result)
    limited = (
        ", and to which hard limits (lines) restrict them on calibration cycles; diamonds: muscles at which "
        "a limit is active"
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
            f"the expected range of working lengths{limited}. Dashed: optimal length, where active force is "
            f"largest. {finding}",
        ),
    )


def fiber_length_finding(result: CalibrationResult) -> str:
    """Write a sentence on the muscles that leave the expected range of fiber lengths, and on which cycles."""
    low, high = FIBER_LENGTH_RANGE
    lengths = np.asarray(result.states.fiber.normalized_length)
    tolerance = result.solver.ctol  # active limits are satisfied to this tolerance
    outside = np.any((lengths < low - tolerance) | (lengths > high + tolerance), axis=2)
    leaving = [muscle for muscle, cycles in zip(result.muscles, outside, strict=True) if cycles.any()]
    if not leaving:
        return "After calibration all muscles stay within this range."
    matched = np.array([use == "calibration" for use in result.uses])
    where = "" if outside[:, matched].any() else ", on validation cycles only"
    verb = "leaves" if len(leaving) == 1 else "leave"
    return f"After calibration {', '.join(leaving)} {verb} this range{where}."
