"""``wrapjax calibrate``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from wrapjax.commands.common import (
    DONE,
    NOT_CONVERGED,
    AddCommand,
    add_drive,
    positive,
    show,
    unfinished,
)
from wrapjax.errors import InputError, Problem
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.api import ExactGeometry, Fit


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    calibrate = command("calibrate", run, "Calibrate the model to the subject.", writing)
    calibrate.add_argument("subject", type=Path, metavar="SUBJECT")
    calibrate.add_argument(
        "--method", choices=["NGA", "SGA", "LSGA", "PGA"], required=True, help="what is adjusted"
    )
    calibrate.add_argument("--out", type=Path, required=True, metavar="RUN")
    calibrate.add_argument(
        "--fit", type=Path, metavar="FIT", help="from 'wrapjax fit' (default: made and cached)"
    )
    calibrate.add_argument(
        "--geometry",
        choices=["surrogate", "engine"],
        default="surrogate",
        help="source of the paths: polynomials, or the exact engine, which needs no fit (NGA and PGA)",
    )
    calibrate.add_argument(
        "--surfaces",
        choices=["touched", "all"],
        default="touched",
        help="cylinders that PGA moves: those that muscles lie on in a recorded frame, or all",
    )
    calibrate.add_argument("--curves", choices=["paper", "opensim"], default="paper", help="Hill curves")
    calibrate.add_argument(
        "--tendon",
        choices=["rigid", "compliant"],
        default="rigid",
        help="compliant: stretches with force, and takes several times as long",
    )
    calibrate.add_argument(
        "--starts", type=positive, default=4, metavar="N", help="the model's own values and N-1 random ones"
    )
    calibrate.add_argument(
        "--max-iterations", type=positive, metavar="N", help="of each start (default: the solver's)"
    )
    calibrate.add_argument(
        "--solver", choices=["lm", "lbfgs"], default="lm", help="lbfgs: jaxopt's, a slow second opinion"
    )
    calibrate.add_argument(
        "--uncertainty",
        choices=["laplace", "bootstrap"],
        help="say how well the recordings determine parameters: quickly, or by a calibration a draw",
    )
    calibrate.add_argument("--draws", type=positive, metavar="N", help="of the bootstrap (default: 50)")
    add_drive(calibrate)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api import calibrate, exact_geometry, load_fit, load_subject
    from wrapjax.api.calibrating.extrapolation import drive
    from wrapjax.api.calibrating.problem import source_for
    from wrapjax.api.calibrating.uncertainty import DRAWS, uncertainty
    from wrapjax.api.tables.calibration import calibration_table, iteration_printer
    from wrapjax.api.tables.uncertainty import uncertainty_table
    from wrapjax.calibrate import AugmentedLagrangian, BoundedLBFGS, ProjectedLM, Status
    from wrapjax.progress import progress_bar, say
    from wrapjax.subject import read_legs

    refuse_existing(options.out, options.force)
    if options.fit and options.geometry == "engine":
        raise InputError(Problem("--fit", "is for --geometry surrogate: the exact engine needs no fit"))
    if options.draws and options.uncertainty != "bootstrap":
        raise InputError(Problem("--draws", "is for --uncertainty bootstrap: nothing else is drawn anew"))
    if options.draws == 1:
        raise InputError(Problem("--draws", "expected at least 2, found 1: one draw has no spread"))
    if options.surfaces != "touched" and options.method != "PGA":
        raise InputError(Problem("--surfaces", "is for --method PGA: the others move no cylinders"))
    journal = unfinished(options)
    inner = {"lm": ProjectedLM, "lbfgs": BoundedLBFGS}[options.solver]()
    if options.max_iterations:
        inner = replace(inner, max_iterations=options.max_iterations)
    subject = load_subject(options.subject)
    read_legs(subject)  # whatever is wrong with the other leg is said before the long work
    subject = drive(subject, options.undriven, options.synergies)
    paths: Fit | ExactGeometry
    if options.geometry == "engine":
        paths = exact_geometry(subject)
    elif options.fit:
        paths = load_fit(options.fit, subject)
    else:
        paths = source_for(
            (options.method,), subject, seed=options.seed, processes=options.threads, quiet=options.quiet
        )
    say("compiling (once; later runs take it from the cache)", quiet=options.quiet)
    done = calibrate(
        subject,
        options.method,
        paths,
        solver=AugmentedLagrangian(inner),
        starts=options.starts,
        seed=options.seed,
        callback=iteration_printer(quiet=options.quiet),
        curves=options.curves,
        tendon=options.tendon,
        surfaces=options.surfaces,
        undriven=options.undriven,
        synergies=options.synergies,
        journal=journal,
        resume=options.resume,
    )
    if done.status is Status.interrupted:
        say("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    if options.uncertainty is None:
        done.save(options.out, force=options.force)
        show(options, "summary.json", lambda: "\n\n".join(map(calibration_table, done.legs)))
        return DONE if done.status.converged else NOT_CONVERGED
    count = options.draws or DRAWS[options.uncertainty]
    quiet = options.quiet or options.uncertainty == "laplace"
    say("judging how well the recordings determine parameters", quiet=options.quiet)
    try:
        with progress_bar("calibrating made-up moments", count, quiet=quiet) as advance:
            judged = uncertainty(done, options.uncertainty, draws=count, seed=options.seed, advance=advance)
    except KeyboardInterrupt:
        say("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    judged.save(options.out, force=options.force)
    show(options, "summary.json", lambda: uncertainty_table(judged))
    return DONE if done.status.converged else NOT_CONVERGED
