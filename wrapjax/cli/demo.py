"""Command ``wrapjax demo``, with the tables of recovered parameters and wrapping cylinders."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.cli.common import (
    DONE,
    NOT_CONVERGED,
    AddCommand,
    checkpoint_folder,
    print_json,
    read_json,
)
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.demonstration.demo import Demonstration

#: File with the solver's iterations where nobody watches them on a terminal.
LOG = "iterations.log"


def recovery_table(demonstration: Demonstration) -> str:
    """Tabulate the errors of muscle parameters before and after calibration of these alone (NGA)."""
    lines = [
        "Absolute errors of the parameters, median over muscles. The recordings come from the same model",
        "equations: this tests the software, not the accuracy on people. 'sd' is the standard deviation of a",
        "parameter due to the noise of the moments, without priors: where it is far above the error, the",
        "priors determine the parameter.",
        f"{'parameter':26s}{'before':>10s}{'after':>10s}{'sd':>10s}  unit",
    ]
    for row in demonstration.recovery:
        factor, unit = {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(row.unit, (1.0, row.unit))
        values = (row.median_error_before, row.median_error_after, row.median_deviation)
        columns = "".join(f"{factor * value:10.3g}" for value in values)
        lines.append(f"{row.parameter:26s}{columns}  {unit}")
    return "\n".join(lines)


def wrap_recovery_table(demonstration: Demonstration) -> str:
    """Tabulate errors of moment arms and parameters of wrapping cylinders after calibration by PGA."""
    recovery = demonstration.wraps
    before, after, deviation = (
        1e3 * errors for errors in (recovery.error_before, recovery.error_after, recovery.deviation)
    )
    lines = [
        f"Mean absolute errors of the moment arms of {len(recovery.muscles)} muscles round displaced "
        "cylinders, mm.",
        "'before': with nominal cylinders; 'after': with those of PGA. 'sd' is the standard deviation of a",
        "moment arm due to the noise of the moments; 'identifiable' counts the muscles where it is below a",
        "tenth of the error before. For the others an EMG scale or a fiber length explains the moments as",
        "well, and PGA need not reduce the error.",
        f"{'coordinate':20s}{'before':>10s}{'after':>10s}{'sd':>10s}{'identifiable':>14s}",
    ]
    for column, name in enumerate(recovery.coordinates):
        values = "".join(f"{errors[:, column].mean():10.2f}" for errors in (before, after, deviation))
        lines.append(f"{name:20s}{values}{recovery.identifiable[:, column].sum():14d}")
    lines += ["", "Cylinders, true / calibrated: translations (mm), rotations (degrees), radius factor"]
    width = max(len(name) for name in recovery.wraps)
    for name, true, calibrated in zip(
        recovery.wraps, recovery.true_wraps, recovery.calibrated_wraps, strict=True
    ):
        factors = np.array([*[1e3] * 3, *[np.degrees(1.0)] * 2, 1.0])
        pairs = zip(factors * true, factors * calibrated, (1, 1, 1, 0, 0, 2), strict=True)
        cells = [f"{first:.{digits}f} / {second:.{digits}f}" for first, second, digits in pairs]
        lines.append(f"{name:{width}s}" + "".join(f"{cell:>15s}" for cell in cells))
    return "\n".join(lines)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    demo = command(
        "demo",
        run,
        "Calibrate a virtual subject with known parameters by every method, and diagnose another one.",
        writing,
    )
    demo.add_argument(
        "--out",
        type=Path,
        default=Path("wrapjax-demo"),
        metavar="DIR",
        help="output folder (default: wrapjax-demo)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.cli.calibrate import calibration_table, iteration_log, iteration_printer
    from wrapjax.cli.report import redraw
    from wrapjax.demonstration.demo import demo

    checkpoints = checkpoint_folder(options)
    resume = options.resume and checkpoints.exists()
    check_output_folder(options.out, options.force or resume)
    watched = options.quiet or sys.stderr.isatty()
    demonstration = demo(
        options.out,
        seed=options.seed,
        force=options.force,
        checkpoints=checkpoints,
        resume=resume,
        quiet=options.quiet,
        callback=iteration_printer(quiet=options.quiet) if watched else iteration_log(options.out / LOG),
    )
    index = redraw(options.out)
    if options.json:
        print_json(read_json(options.out / "demo.json"))
    else:
        for calibration in demonstration.calibrations.values():
            print(calibration_table(calibration))
            print()
        print(recovery_table(demonstration))
        print()
        print(wrap_recovery_table(demonstration))
        print(
            f"\nSimulated effect in another virtual person: {demonstration.effect_diagnosis.hidden}. Its "
            f"diagnosis "
            "(same model equations, so not the accuracy on people):\n"
        )
        print(demonstration.effect_diagnosis.diagnosis)
        print(f"\nwritten to {options.out}; open {index} in a browser")
    return DONE if demonstration.converged else NOT_CONVERGED
