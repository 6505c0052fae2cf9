"""``wrapjax demo``.

How near a virtual subject's calibration came to its truth, for a terminal.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.cli.common import DONE, NOT_CONVERGED, AddCommand, checkpoint_folder, print_json, read_json
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.demonstration.demo import Demonstration


def recovery_table(shown: Demonstration) -> str:
    """Show how close a virtual subject's calibration came to its truth."""
    lines = [
        "Distance from the hidden truth, median over muscles (same-form data: a unit test, not an accuracy).",
        "'open' is the standard deviation that the moments alone, with their noise, leave to a parameter:",
        "where it is far above the distance, priors decide and the moments cannot.",
        f"{'parameter':26s}{'before':>10s}{'after':>10s}{'open':>10s}  unit",
    ]
    for row in shown.recovery:
        factor, unit = {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(row.unit, (1.0, row.unit))
        values = (row.median_error_before, row.median_error_after, row.median_deviation)
        columns = "".join(f"{factor * value:10.3g}" for value in values)
        lines.append(f"{row.parameter:26s}{columns}  {unit}")
    return "\n".join(lines)


def wrap_recovery_table(shown: Demonstration) -> str:
    """Show how close moment arms and cylinders came to a virtual subject's own."""
    found = shown.wraps
    before, after, open_ = (
        1e3 * errors for errors in (found.error_before, found.error_after, found.deviation)
    )
    lines = [
        f"Moment arms of the {len(found.muscles)} muscles round hidden cylinders: mean absolute error, mm",
        "(same-form data: a unit test, not an accuracy). 'before' is round nominal cylinders, 'after' round",
        "those of PGA. 'open' is the standard deviation that the moments alone, with their noise, leave to",
        "an arm; 'told apart' counts muscles where that is below a tenth of the error before. Elsewhere an",
        "EMG scale or a fiber explains the moments as well, and what PGA moves need not be nearer the truth.",
        f"{'about':20s}{'before':>10s}{'after':>10s}{'open':>10s}{'told apart':>12s}",
    ]
    for column, name in enumerate(found.coordinates):
        values = "".join(f"{errors[:, column].mean():10.2f}" for errors in (before, after, open_))
        lines.append(f"{name:20s}{values}{found.identifiable[:, column].sum():12d}")
    lines += ["", "Cylinders, true / found: shift (mm), turns (degrees), factor of the radius"]
    width = max(len(name) for name in found.wraps)
    for name, true, own in zip(found.wraps, found.true_wraps, found.found_wraps, strict=True):
        factors = np.array([*[1e3] * 3, *[np.degrees(1.0)] * 2, 1.0])
        pairs = zip(factors * true, factors * own, (1, 1, 1, 0, 0, 2), strict=True)
        cells = [f"{one:.{digits}f} / {other:.{digits}f}" for one, other, digits in pairs]
        lines.append(f"{name:{width}s}" + "".join(f"{cell:>15s}" for cell in cells))
    return "\n".join(lines)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    demo = command("demo", run, "Calibrate a virtual subject of known truth by every method.", writing)
    demo.add_argument("--out", type=Path, default=Path("wrapjax-demo"), metavar="DIR")


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.cli.calibrate import calibration_table, iteration_printer
    from wrapjax.cli.diagnose import diagnosis_table
    from wrapjax.demonstration.demo import demo

    checkpoints = checkpoint_folder(options)
    begun = options.resume and checkpoints.exists()
    check_output_folder(options.out, options.force or begun)
    shown = demo(
        options.out,
        seed=options.seed,
        force=options.force,
        checkpoints=checkpoints,
        resume=begun,
        quiet=options.quiet,
        callback=iteration_printer(quiet=options.quiet),
    )
    if options.json:
        print_json(read_json(options.out / "demo.json"))
    else:
        for calibration in shown.calibrations.values():
            print(calibration_table(calibration))
            print()
        print(recovery_table(shown))
        print()
        print(wrap_recovery_table(shown))
        print(f"\nhidden in another person: {shown.gap.hidden}; a diagnosis (unit test, no accuracy) says:\n")
        print(diagnosis_table(shown.gap.diagnosis.result))
        print(f"\nwritten to {options.out}; open {options.out / 'PGA' / 'report.html'} in a browser")
    return DONE if shown.converged else NOT_CONVERGED
