"""Findings of a diagnosis in words: what explains the error best, and not what caused it."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Sequence

from wrapjax.diagnosis.effects.catalogue import CATALOGUE, family_members
from wrapjax.diagnosis.effects.effect import FAMILIES
from wrapjax.diagnosis.fits.verification import VerifiedRefit
from wrapjax.diagnosis.null_hypotheses.noise_floor import Estimate
from wrapjax.diagnosis.result import DiagnosisResult, EffectFinding, EffectSize
from wrapjax.report.diagnosis.numbers import (
    mean_absolute_errors,
    reported_refits,
    shrinkage,
    why_no_shrinkage,
)
from wrapjax.report.formatting import counted, readable

#: Probability below which an effect is not shown as an explanation.
LEAST_SHOWN = 0.005
#: Evidence (nats) from which what other tasks add is told.
LEAST_ADDED = 1.0
# Why errors differ from those of a calibration.
_OWN_LAW = (
    "The model has the person's own muscle law, which a diagnosis fits, so that a calibration with a given "
    "law has other errors."
)
#: Outcomes without a conclusion on effects.
INCONCLUSIVE = ("insufficient_data", "not_converged")
# Width of the text, and number of effects that it lists.
_WIDTH, _MOST_EFFECTS = 100, 6


def diagnosis_findings(result: DiagnosisResult) -> list[str]:
    """Write the findings of a diagnosis as sentences.

    The first states the explainable share of the error and the outcome.
    """
    # For the other outcomes, the reason repeats the statement of the outcome.
    needed = result.reason and result.outcome in (*INCONCLUSIVE, "unknown", "family")
    reason = [_sentence(with_readable_effects(result.reason))] if needed else []
    if result.outcome in INCONCLUSIVE:
        return [_outcome_finding(result), *reason]
    first = f"{_explainable_finding(result.explainable_share)} {_outcome_finding(result)}"
    sentences = [first, *reason, *_meanings(result), *_without_electrodes(result)]
    sentences += [
        *_shrinkage_findings(result),
        *_error_findings(result),
        *_other_tasks_findings(result),
    ]
    if false_positives := positive_controls(result):
        names = effect_list(effect.id for effect in false_positives)
        sentences.append(
            f"These findings are unreliable: the evidence for {names}, which cannot be present in such a "
            "recording (negative control), exceeds the detection threshold."
        )
    return sentences


def untested_findings(result: DiagnosisResult) -> list[str]:
    """Write sentences on the effects that the diagnosis could not test or did not include."""
    sentences = []
    for lacking, effects in (
        ("Not testable, as the subject or the recording lacks something", result.not_testable),
        ("Not detectable with this recording at the usual size", result.undetectable),
    ):
        if effects:
            sentences.append(f"{lacking}: {effect_list(effect.id for effect in effects)}.")
    if result.withheld:
        sentences.append(
            f"Withheld on request: {effect_list(result.withheld)}. If the model lacks a withheld effect, the "
            "diagnosis cannot name it."
        )
    return sentences


def shown_effects(result: DiagnosisResult) -> list[EffectFinding]:
    """List the effects that are shown with a probability: testable ones, unless they are improbable.

    Effects that are named are always among them.
    """
    claimed = {*result.named, *(id for tie in result.ties for id in tie)}
    possible = {effect.id for effect in testable(result)}
    return [
        effect
        for effect in result.effects
        if effect.id in claimed or (effect.id in possible and effect.probability >= LEAST_SHOWN)
    ]


def gate_rows(result: DiagnosisResult) -> list[tuple[str, str, str, str]]:
    """Write each examined gate as a row: its name, the question, its figure, and whether it is passed."""
    gates = result.gates
    if gates is None:
        return []
    claim = "with the claimed effects" if gates.of_claim else "by the plain model"
    adequate = gates.adequate
    rows = [
        (
            "adequate",
            f"Is the repeatable error left {claim} within that of models with nothing else amiss, or within "
            "the accuracy of joint moments?",
            f"{adequate.left_rms:.2f} N m left; up to {adequate.floor_rms:.2f} N m allowed",
            adequate.passed,
        )
    ]
    if gates.plausible is not None:
        size = gates.plausible
        rows.append(
            (
                "plausible",
                "Are all effect sizes within their published ranges and three standard deviations?",
                f"{readable(size.name.replace(' ', ': ', 1))} {size.value:.3g}; limit {size.limit:.3g}"
                + ("" if size.unit == "1" else f" {size.unit}"),
                size.passed,
            )
        )
    if gates.stable is not None:
        rows.append(
            (
                "stable",
                "Do parts of the recording put the same effect first?",
                f"{100.0 * gates.stable.agreement:.0f} % of {counted(len(gates.stable.first), 'part')}",
                gates.stable.passed,
            )
        )
    if gates.specific is not None:
        specific = gates.specific
        rows.append(
            (
                "specific",
                "Does it shrink the error on unseen cycles more than sham effects do?",
                f"{100.0 * specific.shrinkage:.0f} %; 95 % of sham effects less than "
                f"{100.0 * specific.sham_shrinkage:.0f} %",
                specific.passed,
            )
        )
    return [(*row[:3], "passed" if row[3] else "failed") for row in rows]


def testable(result: DiagnosisResult) -> list[EffectFinding]:
    """List the effects that this recording would show if they were present."""
    undetectable = {effect.id for effect in result.undetectable}
    return [effect for effect in result.effects if effect.id not in undetectable]


def positive_controls(result: DiagnosisResult) -> list[EffectFinding]:
    """List the negative controls whose evidence exceeds the detection threshold (false positives)."""
    return [
        effect
        for effect in result.effects
        if effect.negative_control and effect.evidence > result.detection_threshold
    ]


def effect_names(ids: Sequence[str]) -> str:
    """Write the name of an effect, or of several that act together."""
    return " with ".join(map(readable, ids))


def effect_list(ids: Iterable[str]) -> str:
    """Write the names of effects as a list."""
    return ", ".join(map(readable, ids))


def with_readable_effects(text: str) -> str:
    """Write the names of all effects in a text without underscores."""
    for id in CATALOGUE:
        text = re.sub(rf"\b{id}\b", readable(id), text)
    return text


def effect_sizes_in_words(effect_sizes: Sequence[EffectSize], most: int = 3) -> str:
    """Write effect sizes with standard deviation and unit; of many, those with the largest size over it."""
    if len(effect_sizes) <= most:
        return "; ".join(map(_effect_size, effect_sizes))
    largest = sorted(effect_sizes, key=lambda size: -abs(size.value) / size.sd if size.sd else 0.0)
    return "; ".join([*map(_effect_size, largest[:most]), f"{len(effect_sizes) - most} more in gap.json"])


def _effect_size(effect_size: EffectSize) -> str:
    unit = "" if effect_size.unit == "1" else f" {effect_size.unit}"
    deviation = f" ± {effect_size.sd:.2g}" if math.isfinite(effect_size.sd) else ""
    return f"{readable(effect_size.name)} {effect_size.value:.3g}{deviation}{unit}"


def share_with_interval(estimate: Estimate) -> str:
    """Write a share with its 95 % interval: ``48 % [39\N{EN DASH}57]``."""
    return f"{100.0 * estimate.value:.0f} % {_percent_interval(estimate.low, estimate.high)}"


def _percent_interval(low: float, high: float) -> str:
    lower, upper = f"{100.0 * low:.0f}", f"{100.0 * high:.0f}"
    separator = " to " if low < 0.0 else "\N{EN DASH}"
    return f"[{lower}{separator}{upper}]"


def _outcome_finding(result: DiagnosisResult) -> str:
    among = f"the {counted(len(testable(result)), 'effect')} testable with these data"
    probability = {effect.id: effect.probability for effect in result.effects}
    if result.outcome == "named":
        likely = " and ".join(f"{probability.get(id, math.nan):.2f}" for id in result.named)
        label = "probability" if len(result.named) == 1 else "probabilities"
        return (
            f"The error is best explained, among {among}, by {effect_names(result.named)} ({label} {likely})."
        )
    if result.outcome == "tie":
        groups = "; and by any of ".join(
            ", ".join(f"{readable(id)} ({probability.get(id, math.nan):.2f})" for id in tie)
            for tie in result.ties
        )
        return (
            f"The error is best explained, among {among}, by any of {groups} (probability in brackets): this "
            "recording cannot distinguish these effects."
        )
    if result.outcome == "family":
        known = family_members(result.family)
        members = effect_list(effect.id for effect in result.effects if effect.id in known)
        return (
            f"The error is best explained, among {among}, by an effect of one family: "
            f"{FAMILIES[result.family]} (probability {result.family_probability:.2f}). Which of {members} it "
            "is, is not decided."
        )
    if result.outcome == "unknown":
        part = effect_names(result.best_partial)
        partly = f" {part[:1].upper()}{part[1:]} explains a part of it." if part else ""
        return f"Not decided (unknown): none of {among} explains the error well enough to be named.{partly}"
    if result.outcome == "none":
        return (
            "The error does not exceed that expected without any effect (probability of no effect "
            f"{result.none_probability:.2f}); {counted(len(testable(result)), 'effect')} could be tested."
        )
    if result.outcome == "insufficient_data":
        return (
            "There are too few gait cycles to separate repeatable error from noise, so there is no "
            "conclusion on missing effects."
        )
    return (
        "The calibration of the plain model did not converge, so part of its error may be due to the fit and "
        "there is no conclusion on missing effects."
    )


def _explainable_finding(share: Estimate) -> str:
    if not share.known:
        return f"The share of the moment error that a better model could explain is unknown: {share.reason}."
    return f"A better model could explain {share_with_interval(share)} of the moment error (mean square)."


def effect_meaning(id: str) -> str:
    """Write what an effect means for the subject or recording: ``Emg drift: a channel's gain changes``."""
    return _sentence(f"{readable(id)}: {CATALOGUE[id].meaning}")


