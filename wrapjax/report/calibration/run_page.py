"""Folder of a finished calibration, and its report as a self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrapjax.calibration.calibration_result import CalibrationResult, of_trials
from wrapjax.calibration.uncertainty.intervals import LegSpread
from wrapjax.evaluation.metrics import LeftOutTask
from wrapjax.io.files import new_folder, write_atomically, write_json, write_text
from wrapjax.io.storage import write_storage
from wrapjax.report import markup
from wrapjax.report.calibration.calibration_curves import (
    activations_section,
    drive_section,
    errors_section,
    fiber_lengths_section,
)
from wrapjax.report.calibration.parameters_and_solver import parameters_section, solver_section
from wrapjax.report.calibration.run_summary import USES, file_stems, summarize
from wrapjax.report.calibration.run_tables import band_table, curve_tables, osimx_of, parameters_csv
from wrapjax.report.calibration.spread import describe_spread, describe_uncertainty, spread_section
from wrapjax.report.calibration.starts import starts_csv, starts_section
from wrapjax.report.calibration.task_curves import left_out_csv, left_out_section, moment_sections
from wrapjax.report.formatting import counted, decimals, leg_name
from wrapjax.report.model_view.page import write_beside_report
from wrapjax.report.model_view.results import shown_calibration
from wrapjax.report.paths.moved_paths import MovedPath, moved_paths
from wrapjax.report.paths.path_views import path_section
from wrapjax.report.provenance import describe_settings, path_from, versions_in_words
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import GAIT

if TYPE_CHECKING:
    from wrapjax.geometry.skeleton.model_description import ModelDescription


def render_report(
    subject: Subject,
    result: CalibrationResult,
    summary: dict[str, Any],
    settings: dict[str, Any],
    moves: Sequence[MovedPath] = (),
    spread: LegSpread | None = None,
    link: str = "",
    left_out: Sequence[LeftOutTask] = (),
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
    link
        HTML below the title, such as a link to another page.
    left_out
        Errors of calibrations without each task, if they were requested.
    """
    title = f"{subject.name}: {result.method} calibration"
    counts = {use: result.uses.count(use) for use in USES}
    under = (
        f"{leg_name(subject.side)}, {subject.mass_kg:g} kg, {len(subject.muscle_channels)} muscles driven by "
        f"{counted(len(subject.trials.channels), 'EMG channel')}, "
        f"{_driven_by_synergies(subject)}"
        f"{counted(len(result.coordinates), 'coordinate')}, "
        f"{counted(counts['calibration'], _unit(result))} for calibration and {counts['validation']} for "
        f"validation. {settings['date'][:10]}."
    )
    return markup.page(
        title,
        [
            markup.header(title, under),
            link,
            markup.verdict(run_findings(result, summary), fine=summary["converged"]),
            errors_section(result, summary),
            *moment_sections(result, summary),
            *([left_out_section(left_out)] if left_out else []),
            *_muscle_sections(subject, result),
            fiber_lengths_section(result),
            path_section(result, moves),
            parameters_section(result),
            *([] if spread is None else [spread_section(result, spread)]),
            starts_section(result),
            solver_section(result, summary),
            _notes_section(subject, result, settings),
        ],
    )


def _muscle_sections(subject: Subject, result: CalibrationResult) -> list[str]:
    """Write the sections on what drove the muscles and on their activations, which are shown over gait."""
    gait = np.array([task == GAIT for task in result.tasks])
    if not gait.any():
        return []
    walking = result if gait.all() else of_trials(result, gait)
    return [drive_section(subject, walking), activations_section(subject, walking)]


def _driven_by_synergies(subject: Subject) -> str:
    """Write the number of muscles without an electrode that synergies drive."""
    if subject.synergies is None:
        return ""
    count = subject.synergies.basis.count - 1
    return f"{len(subject.synergies.muscles)} by {count} synerg{'y' if count == 1 else 'ies'} of these, "


def _unit(result: CalibrationResult) -> str:
    return "gait cycle" if set(result.tasks) == {GAIT} else "gait cycle or window"


def run_findings(result: CalibrationResult, summary: dict[str, Any]) -> list[str]:
    """Write sentences on convergence, errors and bounds of a calibration."""
    errors = {use: summary["mae_Nm"][use] for use in USES} | {
        "before": summary["before"]["mae_Nm"]["calibration"]
    }
    mean = {name: decimals(None if error is None else error["mean"]) for name, error in errors.items()}
    noun = "cycle" if set(result.tasks) == {GAIT} else "cycle or window"
    cycles = {use: counted(result.uses.count(use), f"{use} {noun}") for use in USES}
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


