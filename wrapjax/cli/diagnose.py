"""Command ``wrapjax diagnose``."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wrapjax.cli.common import (
    DONE,
    NOT_CONVERGED,
    AddCommand,
    add_effect_options,
    print_result,
)
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.path_sources.exact import ExactGeometry
    from wrapjax.path_sources.polynomial_fit import Fit
    from wrapjax.subject.subject import Subject

_WIDTH = 100


class ListEffects(argparse.Action):
    """Action of ``--list``: print the effects of the catalogue and exit, without a subject."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None):
        super().__init__(option_strings, dest=argparse.SUPPRESS, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print the identifier and the meaning of each effect, one line each."""
        from wrapjax.diagnosis.effects.catalogue import effect_meanings

        print("\n".join(f"{id}: {meaning}." for id, meaning in effect_meanings().items()))
        parser.exit(DONE)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    diagnose = command(
        "diagnose",
        run,
        "Calibrate a model, locate its remaining moment error, and find the effects that explain it best.",
        writing,
    )
    diagnose.add_argument("--list", action=ListEffects, help="list the effects of the catalogue and exit")
    diagnose.add_argument("subject", type=Path, metavar="SUBJECT", help="subject folder")
    diagnose.add_argument("--out", type=Path, required=True, metavar="GAP", help="output folder")
    add_effect_options(diagnose)
    diagnose.add_argument(
        "--protocol",
        action="store_true",
        help="also simulate further trials, and advise the three that would tell most; takes a minute or two",
    )
    diagnose.add_argument(
        "--against",
        metavar="B",
        help="find what differs from a second condition of the same person: another subject folder, or one "
        "of two conditions of this one; writes difference.json",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.calibration.problem import fit_for_methods
    from wrapjax.cli.calibrate import iteration_printer
    from wrapjax.diagnosis.diagnosis import diagnose
    from wrapjax.diagnosis.effects.catalogue import refuse_unknown
    from wrapjax.diagnosis.protocol.protocol import protocol
    from wrapjax.path_sources.polynomial_fit import load_fit
    from wrapjax.progress import print_progress
    from wrapjax.subject.conditions import load_conditions
    from wrapjax.subject.subject import load_subject

    check_output_folder(options.out, options.force)
    refuse_unknown(options.without)
    conditions: tuple[str, str] | None = None
    if options.against and options.protocol:
        raise InputError(Problem("--protocol", "expected no --against, which compares two conditions"))
    if options.against:
        subject, conditions = load_conditions(options.subject, options.against)
    else:
        subject = load_subject(options.subject)
    if options.fit:
        paths = load_fit(options.fit, subject)
    else:
        paths = fit_for_methods(
            (options.method,), subject, seed=options.seed, processes=options.threads, quiet=options.quiet
        )
    if conditions is not None:
        return _run_against(options, subject, conditions, paths)
    done = diagnose(
        subject,
        options.method,
        paths,
        without=options.without,
        starts=options.starts,
        seed=options.seed,
        callback=iteration_printer(quiet=options.quiet),
        log=lambda line: print_progress(line, quiet=options.quiet),
    )
    without_result = done.result.outcome in ("insufficient_data", "not_converged")
    further = None
    if options.protocol and not without_result:
        further = protocol(done, log=lambda line: print_progress(line, quiet=options.quiet))
        done = further.added_to(done)
    done.save(options.out, force=options.force, motion=True)
    if further is not None:
        further.save(options.out / "protocol")
    print_result(options, "gap.json", lambda: str(done))
    return NOT_CONVERGED if without_result else DONE


def _run_against(
    options: argparse.Namespace, subject: Subject, conditions: tuple[str, str], paths: Fit | ExactGeometry
) -> int:
    """Compare two conditions of a person."""
    from wrapjax.cli.calibrate import iteration_printer
    from wrapjax.diagnosis.conditions.against import diagnose_against
    from wrapjax.progress import print_progress
    from wrapjax.report.diagnosis.difference_page import difference_findings

    done = diagnose_against(
        subject,
        conditions,
        options.method,
        paths,
        without=options.without,
        starts=options.starts,
        seed=options.seed,
        callback=iteration_printer(quiet=options.quiet),
        log=lambda line: print_progress(line, quiet=options.quiet),
    )
    done.save(options.out, force=options.force)
    sentences = [textwrap.fill(sentence, _WIDTH) for sentence in difference_findings(done) if sentence]
    print_result(options, "difference.json", lambda: "\n".join(sentences))
    return DONE