def _meanings(result: DiagnosisResult) -> list[str]:
    ids = dict.fromkeys([*result.named, *(id for tie in result.ties for id in tie)])
    return [effect_meaning(id) for id in ids]


def _without_electrodes(result: DiagnosisResult) -> list[str]:
    """Write at which coordinates muscles without EMG have most of the capacity."""
    shares = {
        name: share.both for name, share in result.undriven_capacity.items() if not share.has_emg_for_most
    }
    if not shares:
        return []
    listed = ", ".join(f"{100.0 * share:.0f} % at {name}" for name, share in shares.items())
    return [
        f"Muscles without EMG have most of the moment capacity ({listed}): the error there says little about "
        "other effects."
    ]


def _other_tasks_findings(result: DiagnosisResult) -> list[str]:
    """Write which effect tasks other than gait speak for most, and which against."""
    found = result.task_evidence
    if found is None or not found.added:
        return []
    names = ", ".join(dict.fromkeys(one.recording for one in found.errors))
    least, most = (choose(found.added, key=lambda id: found.added[id]) for choose in (min, max))
    told = [
        f"{abs(found.added[id]):.1f} nats {word} {readable(id)}"
        for id, word in ((most, "for"), (least, "against"))
        if (found.added[id] >= LEAST_ADDED if word == "for" else found.added[id] <= -LEAST_ADDED)
    ]
    return [f"Trials of other tasks ({names}) add {' and '.join(told) or 'no evidence to that of gait'}."]


