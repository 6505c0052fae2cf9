"""The commands. Results go to standard output, progress to standard error.

Exit status: 0 done and converged, 1 ran but did not converge, 2 bad input or usage.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wrapjax.commands import ADDED
from wrapjax.commands.common import (
    BAD_INPUT,
    DONE,
    NOT_CONVERGED,
    positive,
    print_json,
    show,
    stored,
)
from wrapjax.errors import InputError, Problem
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_threads, set_up_jax

if TYPE_CHECKING:
    from wrapjax.api import ExactGeometry, Fit


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A terminal that lacks a letter of somebody's name shows its code instead of failing.
        sys.stdout.reconfigure(errors="backslashreplace")
    options = _parser().parse_args(arguments)
    if options.threads is not None:
        set_threads(options.threads)
    try:
        return options.run(options)
    except InputError as error:
        for problem in error.problems:
            print(f"error: {problem}", file=sys.stderr)
        if len(error.problems) > 1:
            print(f"{len(error.problems)} problems found; nothing was written.", file=sys.stderr)
        return BAD_INPUT
    except OSError as error:
        place = error.filename or "file"
        print(f"error: {place}: {error.strerror or error}; nothing was written.", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted; nothing was written.", file=sys.stderr)
        return NOT_CONVERGED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wrapjax", description="Calibrate EMG-driven musculoskeletal models with exact gradients."
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--threads", type=positive, metavar="N", help="processor cores to use (default: all)")
    common.add_argument("--quiet", action="store_true", help="print no progress")
    common.add_argument("--json", action="store_true", help="print the result as JSON")
    writing = argparse.ArgumentParser(add_help=False)
    writing.add_argument("--seed", type=int, default=0, metavar="N", help="of everything random (default: 0)")
    writing.add_argument("--force", action="store_true", help="replace the folder if it exists")

    def command(name: str, run: Any, help: str, *parents: argparse.ArgumentParser) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=help, description=help, parents=[common, *parents])
        added.set_defaults(run=run)
        return added

    check = command("check", _check, "Read a subject folder and show what is in it, or all that is wrong.")
    check.add_argument("subject", type=Path, metavar="SUBJECT")

    prepare = command(
        "prepare",
        _prepare,
        "Make a subject folder of a laboratory's raw files, or of a project of the NMSM Pipeline.",
    )
    prepare.add_argument("settings", type=Path, metavar="SETTINGS", help="TOML, or the project's XML")
    prepare.add_argument("--out", type=Path, required=True, metavar="SUBJECT")
    prepare.add_argument("--force", action="store_true", help="replace the folder if it exists")

    fit = command("fit", _fit, "Replace the subject's muscle paths by polynomials.", writing)
    fit.add_argument("subject", type=Path, metavar="SUBJECT")
    fit.add_argument("--out", type=Path, required=True, metavar="FIT")
    fit.add_argument(
        "--geometry",
        choices=["opensim", "engine", "engine-parity"],
        default="opensim",
        help="source of the paths: OpenSim, the exact engine (shortest paths), or it as OpenSim wraps",
    )

    calibrate = command("calibrate", _calibrate, "Calibrate the model to the subject.", writing)
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
        "--resume", action="store_true", help="go on with an interrupted calibration of the same RUN"
    )

    compare = command("compare", _compare, "Calibrate by every method, and test which differ.", writing)
    compare.add_argument("subjects", type=Path, nargs="+", metavar="SUBJECT")
    compare.add_argument("--out", type=Path, required=True, metavar="DIR")
    compare.add_argument(
        "--methods",
        type=lambda text: tuple(text.split(",")),
        metavar="NAME,NAME",
        help="the first is what others are tested against (default: all, against NGA)",
    )
    compare.add_argument("--curves", choices=["paper", "opensim"], default="paper", help="Hill curves")
    compare.add_argument(
        "--geometry",
        choices=["surrogate", "engine"],
        default="surrogate",
        help="what NGA and PGA take paths from (SGA and LSGA: always the polynomials)",
    )
    compare.add_argument(
        "--starts", type=positive, default=4, metavar="N", help="of each calibration, as in 'calibrate'"
    )
    compare.add_argument(
        "--max-iterations", type=positive, metavar="N", help="of each start (default: the solver's)"
    )
    compare.add_argument(
        "--resume", action="store_true", help="go on with an interrupted comparison of the same DIR"
    )

    diagnose = command(
        "diagnose", _diagnose, "Say where the remaining error is and what explains it best.", writing
    )
    diagnose.add_argument("subject", type=Path, metavar="SUBJECT")
    diagnose.add_argument("--out", type=Path, required=True, metavar="GAP")
    diagnose.add_argument(
        "--method",
        choices=["NGA", "SGA", "LSGA", "PGA"],
        default="NGA",
        help="of the calibration before it (default: NGA)",
    )
    diagnose.add_argument(
        "--without",
        action="extend",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="leave these out of the catalogue; the calibration is not done again",
    )
    diagnose.add_argument(
        "--fit", type=Path, metavar="FIT", help="from 'wrapjax fit' (default: made and cached)"
    )
    diagnose.add_argument(
        "--starts", type=positive, default=4, metavar="N", help="of the calibration, as in 'calibrate'"
    )
    diagnose.add_argument(
        "--resume", action="store_true", help="go on with an interrupted calibration (done in any case)"
    )

    demo = command("demo", _demo, "Calibrate a virtual subject of known truth by every method.", writing)
    demo.add_argument("--out", type=Path, default=Path("wrapjax-demo"), metavar="DIR")

    for add in ADDED:
        add(command, writing)
    return parser


def _check(options: argparse.Namespace) -> int:
    from wrapjax.subject import describe_subject, read_subject, render_tables

    tables = describe_subject(read_subject(options.subject))
    if options.json:
        print_json(
            {
                table.title: [dict(zip(table.header, row, strict=True)) for row in table.rows]
                for table in tables
            }
        )
    else:
        print(render_tables(tables))
    return DONE


def _prepare(options: argparse.Namespace) -> int:
    from wrapjax.api import prepare_subject
    from wrapjax.progress import say
    from wrapjax.subject import render_tables

    refuse_existing(options.out, options.force)
    done = prepare_subject(options.settings, tell=lambda line: say(line, quiet=options.quiet))
    done.save(options.out, force=options.force)
    if options.json:
        print_json(stored(options.out / "preparation.json"))
    else:
        print(render_tables(done.tables()))
        print(f"written to {options.out}; see 'wrapjax check {options.out}'")
    return DONE


def _fit(options: argparse.Namespace) -> int:
    set_up_jax()
    from wrapjax.api import fit, fit_wraps, load_subject
    from wrapjax.api.text import fit_table, wrap_table
    from wrapjax.progress import say

    refuse_existing(options.out, options.force)
    subject = load_subject(options.subject)
    how = {"processes": options.threads, "quiet": options.quiet}
    result = fit_wraps(subject, fit(subject, options.geometry, seed=options.seed, **how), **how)
    say("drawing the report", quiet=options.quiet)
    result.save(options.out, subject=subject, force=options.force)

    def tables() -> str:
        wraps = result.wraps
        return fit_table(result) + (f"\n\n{wrap_table(wraps)}" if wraps and wraps.quality else "")

    show(options, "fit.json", tables)
    return DONE


def _calibrate(options: argparse.Namespace) -> int:
    set_up_jax()
    from wrapjax.api import calibrate, exact_geometry, load_fit, load_subject
    from wrapjax.api.preparation import source_for
    from wrapjax.api.text import calibration_table, iteration_printer
    from wrapjax.calibrate import AugmentedLagrangian, BoundedLBFGS, ProjectedLM, Status
    from wrapjax.progress import say
    from wrapjax.subject import read_legs

    refuse_existing(options.out, options.force)
    if options.fit and options.geometry == "engine":
        raise InputError(Problem("--fit", "is for --geometry surrogate: the exact engine needs no fit"))
    journal = _journal(options)
    inner = {"lm": ProjectedLM, "lbfgs": BoundedLBFGS}[options.solver]()
    if options.max_iterations:
        inner = replace(inner, max_iterations=options.max_iterations)
    subject = load_subject(options.subject)
    read_legs(subject)  # whatever is wrong with the other leg is said before the long work
    paths: Fit | ExactGeometry
    if options.geometry == "engine":
        paths = exact_geometry(subject)
    elif options.fit:
        paths = load_fit(options.fit, subject)
    else:
        paths = source_for(
            options.method, subject, seed=options.seed, processes=options.threads, quiet=options.quiet
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
        journal=journal,
        resume=options.resume,
    )
    if done.status is Status.interrupted:
        say("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    done.save(options.out, force=options.force)
    show(options, "summary.json", lambda: "\n\n".join(map(calibration_table, done.legs)))
    return DONE if done.status.converged else NOT_CONVERGED


def _compare(options: argparse.Namespace) -> int:
    set_up_jax()
    from wrapjax.api import compare, load_subject
    from wrapjax.api.preparation import METHODS
    from wrapjax.api.text import comparison_table, iteration_printer
    from wrapjax.calibrate import AugmentedLagrangian, ProjectedLM
    from wrapjax.progress import say

    refuse_existing(options.out, options.force)
    journal = _journal(options)
    inner = ProjectedLM()
    if options.max_iterations:
        inner = replace(inner, max_iterations=options.max_iterations)
    try:
        done = compare(
            _load_all(options.subjects, load_subject),
            options.methods or METHODS,
            geometry=options.geometry,
            solver=AugmentedLagrangian(inner),
            starts=options.starts,
            seed=options.seed,
            callback=iteration_printer(quiet=options.quiet),
            curves=options.curves,
            processes=options.threads,
            quiet=options.quiet,
            journal=journal,
            resume=options.resume,
        )
    except KeyboardInterrupt:
        if not journal.exists():
            raise
        say("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    done.save(options.out, force=options.force)
    show(options, "comparison.json", lambda: comparison_table(done))
    return DONE if done.converged else NOT_CONVERGED


def _diagnose(options: argparse.Namespace) -> int:
    set_up_jax()
    from wrapjax.api import diagnose, load_fit, load_subject
    from wrapjax.api.diagnosis import refuse_unknown
    from wrapjax.api.gap_text import gap_table
    from wrapjax.api.preparation import source_for
    from wrapjax.api.text import iteration_printer
    from wrapjax.progress import say

    refuse_existing(options.out, options.force)
    refuse_unknown(options.without)
    subject = load_subject(options.subject)
    if options.fit:
        paths = load_fit(options.fit, subject)
    else:
        paths = source_for(
            options.method, subject, seed=options.seed, processes=options.threads, quiet=options.quiet
        )
    done = diagnose(
        subject,
        options.method,
        paths,
        without=options.without,
        starts=options.starts,
        seed=options.seed,
        callback=iteration_printer(quiet=options.quiet),
        tell=lambda line: say(line, quiet=options.quiet),
    )
    done.save(options.out, force=options.force)
    show(options, "gap.json", lambda: gap_table(done.result))
    return NOT_CONVERGED if done.result.outcome in ("insufficient_data", "not_converged") else DONE


def _load_all(folders: Sequence[Path], load: Callable[[Path], Any]) -> list[Any]:
    """Read every subject, and say of all of them at once what is wrong."""
    subjects: list[Any] = []
    problems: list[Problem] = []
    for folder in folders:
        try:
            subjects.append(load(folder))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return subjects


def _demo(options: argparse.Namespace) -> int:
    set_up_jax()
    from wrapjax.api.demo import demo
    from wrapjax.api.gap_text import gap_table
    from wrapjax.api.text import (
        calibration_table,
        iteration_printer,
        recovery_table,
        wrap_recovery_table,
    )

    refuse_existing(options.out, options.force)
    shown = demo(
        options.out,
        seed=options.seed,
        force=options.force,
        quiet=options.quiet,
        callback=iteration_printer(quiet=options.quiet),
    )
    if options.json:
        print_json(stored(options.out / "demo.json"))
    else:
        for calibration in shown.calibrations.values():
            print(calibration_table(calibration))
            print()
        print(recovery_table(shown))
        print()
        print(wrap_recovery_table(shown))
        print(f"\nhidden in another person: {shown.gap.hidden}; a diagnosis (unit test, no accuracy) says:\n")
        print(gap_table(shown.gap.diagnosis.result))
        print(f"\nwritten to {options.out}; open {options.out / 'PGA' / 'report.html'} in a browser")
    return DONE if shown.converged else NOT_CONVERGED


def _journal(options: argparse.Namespace) -> Path:
    """Name the folder of unfinished work, which is not thrown away unasked."""
    journal = options.out.with_name(f".{options.out.name}.unfinished")
    if journal.exists() and not (options.resume or options.force):
        raise InputError(
            Problem(
                str(options.out),
                "was begun and interrupted",
                hint="go on with --resume, or begin anew with --force",
            )
        )
    return journal


def _version() -> str:
    from wrapjax import __version__

    return f"wrapjax {__version__}"


if __name__ == "__main__":
    sys.exit(main())
