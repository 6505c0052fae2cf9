"""Report of a calibration as a self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from wrapjax.calibration.result import CalibrationResult
from wrapjax.calibration.uncertainty.intervals import LegSpread
from wrapjax.report import markup
from wrapjax.report.calibration_curves import (
    activations_section,
    drive_section,
    errors_section,
    fiber_lengths_section,
    moments_section,
)
from wrapjax.report.formatting import counted, decimals, leg_name
from wrapjax.report.parameters import parameters_section, solver_section
from wrapjax.report.path_views import path_section
from wrapjax.report.paths import MovedPath
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.run_summary import USES
from wrapjax.report.spread import spread_section
from wrapjax.report.starts import starts_section
from wrapjax.subject.subject import Subject


def render_report(
    subject: Subject,
    result: CalibrationResult,
    summary: dict[str, Any],
    settings: dict[str, Any],
    moves: Sequence[MovedPath] = (),
    spread: LegSpread | None = None,
) -> str:
    """Write the report of a calibration as a self-contained HTML page.

    Parameters
    ----------
    subject, result
        Calibrated subject and result of the calibration.
    summary
        Content of ``summary.json``, from `summarize`.
    settings
        Content of ``settings.json``, from `describe_settings`.
    moves
        Muscle paths to show in space, from `moved_paths`.
    spread
        Uncertainty of parameters and moments, if it was requested.
    """
    title = f"{subject.name}: {result.method} calibration"
    counts = {use: result.uses.count(use) for use in USES}
    under = (
        f"{leg_name(subject.side)}, {subject.mass_kg:g} kg, {len(subject.muscle_channels)} muscles driven by "
        f"{counted(len(subject.trials.channels), 'EMG channel')}, "
        f"{_driven_by_synergies(subject)}"
        f"{counted(len(result.coordinates), 'coordinate')}, "
        f"{counted(counts['calibration'], 'gait cycle')} for calibration and {counts['validation']} for "
        f"validation. {settings['date'][:10]}."
    )
    return markup.page(
        title,
        [
            markup.header(title, under),
            markup.verdict(run_findings(result, summary), fine=summary["converged"]),
            errors_section(result, summary),
            moments_section(result, summary),
            drive_section(subject, result),
            activations_section(subject, result),
            fiber_lengths_section(result),
            path_section(result, moves),
            parameters_section(result),
            *([] if spread is None else [spread_section(result, spread)]),
            starts_section(result),
            solver_section(result, summary),
            _notes_section(subject, result, settings),
        ],
    )


def _driven_by_synergies(subject: Subject) -> str:
    """Write the number of muscles without an electrode that synergies drive."""
    if subject.synergies is None:
        return ""
    count = subject.synergies.basis.count - 1
    return f"{len(subject.synergies.muscles)} by {count} synerg{'y' if count == 1 else 'ies'} of these, "


def run_findings(result: CalibrationResult, summary: dict[str, Any]) -> list[str]:
    """Write sentences on convergence, errors and bounds of a calibration."""
    errors = {use: summary["mae_Nm"][use] for use in USES} | {
        "before": summary["before"]["mae_Nm"]["calibration"]
    }
    mean = {name: decimals(None if error is None else error["mean"]) for name, error in errors.items()}
    cycles = {use: counted(result.uses.count(use), f"{use} cycle") for use in USES}
    first = (
        f"Modelled and measured joint moments differ by {mean['calibration']} N m on average over "
        f"{cycles['calibration']} (before calibration: {mean['before']} N m)"
    )
    if summary["mae_Nm"]["validation"] is None:
        second = (
            "No cycles were held out for validation, so the accuracy of predictions for other cycles is "
            "unknown."
        )
    else:
        second = (
            f"On {cycles['validation']}, held out from calibration, they differ by {mean['validation']} N m."
        )
    at_bounds, free = len(result.at_bounds), summary["n_variables"]
    third = f"None of the {free} free parameters ended on a bound."
    if at_bounds:
        third = (
            f"{at_bounds} of the {free} free parameters ended on a bound: their values are determined by the "
            "bound rather than by the data."
        )
    outcome = "The calibration converged."
    if not summary["converged"]:
        outcome = f"The calibration did not converge, so its values are not final. {summary['message']}"
    return [outcome, f"{first}. {second}", third]


def _notes_section(subject: Subject, result: CalibrationResult, settings: dict[str, Any]) -> str:
    undriven = (
        f"{counted(len(subject.undriven_muscles), 'muscle')} of this leg's model without EMG, which exert no "
        f"force here: {', '.join(subject.undriven_muscles)}."
        if subject.undriven_muscles
        else f"EMG{' or its synergies' if subject.synergies else ''} drives every muscle of this leg's model."
    )
    versions = versions_in_words(settings["versions"])
    speeds = sorted({float(speed) for speed in result.speeds if math.isfinite(speed)})
    made = [
        f"Subject folder {subject.folder.name} (path in settings.json), model {subject.model_file.name}.",
        f"Walking speed: {', '.join(f'{speed:g}' for speed in speeds)} m/s."
        if speeds
        else "Walking speed: not given.",
        f"{versions}; {settings['platform']}; {settings['date']}.",
        "Bounds and priors are in settings.json, all parameters in parameters.csv, the final values of each "
        "start in starts.csv, and curves of every cycle in moments/, activations/ and muscle_forces/.",
    ]
    return markup.section("Notes", markup.bullets([undriven, *subject.notes, *made]))
