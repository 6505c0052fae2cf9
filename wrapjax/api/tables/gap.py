"""A diagnosis as plain text for a terminal."""

from __future__ import annotations

import math
import textwrap

from wrapjax.gap.result import GapResult

_WIDTH = 100
_MOST_EFFECTS = 6


def gap_table(result: GapResult) -> str:
    """Show how a diagnosis ended, the most probable effects, and what could not be tested."""
    from wrapjax.report.gap.words import findings, untested

    lines = [textwrap.fill(sentence, _WIDTH) for sentence in findings(result)]
    if result.effects:
        lines += ["", *_effect_lines(result)]
    if result.budget is not None:
        lines += ["", *_error_lines(result)]
    if result.advice:
        lines += ["", "What would tell them apart"]
        lines += [
            textwrap.fill(
                f"{advice.experiment} ({advice.minutes} min): {', '.join(advice.splits)}",
                _WIDTH,
                initial_indent="  ",
                subsequent_indent="    ",
            )
            for advice in result.advice
        ]
    if said := untested(result):
        lines += ["", *(textwrap.fill(sentence, _WIDTH) for sentence in said)]
    return "\n".join(lines)


def _effect_lines(result: GapResult) -> list[str]:
    from wrapjax.report.gap.words import amounts_in_words

    shown = result.effects[:_MOST_EFFECTS]
    width = max(len(name) for name in (*(effect.id for effect in shown), "not in the catalogue")) + 2
    lines = [f"{'effect':{width}s}{'probability':>12s}{'evidence':>10s}  amounts"]
    for effect in shown:
        lines.append(
            f"{effect.id:{width}s}{effect.probability:12.2f}{effect.evidence:10.1f}"
            f"  {amounts_in_words(effect.amounts, most=2)}".rstrip()
        )
    rest = sum(effect.probability for effect in result.effects[_MOST_EFFECTS:])
    others = len(result.effects) - len(shown)
    if others:
        lines.append(f"{f'{others} others':{width}s}{rest:12.2f}")
    for name, probability in (
        ("nothing amiss", result.none_probability),
        ("not in the catalogue", result.unknown_probability),
    ):
        lines.append(f"{name:{width}s}{probability:12.2f}")
    return lines


def _error_lines(result: GapResult) -> list[str]:
    """Show mean absolute errors of cycles that no fit has seen; what cannot be told is left out."""
    from wrapjax.report.gap.errors import mean_absolute_errors

    errors = mean_absolute_errors(result)
    columns = [which for which, own in errors.items() if math.isfinite(own["mean"])]
    width = max(len(name) for name in (*result.coordinates, "coordinate"))
    lines = [
        "Mean absolute error of the joint moments on cycles that no fit has seen, N m; floor: noise alone",
        f"{'coordinate':{width}s}" + "".join(f"{which:>10s}" for which in columns),
    ]
    for name in (*result.coordinates, "mean"):
        lines.append(f"{name:{width}s}" + "".join(f"{errors[which][name]:10.2f}" for which in columns))
    return lines