def _shrinkage_findings(result: DiagnosisResult) -> list[str]:
    refits = reported_refits(result)
    if not refits:
        return []
    subject = _grammatical_subject(result, refits)
    data = {
        "held_out_cycles": "on held-out cycles",
        "held_out_speed": "at a held-out speed",
    }
    known = [
        (text, where) for which, where in data.items() if (text := _share_range(shrinkage(result, which)))
    ]
    if not known:
        reason = why_no_shrinkage(result, "held_out_cycles")
        return [f"The share of the explainable error that {subject} removes is unknown: {reason}."]
    (share, where), *others = known
    start = f"{subject[:1].upper()}{subject[1:]} removes {share} of the explainable error {where}"
    return [" and ".join([start, *(" ".join(other) for other in others)]) + "."]


def _grammatical_subject(result: DiagnosisResult, refits: Sequence[VerifiedRefit]) -> str:
    if result.outcome == "named" and set(refits[0].ids) == set(result.named):
        return "adding it" if len(result.named) == 1 else "adding them"
    if result.outcome == "tie":
        return "adding any one of them" if len(refits) > 1 else f"adding {effect_names(refits[0].ids)}"
    return f"the best of the refitted effects, {effect_names(refits[0].ids)},"


def _share_range(estimates: Sequence[Estimate]) -> str:
    """Write one share, or the range of several, with the interval that includes all of their intervals."""
    if not estimates:
        return ""
    values = sorted(100.0 * estimate.value for estimate in estimates)
    if len(estimates) == 1 or f"{values[0]:.0f}" == f"{values[-1]:.0f}":
        share = f"{values[0]:.0f} %"
    else:
        share = f"{values[0]:.0f} to {values[-1]:.0f} %"
    low, high = min(estimate.low for estimate in estimates), max(estimate.high for estimate in estimates)
    return f"{share} {_percent_interval(low, high)}"


