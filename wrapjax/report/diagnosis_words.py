"""A diagnosis in plain words. It says what explains the error best, never what caused it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.result import Alternative, DiagnosisResult, EffectFinding, EffectSize, Estimate
from wrapjax.report.diagnosis_numbers import leading, mean_absolute_errors, shrinkage, why_no_shrinkage
from wrapjax.report.style import counted, plain

#: Outcomes that say nothing of effects.
SILENT = ("insufficient_data", "not_converged")


def findings(result: DiagnosisResult) -> list[str]:
    """Say in plain sentences what came of a diagnosis.

    The first holds the outcome, and before it how much there is to explain.
    """
    # Of the other outcomes the reason says once more what the outcome does.
    needed = result.reason and result.outcome in (*SILENT, "unknown")
    reason = [_sentence(result.reason)] if needed else []
    if result.outcome in SILENT:
        return [_outcome(result), *reason]
    first = f"{_explainable(result.explainable_share)} {_outcome(result)}"
    sentences = [first, *reason, *_meanings(result), *_shrinkage(result), *_moments(result)]
    if loud := loud_controls(result):
        sentences.append(
            f"Read all of this with doubt: {listed(effect.id for effect in loud)} must stay quiet in such a "
            "recording and did not."
        )
    return sentences


def untested(result: DiagnosisResult) -> list[str]:
    """Say in plain sentences what the diagnosis could not have found."""
    sentences = []
    if result.not_testable:
        names = listed(one.id for one in result.not_testable)
        sentences.append(f"Cannot be tested with this recording: {names}.")
    if result.withheld:
        sentences.append(
            f"Left out on request: {listed(result.withheld)}. If this is what the model lacks, it cannot be "
            "named here."
        )
    return sentences


def testable(result: DiagnosisResult) -> list[EffectFinding]:
    """Give the effects that this recording could show, were they there."""
    hidden = {one.id for one in result.not_testable}
    return [effect for effect in result.effects if effect.id not in hidden]


def loud_controls(result: DiagnosisResult) -> list[EffectFinding]:
    """Give the effects that had to stay quiet and have more evidence than data without any effect show."""
    return [
        one for one in result.effects if one.negative_control and one.evidence > result.detection_threshold
    ]


def words(ids: Sequence[str]) -> str:
    """Name an effect, or several at once, in words."""
    return " with ".join(map(plain, ids))


def listed(ids: Iterable[str]) -> str:
    """Name effects in words, one after the other."""
    return ", ".join(map(plain, ids))


def effect_sizes_in_words(effect_sizes: Sequence[EffectSize], most: int = 3) -> str:
    """Write amounts with deviation and unit; of too many, those that differ most from zero."""
    if len(effect_sizes) <= most:
        return "; ".join(map(_amount, effect_sizes))
    largest = sorted(effect_sizes, key=lambda one: -abs(one.value) / one.sd if one.sd else 0.0)
    return "; ".join([*map(_amount, largest[:most]), f"{len(effect_sizes) - most} more in gap.json"])


def _amount(effect_size: EffectSize) -> str:
    unit = "" if effect_size.unit == "1" else f" {effect_size.unit}"
    deviation = f" ± {effect_size.sd:.2g}" if math.isfinite(effect_size.sd) else ""
    return f"{plain(effect_size.name)} {effect_size.value:.3g}{deviation}{unit}"


def percent(estimate: Estimate) -> str:
    """Write a share with its 95 % interval: ``48 % [39\N{EN DASH}57]``."""
    return f"{100.0 * estimate.value:.0f} % {_interval(estimate.low, estimate.high)}"


def _interval(low: float, high: float) -> str:
    lower, upper = f"{100.0 * low:.0f}", f"{100.0 * high:.0f}"
    dash = " to " if low < 0.0 else "\N{EN DASH}"
    return f"[{lower}{dash}{upper}]"


def _outcome(result: DiagnosisResult) -> str:
    among = f"the {counted(len(testable(result)), 'effect')} testable with these data"
    probability = {effect.id: effect.probability for effect in result.effects}
    if result.outcome == "named":
        likely = " and ".join(f"{probability.get(id, math.nan):.2f}" for id in result.named)
        label = "probability" if len(result.named) == 1 else "probabilities"
        return f"Best explained, among {among}, by {words(result.named)} ({label} {likely})."
    if result.outcome == "tie":
        groups = "; and by any of ".join(
            ", ".join(f"{plain(id)} ({probability.get(id, math.nan):.2f})" for id in tie)
            for tie in result.ties
        )
        return (
            f"Best explained, among {among}, by any of {groups} (probability in brackets): this recording "
            "cannot tell them apart."
        )
    if result.outcome == "unknown":
        return (
            f"The model leaves something out that none of {among} explains (probability "
            f"{result.unknown_probability:.2f})."
        )
    if result.outcome == "none":
        return (
            "Nothing stands out from what such data show where nothing is amiss (probability "
            f"{result.none_probability:.2f}); {counted(len(testable(result)), 'effect')} could be tested."
        )
    if result.outcome == "insufficient_data":
        return (
            "There are too few gait cycles to tell what repeats from what does not, so nothing is said of "
            "what the model leaves out."
        )
    return (
        "The plain model was not fitted as well as it can be, so part of its error is the fit's and nothing "
        "is said of what the model leaves out."
    )


def _explainable(share: Estimate) -> str:
    if not share.known:
        return f"How much of the moment error a better model could explain cannot be told: {share.reason}."
    return f"{percent(share)} of the moment error (mean square) could be explained by a better model."


def meaning(id: str) -> str:
    """Say of an effect what it means for a person or a recording: ``Emg drift: a channel's gain changes``."""
    return _sentence(f"{plain(id)}: {CATALOGUE[id].meaning}")


