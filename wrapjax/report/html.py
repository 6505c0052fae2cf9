"""The report of a calibration: one page that opens anywhere, offline."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from wrapjax.calibrate import FIBER_LENGTH_RANGE, CalibrationResult
from wrapjax.model import QUANTITIES
from wrapjax.report import markup
from wrapjax.report.figures import activation_figure, fiber_length_figure, moment_figure
from wrapjax.report.limits import pushing_muscles
from wrapjax.report.parameter_figures import bounds_figure, cost_figure, history_figure
from wrapjax.report.path_section import path_section
from wrapjax.report.starts import starts_section
from wrapjax.report.style import Figure, to_svg
from wrapjax.report.summary import USES
from wrapjax.subject import Subject


def render_report(
    subject: Subject, result: CalibrationResult, summary: dict[str, Any], settings: dict[str, Any]
) -> str:
    """Write the report of a calibration as one HTML page with nothing outside it.

    Parameters
    ----------
    subject, result
        What was calibrated, and what came of it.
    summary
        From `summarize`.
    settings
        From `describe_settings`.
    """
    title = f"{subject.name}: {result.method} calibration"
    side = {"l": "left", "r": "right"}[subject.side]
    counts = {use: result.uses.count(use) for use in USES}
    under = (
        f"{side.capitalize()} leg, {subject.mass_kg:g} kg, {len(result.muscles)} muscles driven by "
        f"{_count(len(subject.trials.channels), 'EMG channel')}, "
        f"{_count(len(result.coordinates), 'coordinate')}, "
        f"{_count(counts['calibration'], 'gait cycle')} for calibration and {counts['validation']} for "
        f"validation. {settings['date'][:10]}."
    )
    return markup.page(
        title,
        [
            f"<header><h1>{markup.text(title)}</h1>\n{markup.paragraph(under, 'under')}</header>",
            _verdict(result, summary),
            _errors(result, summary),
            _moments(result, summary),
            _activations(subject, result),
            _fiber_lengths(result),
            path_section(result),
            _parameters(result),
            starts_section(result),
            _solver(result, summary),
            _notes(subject, result, settings),
        ],
    )


def verdict(result: CalibrationResult, summary: dict[str, Any]) -> list[str]:
    """Say in plain sentences what came of a calibration."""
    mean = {use: _mean(summary["mae_Nm"][use]) for use in USES}
    before = _mean(summary["before"]["mae_Nm"]["calibration"])
    cycles = {use: _count(result.uses.count(use), f"{use} cycle") for use in USES}
    first = (
        f"Modelled and measured joint moments differ by {mean['calibration']} N m on average over "
        f"{cycles['calibration']} (before calibration: {before} N m)"
    )
    if summary["mae_Nm"]["validation"] is None:
        second = (
            "No cycles were kept for validation, so how well the model predicts walking it has not seen is "
            "not known."
        )
    else:
        second = (
            f"On {cycles['validation']}, which calibration has not seen, they differ by "
            f"{mean['validation']} N m."
        )
    stuck, free = len(result.at_bounds), summary["n_variables"]
    third = f"None of the {free} free parameters ended on a bound."
    if stuck:
        third = (
            f"{stuck} of the {free} free parameters ended on a bound: their values were set by the bound "
            "rather than by the data."
        )
    outcome = "The calibration converged."
    if not summary["converged"]:
        outcome = f"The calibration did not converge, so its values are not final. {summary['message']}"
    return [outcome, f"{first}. {second}", third]


def _verdict(result: CalibrationResult, summary: dict[str, Any]) -> str:
    sentences = verdict(result, summary)
    content = "\n".join(
        [f"<p><strong>{markup.text(sentences[0])}</strong></p>", *map(markup.paragraph, sentences[1:])]
    )
    return markup.box(content, "verdict" if summary["converged"] else "verdict failed")


def _errors(result: CalibrationResult, summary: dict[str, Any]) -> str:
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
            _number(largest.get(name)),
            *(_number(None if column is None else column[name]) for column in columns.values()),
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
            numeric=True,
            total=True,
        ),
    )


def _moments(result: CalibrationResult, summary: dict[str, Any]) -> str:
    parts = [
        f"{name} {_number(value)} N m"
        for name, value in (summary["mae_Nm"]["calibration"] or {}).items()
        if name != "mean"
    ]
    return markup.section(
        "Joint moments",
        _drawn(
            moment_figure(result),
            "Measured and modelled joint moments over the gait cycle for each coordinate. Mean absolute "
            f"errors on calibration cycles: {', '.join(parts)}.",
            "Net joint moments in N m over the gait cycle: measured by inverse dynamics (black) and modelled "
            "from EMG (blue). Lines are means over cycles, bands one standard deviation to either side "
            "(no band where there is one cycle); 'error' is the mean absolute error. A positive moment "
            "acts towards larger values of the coordinate, as OpenSim defines it. Scales differ "
            "between coordinates.",
        ),
    )


def _activations(subject: Subject, result: CalibrationResult) -> str:
    channels = subject.trials.channels
    channel_of = {
        muscle: channels[place]
        for muscle, place in zip(subject.muscles.names, subject.muscle_channels, strict=True)
    }
    peaks = np.asarray(result.states.activation).mean(axis=1).max(axis=-1)
    strongest = result.muscles[int(np.argmax(peaks))]
    return markup.section(
        "Muscle activations",
        _drawn(
            activation_figure(result, channel_of),
            f"Activation of {len(result.muscles)} muscles over the gait cycle. The mean activation of "
            f"{strongest} peaks highest, at {_number(float(peaks.max()))}.",
            "Muscle activation (0 to 1, no unit) over the gait cycle, all cycles: mean and one standard "
            "deviation to either side. Small print: the EMG channel that drives the muscle. "
            "All panels have one scale.",
        ),
    )


def _fiber_lengths(result: CalibrationResult) -> str:
    low, high = FIBER_LENGTH_RANGE
    lengths = np.asarray(result.states.fiber.normalized_length)
    beyond = [
        muscle
        for muscle, own in zip(result.muscles, lengths, strict=True)
        if own.min() < low or own.max() > high
    ]
    finding = (
        f"After calibration {', '.join(beyond)} {'leaves' if len(beyond) == 1 else 'leave'} this range."
        if beyond
        else "After calibration all muscles stay within this range."
    )
    return markup.section(
        "Fiber lengths",
        _drawn(
            fiber_length_figure(result),
            f"Ranges of normalised fiber lengths of {len(result.muscles)} muscles before and after "
            f"calibration. {finding}",
            "Fiber length over optimal fiber length (no unit): range (bar) and mean (dot) over all frames of "
            f"all cycles, before (gray) and after calibration (blue). Shaded: {low:g} to {high:g}, where "
            "muscles are expected to work; dashed: optimal length, where active force is largest. " + finding,
        ),
    )


def _parameters(result: CalibrationResult) -> str:
    if not result.freedom.parameters:
        return markup.section("Muscle parameters", markup.paragraph("No parameter was free."))
    meanings = [
        f"{parameter.name}: {QUANTITIES[parameter.name].meaning}" for parameter in result.freedom.parameters
    ]
    rows = list(_stuck_rows(result))
    stuck = (
        markup.table(
            ("parameter", "bound", "number", "muscles"),
            rows,
            caption="Parameters that ended on a bound. Where many do, look at the data (EMG scale, "
            "electrode, model) before trusting the values.",
        )
        if rows
        else markup.paragraph("No parameter ended on a bound.")
    )
    return markup.section(
        "Muscle parameters",
        _drawn(
            bounds_figure(result),
            f"Position of {len(result.freedom.parameters)} parameters of {len(result.muscles)} muscles "
            f"between their bounds; {len(result.at_bounds)} lie at a bound, listed in the table below.",
            "Each free parameter between its lower bound (left) and upper bound (right): calibrated (dot), "
            "before calibration (gray stroke), at a bound (diamond). Bounds in % are shares of the "
            "model's own value.",
        ),
        markup.bullets(meanings),
        stuck,
    )


def _stuck_rows(result: CalibrationResult) -> Iterable[tuple[str, str, str, str]]:
    """One row a parameter and bound, with the muscles that ended there."""
    for parameter in result.freedom.parameters:
        values = np.asarray(getattr(result.parameters, parameter.name))
        nearer_lower = values - parameter.lower <= parameter.upper - values
        for bound, side in (("lower", nearer_lower), ("upper", ~nearer_lower)):
            names = [
                muscle
                for muscle, here in zip(result.muscles, side, strict=True)
                if here and f"{muscle}.{parameter.name}" in result.at_bounds
            ]
            if names:
                yield parameter.name, bound, str(len(names)), ", ".join(names)


def _solver(result: CalibrationResult, summary: dict[str, Any]) -> str:
    largest = max(result.cost_by_term, key=lambda name: result.cost_by_term[name])
    costs = [iteration.cost for iteration in result.solution.history]
    seconds = summary["seconds"]
    return markup.section(
        "Solver",
        markup.paragraph(
            f"{_count(summary['starts'], 'start')} in {seconds['solve']:.1f} s, after "
            f"{seconds['compile']:.1f} s of "
            f"compiling; {_count(summary['iterations'], 'iteration')} in the one taken; "
            f"{summary['n_variables']} "
            f"variables, {summary['n_residuals']} moment residuals. {summary['message']}"
        ),
        *map(markup.paragraph, _limits(result, summary)),
        _drawn(
            history_figure(result),
            f"Cost and optimality by iteration. The cost falls from {_number(costs[0])} to "
            f"{_number(costs[-1])}; optimality ends at {result.solution.history[-1].optimality:.2g}.",
            "The cost that is minimised, and optimality (the largest move that steepest descent within the "
            "bounds would still make, in solver units), by iteration. Both scales are logarithmic. "
            "Where paths "
            "may change, the first iterations hold them; the cost jumps where hard limits come in or are met "
            "more strictly.",
        ),
        _drawn(
            cost_figure(result),
            f"Parts of the cost at the solution; the largest is {largest.replace('_', ' ')}, "
            f"{result.cost_by_term[largest]:.3g} of {summary['cost']:.4g}.",
            "Parts of the cost at the solution. Each is a mean square in allowable errors: 1 means an "
            "error as large as allowed.",
        ),
    )


def _limits(result: CalibrationResult, summary: dict[str, Any]) -> list[str]:
    muscles = pushing_muscles(result)
    if not muscles:
        return []
    pushing = [f"{name.replace('_', ' ')}: {', '.join(own)}" for name, own in muscles.items() if own]
    return [
        f"Hard limits on fiber lengths and on the sign of moment arms are violated by at most "
        f"{summary['max_constraint_violation']:.1g} (normalised fiber length, or cm). "
        + (f"These push against one: {'; '.join(pushing)}." if pushing else "Nothing pushes against one.")
    ]


def _notes(subject: Subject, result: CalibrationResult, settings: dict[str, Any]) -> str:
    undriven = (
        f"{_count(len(subject.undriven_muscles), 'muscle')} of this leg's model without EMG and without "
        f"force here: {', '.join(subject.undriven_muscles)}."
        if subject.undriven_muscles
        else "EMG drives every muscle of this leg's model."
    )
    versions = ", ".join(f"{name} {number}" for name, number in settings["versions"].items() if number)
    speeds = sorted({float(speed) for speed in result.speeds if math.isfinite(speed)})
    made = [
        f"Subject folder {subject.folder}, model {subject.model_file.name}.",
        f"Walking speed: {', '.join(f'{speed:g}' for speed in speeds)} m/s."
        if speeds
        else "Walking speed: not given.",
        f"{versions}; {settings['platform']}; {settings['date']}.",
        "Bounds and priors are in settings.json, every parameter in parameters.csv, curves of every cycle in "
        "moments/, activations/ and muscle_forces/.",
    ]
    return markup.section("Notes", markup.bullets([undriven, *subject.notes, *made]))


def _drawn(figure: Figure, alternative: str, caption: str) -> str:
    return markup.picture(to_svg(figure), alternative=alternative, caption=caption)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _mean(errors: dict[str, float] | None) -> str:
    return _number(None if errors is None else errors["mean"])


def _number(value: float | None) -> str:
    """Two decimals; a dash where there is no number."""
    return "\N{EN DASH}" if value is None or not math.isfinite(value) else f"{value:.2f}"