def _error_findings(result: DiagnosisResult) -> list[str]:
    """Write at which coordinate the mean absolute error decreases most, if it does so on average."""
    errors = mean_absolute_errors(result)
    decreases = {name: errors["before"][name] - errors["after"][name] for name in result.coordinates}
    most = max(decreases, key=lambda name: decreases[name])
    if not errors["after"]["mean"] < errors["before"]["mean"] or not reported_refits(result):
        return []
    effect = "" if result.outcome == "named" else f" with {effect_names(reported_refits(result)[0].ids)}"
    return [
        f"The mean absolute error{effect} decreases most at {most}, from {errors['before'][most]:.1f} to "
        f"{errors['after'][most]:.1f} N m, and averaged over all coordinates from "
        f"{errors['before']['mean']:.1f} to {errors['after']['mean']:.1f} N m."
    ]


def _sentence(phrase: str) -> str:
    """Capitalize a phrase and end it with a full stop."""
    sentence = phrase[:1].upper() + phrase[1:]
    return sentence if sentence.endswith((".", "!", "?")) else f"{sentence}."


def diagnosis_text(result: DiagnosisResult) -> str:
    """Write what the command prints: outcome, most probable effects, errors, advice, untestable effects."""
    lines = [textwrap.fill(sentence, _WIDTH) for sentence in diagnosis_findings(result)]
    if rows := gate_rows(result):
        lines += ["", *(f"{name:10s}{passed:8s}{figure}" for name, _, figure, passed in rows)]
    if result.effects:
        lines += ["", *_effect_lines(result)]
    if result.budget is not None:
        lines += ["", *_error_lines(result)]
    if result.advice:
        lines += ["", "Recordings that would tell more"]
        lines += [
            textwrap.fill(
                f"{advice.experiment} ({advice.minutes} min): "
                f"{', '.join(advice.splits) or 'more of each effect'}",
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
    from wrapjax.report.diagnosis.numbers import mean_absolute_errors

    errors = mean_absolute_errors(result)
    columns = [model for model, values in errors.items() if math.isfinite(values["mean"])]
    width = max(len(name) for name in (*result.coordinates, "coordinate"))
    lines = [
        "Mean absolute error of the joint moments on held-out cycles, N m; floor: noise alone",
        f"{'coordinate':{width}s}" + "".join(f"{model:>10s}" for model in columns),
    ]
    for name in (*result.coordinates, "mean"):
        lines.append(f"{name:{width}s}" + "".join(f"{errors[model][name]:10.2f}" for model in columns))
    return [*lines, textwrap.fill(_OWN_LAW, _WIDTH)]