def _meanings(result: DiagnosisResult) -> list[str]:
    ids = dict.fromkeys([*result.named, *(id for tie in result.ties for id in tie)])
    return [meaning(id) for id in ids]


def _shrinkage(result: DiagnosisResult) -> list[str]:
    shown = leading(result)
    if not shown:
        return []
    subject = _subject(result, shown)
    places = {
        "held_out_cycles": "on cycles not used to fit it",
        "held_out_speed": "at a speed not used to fit it",
    }
    told = [(text, place) for which, place in places.items() if (text := _range(shrinkage(result, which)))]
    if not told:
        reason = why_no_shrinkage(result, "held_out_cycles")
        return [f"How much of the explainable error {subject} removes cannot be told: {reason}."]
    (effect_size, place), *others = told
    start = f"{subject[:1].upper()}{subject[1:]} removes {effect_size} of the explainable error {place}"
    return [", ".join([start, *(" ".join(other) for other in others)]) + "."]


def _subject(result: DiagnosisResult, shown: Sequence[Alternative]) -> str:
    if result.outcome == "named" and set(shown[0].ids) == set(result.named):
        return "adding it"
    if result.outcome == "tie":
        return "adding any one of them" if len(shown) > 1 else f"adding {words(shown[0].ids)}"
    return f"the best of them, {words(shown[0].ids)},"


def _range(known: Sequence[Estimate]) -> str:
    """Write one share, or the range of several, with the interval that holds all of theirs."""
    if not known:
        return ""
    values = sorted(100.0 * one.value for one in known)
    if len(known) == 1 or f"{values[0]:.0f}" == f"{values[-1]:.0f}":
        middle = f"{values[0]:.0f} %"
    else:
        middle = f"{values[0]:.0f} to {values[-1]:.0f} %"
    return f"{middle} {_interval(min(one.low for one in known), max(one.high for one in known))}"


def _moments(result: DiagnosisResult) -> list[str]:
    """Say where the mean absolute error falls most."""
    errors = mean_absolute_errors(result)
    falls = {name: errors["before"][name] - errors["after"][name] for name in result.coordinates}
    most = max(falls, key=lambda name: falls[name])
    if not falls[most] > 0.0 or not leading(result):
        return []
    which = "" if result.outcome == "named" else f" with {words(leading(result)[0].ids)}"
    return [
        f"Mean absolute error{which} falls most at {most}, from {errors['before'][most]:.1f} to "
        f"{errors['after'][most]:.1f} N m; over all coordinates from {errors['before']['mean']:.1f} to "
        f"{errors['after']['mean']:.1f} N m."
    ]


def _sentence(phrase: str) -> str:
    """Start with a capital and end with a full stop."""
    whole = phrase[:1].upper() + phrase[1:]
    return whole if whole.endswith((".", "!", "?")) else f"{whole}."
