"""How far the error shrinks: which fitted effects an outcome speaks of, and what they leave.

A diagnosis in numbers: the content of ``gap.json``, and its moments as OpenSim tables.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.diagnosis.error_budget import BIN_PERCENT, Budget
from wrapjax.diagnosis.result import (
    Alternative,
    ConvergenceCheck,
    DiagnosisResult,
    EffectFinding,
    Estimate,
)
from wrapjax.evaluation.metrics import moment_errors, pooled_mae
from wrapjax.io.storage import Storage
from wrapjax.report.run_summary import file_stems
from wrapjax.subject.subject import Subject

#: Where shrinkage is told, as fields of `Alternative`.
HELD_OUT = ("held_out_cycles", "held_out_speed")


def leading(result: DiagnosisResult) -> tuple[Alternative, ...]:
    """Give the fitted effects that the outcome speaks of: what it names, all of a tie, else the best one."""
    if result.outcome == "tie":
        members = {id for tie in result.ties for id in tie}
        tied = tuple(one for one in result.alternatives if len(one.ids) == 1 and one.ids[0] in members)
        if tied:
            return tied
    named = tuple(one for one in result.alternatives if set(one.ids) == set(result.named))
    return named[:1] or result.alternatives[:1]


def best(result: DiagnosisResult) -> Alternative | None:
    """Give the first of them: its moments are those of the model after."""
    return next(iter(leading(result)), None)


def shrinkage(result: DiagnosisResult, which: str) -> list[Estimate]:
    """Give the share of the explainable error that each of them removes, those that can be told.

    Parameters
    ----------
    result
        With its alternatives.
    which
        One of `HELD_OUT`.
    """
    return [own for one in leading(result) if (own := getattr(one, which)).known]


def why_no_shrinkage(result: DiagnosisResult, which: str) -> str:
    """Say why it cannot be told of any of them; empty where it can of one."""
    if shrinkage(result, which):
        return ""
    first = best(result)
    return "no effect was fitted" if first is None else getattr(first, which).reason


def mean_absolute_errors(result: DiagnosisResult) -> dict[str, dict[str, float]]:
    """Give mean absolute errors of cycles that no fit has seen, N m, by coordinate and (``mean``) over them.

    Returns
    -------
    dict
        ``before``: of the plain model; ``after``: with the best explanation; ``floor``: what noise alone
        would leave. NaN where it cannot be told.
    """
    after = best(result)
    return {
        "before": _pooled(result, result.plain),
        "after": _unknown(result) if after is None else _pooled(result, after.predicted),
        "floor": _unknown(result) if result.budget is None else _floor(result, result.budget),
    }


def at_speed(speeds: Float[np.ndarray, " cycle"], speed: float) -> Bool[np.ndarray, " cycle"]:
    """Mark the cycles walked at a speed, m/s; NaN stands for those whose speed is not given."""
    return np.isnan(speeds) if math.isnan(speed) else speeds == speed


def speed_label(speed: float) -> str:
    """Say a speed in words."""
    return "speed not given" if math.isnan(speed) else f"{speed:g} m/s"


def _pooled(
    result: DiagnosisResult, predicted: Float[np.ndarray, "cycle coordinate frame"]
) -> dict[str, float]:
    errors = [moment_errors(*pair) for pair in zip(result.measured, predicted, strict=True)]
    return pooled_mae(errors, result.coordinates) or _unknown(result)


def _unknown(result: DiagnosisResult) -> dict[str, float]:
    return dict.fromkeys((*result.coordinates, "mean"), math.nan)


def _floor(result: DiagnosisResult, budget: Budget) -> dict[str, float]:
    """Give the mean absolute value of noise with these mean squares.

    Noise is taken for normal, whose mean absolute value is sqrt(2 / pi) of its deviation. Each bin has its
    own, as noise comes and goes over the gait cycle; where its estimate fell below zero there is none.
    """
    deviation = np.sqrt(np.maximum(budget.noise, 0.0))
    floor = np.sqrt(2.0 / np.pi) * deviation.mean(axis=(0, 2))
    return dict(zip(result.coordinates, floor.tolist(), strict=True)) | {"mean": float(floor.mean())}


#: Version of the layout of ``gap.json``.
SCHEMA = 1

# Frames closer in time than this (s) are one: times in files have so many digits.
_SAME_TIME = 1e-6


def describe_diagnosis(subject: Subject, result: DiagnosisResult) -> dict[str, Any]:
    """Describe a diagnosis as plain numbers and words.

    Returns
    -------
    dict
        The contract's keys; NaN stands for what is written as null. Of ``effects`` the last two are
        ``none`` and ``unknown``, so that probabilities sum to one. Beyond the contract: why things are
        null (``reason``), what was left out on request, parts of the error by coordinate in (N m)^2, all
        effects that were fitted, and how far the plain model can be trusted.
    """
    files = file_stems(tuple(dict.fromkeys(result.recordings)))
    return {
        "schema": SCHEMA,
        "subject": subject.name,
        "outcome": result.outcome,
        "reason": result.reason,
        "named": result.named,
        "ties": result.ties,
        "credible_set": result.credible_set,
        "effects": [
            *map(_effect, result.effects),
            _no_effect("none", result.none_probability),
            _no_effect("unknown", result.unknown_probability),
        ],
        "where": where(result),
        "explainable_share": _estimate(result.explainable_share),
        "shrinkage": _shrinkage(result),
        "mae_Nm": mean_absolute_errors(result),
        "not_testable": [asdict(one) for one in result.not_testable],
        "advice": [asdict(one) for one in result.advice],
        "withheld": result.withheld,
        "trials": {
            name: {"use": use, "speed_m_s": float(speed), "file": files[recording]}
            for name, recording, use, speed in zip(
                result.trials, result.recordings, result.uses, result.speeds, strict=True
            )
        },
        "budget_Nm2": None if result.budget is None else _budget(result, result.budget),
        "alternatives": [_alternative(one) for one in result.alternatives],
        "shares": result.shares,
        "alarm_nats": result.detection_threshold,
        "global_p": result.global_p,
        "certificate": _certificate(result.convergence_check),
        "seconds": result.seconds,
    }


def where(result: DiagnosisResult) -> list[dict[str, Any]]:
    """List every coordinate, bin and speed with its error in N m, what repeats most first.

    Explainable is what repeats: see `repeatable_error_map`. There are no shares of it where there is none.
    """
    budget = result.budget
    if budget is None:
        return []
    whole = float(np.sum(result.map**2))
    shares = result.map**2 / whole if whole > 0.0 else np.full_like(result.map, np.nan)
    rms = root(budget.total)
    rows = []
    for place in np.argsort(-result.map, axis=None, kind="stable"):
        speed, coordinate, number = np.unravel_index(place, shares.shape)
        rows.append(
            {
                "coordinate": result.coordinates[coordinate],
                "phase_percent": [int(number) * BIN_PERCENT, (int(number) + 1) * BIN_PERCENT],
                "speed_m_s": float(result.budget_speeds[speed]),
                "rms_Nm": float(rms.flat[place]),
                "explainable_rms_Nm": float(result.map.flat[place]),
                "share_of_gap": float(shares.flat[place]),
            }
        )
    return rows


def root(mean_squares: Float[np.ndarray, "*axes"]) -> Float[np.ndarray, "*axes"]:
    """Take roots of mean squares; of those below zero, which only chance makes, zero."""
    return np.sqrt(np.maximum(mean_squares, 0.0))


def moment_table(result: DiagnosisResult, recording: str) -> Storage:
    """Give the moments of a recording's cycles in N m.

    ``<coordinate>_moment`` as measured, ``_before`` and ``_after``. What was not predicted (nothing was
    fitted, or not to these cycles) has no column: tables that OpenSim reads hold finite numbers. Where one
    cycle begins as another ends, that frame is the earlier one's.
    """
    cycles = [number for number, name in enumerate(result.recordings) if name == recording]
    cycles.sort(key=lambda number: float(result.time[number, 0]))
    after = best(result)
    curves = {"": result.measured, "_before": result.plain}
    if after is not None:
        curves["_after"] = after.predicted
    kept = {suffix: own for suffix, own in curves.items() if np.isfinite(own[cycles]).all()}
    columns = tuple(f"{name}_moment{suffix}" for suffix in kept for name in result.coordinates)
    time = np.concatenate(result.time[cycles])
    joined = [np.concatenate(list(own[cycles]), axis=-1) for own in kept.values()]
    values = np.concatenate(joined) if joined else np.zeros((0, len(time)))
    ahead = np.maximum.accumulate(np.append(-np.inf, time[:-1]))
    forward = time > ahead + _SAME_TIME
    return Storage(f"joint moments (N m) of {recording}", columns, time[forward], values.T[forward])


def _effect(finding: EffectFinding) -> dict[str, Any]:
    return {
        "id": finding.id,
        "probability": finding.probability,
        "evidence_nats": finding.evidence,
        "detectability": finding.detectability,
        "decision": finding.decision,
        "negative_control": finding.negative_control,
        "parameters": [asdict(effect_size) for effect_size in finding.effect_sizes],
    }


def _no_effect(id: str, probability: float) -> dict[str, Any]:
    """Give a row of what has only a probability, with the keys of all rows."""
    nothing = dict.fromkeys(("evidence_nats", "detectability", "decision"))
    return {"id": id, "probability": probability, **nothing, "negative_control": False, "parameters": []}


def _estimate(estimate: Estimate) -> dict[str, Any]:
    known = estimate.known
    return {
        "estimate": estimate.value if known else None,
        "ci95": [estimate.low, estimate.high] if known else None,
        "reason": estimate.reason or None,
    }


def _shrinkage(result: DiagnosisResult) -> dict[str, Any]:
    """Give the shrinkage of what the outcome speaks of; of a tie, the range over its members."""
    told: dict[str, Any] = {"of": [one.ids for one in leading(result)]}
    for which in HELD_OUT:
        known, reason = shrinkage(result, which), why_no_shrinkage(result, which)
        if not known:
            told[which] = _estimate(Estimate.unknown(reason))
        elif result.outcome == "tie":
            values = [one.value for one in known]
            told[which] = {
                "estimate": [min(values), max(values)],
                "ci95": [min(one.low for one in known), max(one.high for one in known)],
                "reason": None,
            }
        else:
            told[which] = _estimate(known[0])
    # Null where there is no other speed to test on; why is beside it.
    told["held_out_speed_reason"] = why_no_shrinkage(result, "held_out_speed") or None
    if told["held_out_speed_reason"] is not None:
        told["held_out_speed"] = None
    return told


def _budget(result: DiagnosisResult, budget: Budget) -> dict[str, dict[str, float]]:
    pooled = budget.pooled()
    return {
        name: {part: float(values[row]) for part, values in pooled.items()}
        for row, name in enumerate(result.coordinates)
    }


def _alternative(alternative: Alternative) -> dict[str, Any]:
    return {
        "ids": alternative.ids,
        **{which: _estimate(getattr(alternative, which)) for which in HELD_OUT},
        "gains_nats": alternative.gains,
        "speed_conflict": alternative.speed_conflict,
        "released": [asdict(one) for one in alternative.released],
    }


def _certificate(convergence_check: ConvergenceCheck) -> dict[str, Any]:
    return {"holds": convergence_check.holds, **asdict(convergence_check)}
