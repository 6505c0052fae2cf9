"""Command ``wrapjax diagnose``, with the tables of a diagnosis."""

from __future__ import annotations

import argparse
import math
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
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.diagnosis.result import DiagnosisResult
    from wrapjax.path_sources.exact import ExactGeometry
    from wrapjax.path_sources.polynomial_fit import Fit
    from wrapjax.subject.subject import Subject

_WIDTH = 100
_MOST_EFFECTS = 6


def diagnosis_table(result: DiagnosisResult) -> str:
    """Format a diagnosis: outcome, most probable effects, errors, advice and untestable effects."""
    from wrapjax.report.diagnosis_words import diagnosis_findings, gate_rows, untested_findings

    lines = [textwrap.fill(sentence, _WIDTH) for sentence in diagnosis_findings(result)]
    if rows := gate_rows(result):
        lines += ["", *(f"{name:10s}{passed:8s}{figure}" for name, _, figure, passed in rows)]
    if result.effects:
        lines += ["", *_effect_lines(result)]
    if result.budget is not None:
        lines += ["", *_error_lines(result)]
    if result.advice:
        lines += ["", "Experiments that would distinguish them"]
        lines += [
            textwrap.fill(
                f"{advice.experiment} ({advice.minutes} min): {', '.join(advice.splits)}",
                _WIDTH,
                initial_indent="  ",
                subsequent_indent="    ",
            )
            for advice in result.advice
        ]
    if sentences := untested_findings(result):
        lines += ["", *(textwrap.fill(sentence, _WIDTH) for sentence in sentences)]
    return "\n".join(lines)


def _effect_lines(result: DiagnosisResult) -> list[str]:
    from wrapjax.report.diagnosis_words import effect_sizes_in_words, shown_effects

    shown = shown_effects(result)[:_MOST_EFFECTS]
    width = max(len(name) for name in (*(effect.id for effect in shown), "not in the catalogue")) + 2
    lines = [f"{'effect':{width}s}{'probability':>12s}{'evidence':>10s}  effect sizes"]
    for effect in shown:
        lines.append(
            f"{effect.id:{width}s}{effect.probability:12.2f}{effect.evidence:10.1f}"
            f"  {effect_sizes_in_words(effect.effect_sizes, most=2)}".rstrip()
        )
    names = {effect.id for effect in shown}
    rest = sum(effect.probability for effect in result.effects if effect.id not in names)
    others = len(result.effects) - len(shown)
    if others:
        lines.append(f"{f'{others} others':{width}s}{rest:12.2f}")
    for name, probability in (
        ("no effect", result.none_probability),
        ("not in the catalogue", result.unknown_probability),
    ):
        lines.append(f"{name:{width}s}{probability:12.2f}")
    return lines


def _error_lines(result: DiagnosisResult) -> list[str]:
    """Tabulate mean absolute errors on held-out cycles, without columns that could not be estimated."""
    from wrapjax.report.diagnosis_numbers import mean_absolute_errors

    errors = mean_absolute_errors(result)
    columns = [model for model, values in errors.items() if math.isfinite(values["mean"])]
    width = max(len(name) for name in (*result.coordinates, "coordinate"))
    lines = [
        "Mean absolute error of the joint moments on held-out cycles, N m; floor: noise alone",
        f"{'coordinate':{width}s}" + "".join(f"{model:>10s}" for model in columns),
    ]
    for name in (*result.coordinates, "mean"):
        lines.append(f"{name:{width}s}" + "".join(f"{errors[model][name]:10.2f}" for model in columns))
    return lines


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
    from wrapjax.path_sources.polynomial_fit import load_fit
    from wrapjax.progress import print_progress
    from wrapjax.subject.conditions import load_conditions
    from wrapjax.subject.subject import load_subject

    check_output_folder(options.out, options.force)
    refuse_unknown(options.without)
    conditions: tuple[str, str] | None = None
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
    done.save(options.out, force=options.force, motion=True)
    print_result(options, "gap.json", lambda: diagnosis_table(done.result))
    return NOT_CONVERGED if done.result.outcome in ("insufficient_data", "not_converged") else DONE


def _run_against(
    options: argparse.Namespace, subject: Subject, conditions: tuple[str, str], paths: Fit | ExactGeometry
) -> int:
    """Compare two conditions of a person."""
    from wrapjax.cli.calibrate import iteration_printer
    from wrapjax.diagnosis.against import diagnose_against
    from wrapjax.progress import print_progress
    from wrapjax.report.difference_page import difference_findings

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
