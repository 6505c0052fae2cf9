"""Errors and curves in the report: moments, activations and fiber lengths."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrapjax.calibrate import FIBER_LENGTH_RANGE, CalibrationResult
from wrapjax.report import markup
from wrapjax.report.cycles import MomentCurves
from wrapjax.report.figures import activation_figure, fiber_length_figure, moment_figure
from wrapjax.report.limits import FIBER_LIMITS, pushing_muscles
from wrapjax.report.wording import decimals
from wrapjax.subject import Subject


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
        if set(FIBER_LIMITS) & pushing_muscles(result).keys()
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
