"""Command ``wrapjax fit``, with tables of the fit's errors by muscle and by wrapping surface."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from wrapjax.cli.common import DONE, AddCommand, add_undriven_options, positive_number, print_result
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.path_sources.polynomial_fit import Fit
    from wrapjax.path_sources.polynomial_paths import WrapFit


def fit_table(fit: Fit) -> str:
    """Tabulate the errors of fitted muscle paths, one line per muscle."""
    titles = ("wrapped", "terms", "length RMSE", "length max", "arm RMSE", "arm max")
    lines = [
        "Errors on poses not used in fitting, mm (moment arms pooled over coordinates)",
        f"{'muscle':16s}" + "".join(f"{title:>13s}" for title in titles),
    ]
    for name, error in fit.errors.items():
        errors = (
            error.length_rmse_mm,
            error.length_max_mm,
            error.moment_arm_rmse_mm,
            error.moment_arm_max_mm,
        )
        wrapped = "yes" if error.wrapped else "no"
        lines.append(
            f"{name:16s}{wrapped:>13s}{error.terms:13d}" + "".join(f"{value:13.3f}" for value in errors)
        )
    return "\n".join(lines)


def wrap_table(wraps: WrapFit) -> str:
    """Tabulate bounds and feasibility of the wrapping surfaces, one line per surface."""
    titles = ("half width", "physiological", "accuracy", "false positive", "touched")
    lines = [
        "Wrapping surfaces, on samples not used in fitting: half width of the translation bounds (mm), share",
        "of samples with physiological paths, balanced accuracy of the feasibility score, share of the other",
        "samples that it accepts (false positive), and whether a muscle touches it in a recorded frame",
        f"{'surface':24s}" + "".join(f"{title:>15s}" for title in titles),
    ]
    for name, quality in wraps.quality.items():
        shares = (quality.physiological_share, quality.balanced_accuracy, quality.false_physiological)
        columns = "".join(f"{'-':>15s}" if share is None else f"{share:15.3f}" for share in shares)
        touched = "yes" if name in wraps.touched else "no"
        lines.append(f"{name:24s}{1e3 * wraps.translations[name]:15.1f}{columns}{touched:>15s}")
    return "\n".join(lines)


#: Largest differences from the nominal path at which a path counts as physiological, by the names and with
#: the defaults of `PhysiologicalThresholds`.
THRESHOLDS = {
    "length_deviation": "difference of length in any pose, m (default: 0.025)",
    "moment_arm_deviation": "difference of a moment arm in any pose, m (default: 0.02)",
    "variability": "ratio of the standard deviations over poses of length or moment arm (default: 3)",
    "length_step": "change of the length difference between frames of a recorded cycle, m (default: 0.001)",
    "moment_arm_step": "change of the moment-arm difference between frames of a recorded cycle, m (default: "
    "0.003)",
    "new_contact": "share of the poses in which a path touches a surface that the nominal path never "
    "touches, above 0 (default: 1)",
    "bone_distance": "increase of a surface's distance from the bones of its body, with --bones, m (default: "
    "0.005)",
}


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    fit = command("fit", run, "Fit polynomials to the muscle paths of a subject's model.", writing)
    fit.add_argument("subject", type=Path, metavar="SUBJECT", help="subject folder")
    fit.add_argument("--out", type=Path, required=True, metavar="FIT", help="output folder")
    fit.add_argument(
        "--geometry",
        choices=["opensim", "engine", "engine-parity"],
        default="opensim",
        help="source of the muscle paths: opensim, by OpenSim (default); engine, shortest paths by the exact "
        "engine; engine-parity, the exact engine with OpenSim's wrapping",
    )
    add_undriven_options(fit)
    fit.add_argument(
        "--bones",
        type=Path,
        metavar="DIR",
        help="folder of the bones' surfaces, .vtp, near which wrapping surfaces have to stay",
    )
    limits = fit.add_argument_group(
        "limits of physiological paths, as differences from those round the nominal surfaces"
    )
    for name, what in THRESHOLDS.items():
        limits.add_argument(f"--{name.replace('_', '-')}", type=positive_number, metavar="X", help=what)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.geometry.surrogates.physiological import PhysiologicalThresholds
    from wrapjax.path_sources.path_fitting import fit
    from wrapjax.path_sources.undriven_muscles import apply_undriven_strategy
    from wrapjax.path_sources.wrap_fitting import fit_wraps
    from wrapjax.progress import print_progress
    from wrapjax.subject.subject import load_subject

    check_output_folder(options.out, options.force)
    if options.bones is not None and not options.bones.is_dir():
        # Before the polynomials are fitted, which takes minutes.
        raise InputError(Problem(str(options.bones), "expected a folder of bones' surfaces, found none"))
    subject = apply_undriven_strategy(load_subject(options.subject), options.undriven, options.synergies)
    settings = {"processes": options.threads, "quiet": options.quiet}
    thresholds = {name: value for name in THRESHOLDS if (value := getattr(options, name)) is not None}
    fitted = fit(subject, options.geometry, seed=options.seed, **settings)
    result = fit_wraps(
        subject,
        fitted,
        thresholds=PhysiologicalThresholds(**thresholds),
        bone_folders=() if options.bones is None else (options.bones,),
        **settings,
    )
    print_progress("drawing the report", quiet=options.quiet)
    result.save(options.out, subject=subject, force=options.force, motion=True)

    def tables() -> str:
        wraps = result.wraps
        return fit_table(result) + (f"\n\n{wrap_table(wraps)}" if wraps and wraps.quality else "")

    print_result(options, "fit.json", tables)
    return DONE
