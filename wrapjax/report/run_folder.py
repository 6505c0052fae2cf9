"""Folder of a finished calibration, which is written completely or not at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.calibration.result import CalibrationResult
from wrapjax.calibration.uncertainty.intervals import LegSpread
from wrapjax.io.files import new_folder, write_atomically, write_json, write_text
from wrapjax.io.storage import write_storage
from wrapjax.report.paths import MovedPath, moved_paths
from wrapjax.report.provenance import describe_settings, path_from
from wrapjax.report.run_page import render_report
from wrapjax.report.run_summary import file_stems, summarize
from wrapjax.report.run_tables import band_table, curve_tables, osimx_of, parameters_csv
from wrapjax.report.spread import describe_spread, describe_uncertainty
from wrapjax.report.starts import starts_csv
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from wrapjax.geometry.model_description import ModelDescription

#: Reads the elements that determine muscle paths from a model file: `wrapjax.osim.model.describe_model`.
DescribeModel = Callable[[Path], "ModelDescription"]

#: Writes a subject's model with the calibrated values to a file:
#: `wrapjax.calibration.calibration.write_calibrated_model`.
WriteModel = Callable[[Subject, CalibrationResult, Path], None]

#: OpenSim model of a leg with calibrated cylinders.
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
        Function that reads a model file, to show calibrated cylinders; without it they are not shown.
    write_calibrated_model
        Function that writes the model with calibrated cylinders; without it no model is written.
    spreads
        Uncertainty of each leg's parameters and moments, if it was requested.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or cannot be created.
    """
    with new_folder(folder, force=force) as run:
        for place, (subject, result), spread in zip_longest(
            (run, run / OTHER_LEG)[: len(legs)], legs, spreads
        ):
            _write_leg(subject, result, place, describe_model, spread)
            if write_calibrated_model is not None and result.freedom.wraps is not None:
                write_calibrated_model(subject, result, place / PERSONALISED_MODEL)


def _write_leg(
    subject: Subject,
    result: CalibrationResult,
    run: Path,
    describe_model: DescribeModel | None,
    spread: LegSpread | None,
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
    write_text(run / "report.html", render_report(subject, result, summary, settings, moves, spread))
