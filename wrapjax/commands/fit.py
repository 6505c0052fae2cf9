"""``wrapjax fit``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.commands.common import DONE, AddCommand, add_drive, positive_number, show
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_up_jax

#: What a path may differ by from the nominal one and still count as physiological, by the names that
#: `PhysiologicalThresholds` has, with its defaults.
THRESHOLDS = {
    "length_deviation": "length, in any pose, m (default: 0.025)",
    "moment_arm_deviation": "moment arm, in any pose and about any coordinate, m (default: 0.02)",
    "variability": "ratio of standard deviations over poses, of length or of a moment arm (default: 3)",
    "length_step": "change of length from frame to frame of a recorded cycle, m (default: 0.001)",
    "moment_arm_step": "change of a moment arm from frame to frame of a recorded cycle, m (default: 0.003)",
}


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    fit = command("fit", run, "Replace the subject's muscle paths by polynomials.", writing)
    fit.add_argument("subject", type=Path, metavar="SUBJECT")
    fit.add_argument("--out", type=Path, required=True, metavar="FIT")
    fit.add_argument(
        "--geometry",
        choices=["opensim", "engine", "engine-parity"],
        default="opensim",
        help="source of the paths: OpenSim, the exact engine (shortest paths), or it as OpenSim wraps",
    )
    add_drive(fit)
    limits = fit.add_argument_group("a placement of cylinders is physiological up to these differences")
    for name, what in THRESHOLDS.items():
        limits.add_argument(f"--{name.replace('_', '-')}", type=positive_number, metavar="X", help=what)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api import PhysiologicalThresholds, fit, fit_wraps, load_subject
    from wrapjax.api.calibrating.extrapolation import drive
    from wrapjax.api.tables.fit import fit_table, wrap_table
    from wrapjax.progress import say

    refuse_existing(options.out, options.force)
    subject = drive(load_subject(options.subject), options.undriven, options.synergies)
    how = {"processes": options.threads, "quiet": options.quiet}
    given = {name: value for name in THRESHOLDS if (value := getattr(options, name)) is not None}
    fitted = fit(subject, options.geometry, seed=options.seed, **how)
    result = fit_wraps(subject, fitted, thresholds=PhysiologicalThresholds(**given), **how)
    say("drawing the report", quiet=options.quiet)
    result.save(options.out, subject=subject, force=options.force)

    def tables() -> str:
        wraps = result.wraps
        return fit_table(result) + (f"\n\n{wrap_table(wraps)}" if wraps and wraps.quality else "")

    show(options, "fit.json", tables)
    return DONE