#: Reads the elements that determine muscle paths from a model file: `wrapjax.osim.model.describe_model`.
DescribeModel = Callable[[Path], "ModelDescription"]

#: Writes a subject's model with the calibrated values to a file:
#: `wrapjax.calibration.calibration.write_calibrated_model`.
WriteModel = Callable[[Subject, CalibrationResult, Path], None]

#: OpenSim model of a leg with calibrated wrapping surfaces.
PERSONALISED_MODEL = "model_personalized.osim"

#: Calibrated polynomials of muscle paths: `PathSurrogate.arrays`.
PATHS = "paths.npz"

#: Folder, within that of a leg, of the leg that was calibrated together with it.
OTHER_LEG = "other_leg"


def write_run(
    legs: Sequence[tuple[Subject, CalibrationResult]],
    folder: Path,
    *,
    force: bool = False,
    describe_model: DescribeModel | None = None,
    write_calibrated_model: WriteModel | None = None,
    spreads: Sequence[LegSpread] = (),
    motion: bool = False,
    left_out: Sequence[LeftOutTask] = (),
) -> None:
    """Write a calibration's summary, parameters, curves, settings and report.

    Parameters
    ----------
    legs
        Subject and result of one leg or of two; the second is written to a folder within that of the first.
    folder
        Folder to write; it appears when it is complete.
    force
        Whether to replace an existing folder.
    describe_model
        Function that reads a model file, to show calibrated wrapping surfaces; without it they are not shown.
    write_calibrated_model
        Function that writes the model with calibrated wrapping surfaces; without it no model is written.
    spreads
        Uncertainty of each leg's parameters and moments, if it was requested.
    motion
        Whether to write a page beside the report that shows calibrated wraps in motion.
    left_out
        Errors of calibrations without each task of the only leg, if they were requested.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or cannot be created.
    """
    with new_folder(folder, force=force) as run:
        for place, (subject, result), spread in zip_longest(
            (run, run / OTHER_LEG)[: len(legs)], legs, spreads
        ):
            _write_leg(subject, result, place, describe_model, spread, motion, left_out)
            if write_calibrated_model is not None and result.freedom.wraps is not None:
                write_calibrated_model(subject, result, place / PERSONALISED_MODEL)


def _write_leg(
    subject: Subject,
    result: CalibrationResult,
    run: Path,
    describe_model: DescribeModel | None,
    spread: LegSpread | None,
    motion: bool,
    left_out: Sequence[LeftOutTask],
) -> None:
    summary = summarize(subject, result)
    if spread is not None:
        summary["uncertainty"] = describe_spread(spread)
        write_json(run / "uncertainty.json", describe_uncertainty(result, spread))
    settings = describe_settings(subject, result, run)
    write_json(run / "summary.json", summary)
    write_json(run / "settings.json", settings)
    write_text(run / "parameters.csv", parameters_csv(result, spread))
    # A nominal model is not copied. The relative path remains valid if run and subject are moved together.
    model = path_from(run, subject.model_file) if result.freedom.wraps is None else PERSONALISED_MODEL
    write_text(run / "calibrated.osimx", osimx_of(result, model))
    write_text(run / "starts.csv", starts_csv(result))
    if left_out:
        write_text(run / "left_out_tasks.csv", left_out_csv(left_out))
    if result.calibrated_paths is not None:
        arrays = result.calibrated_paths.arrays()
        write_atomically(run / PATHS, lambda file: np.savez(file, allow_pickle=False, **arrays))
    for trial, stem in enumerate(file_stems(result.trials).values()):
        for kind, table in curve_tables(result, trial).items():
            write_storage(run / kind / f"{stem}.sto", table)
        if spread is not None:
            write_storage(run / "moment_bands" / f"{stem}.sto", band_table(result, spread, trial))
    moves: list[MovedPath] = []
    if describe_model is not None and result.freedom.wraps is not None:
        moves = moved_paths(subject, result, describe_model(subject.model_file))
    link = ""
    if motion and result.freedom.wraps is not None:
        link = write_beside_report(run, shown_calibration(run, subject))
    page = render_report(subject, result, summary, settings, moves, spread, link, left_out)
    write_text(run / "report.html", page)
