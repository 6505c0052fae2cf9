"""Numerical results of a diagnosis: the content of ``gap.json``, and moments as OpenSim tables."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.diagnosis.claims.gates import Gates
from wrapjax.diagnosis.effects.catalogue import family_members
from wrapjax.diagnosis.fits.baseline import ConvergenceCheck
from wrapjax.diagnosis.fits.verification import VerifiedRefit
from wrapjax.diagnosis.localization import BIN_PERCENT, ErrorBudget
from wrapjax.diagnosis.null_hypotheses.noise_floor import Estimate
from wrapjax.diagnosis.result import DiagnosisResult, EffectFinding
from wrapjax.evaluation.metrics import moment_errors, pooled_mae
from wrapjax.io.storage import Storage
from wrapjax.report.calibration.run_summary import file_stems
from wrapjax.subject.subject import Subject

#: Kinds of held-out data for which shrinkage is estimated, as fields of `Alternative`.
HELD_OUT = ("held_out_cycles", "held_out_speed")


def reported_refits(result: DiagnosisResult) -> tuple[VerifiedRefit, ...]:
    """List the refitted effects to which the outcome refers: named, all of a tie, otherwise the best one."""
    if result.outcome == "tie":
        members = {id for tie in result.ties for id in tie}
        tied = tuple(refit for refit in result.refits if len(refit.ids) == 1 and refit.ids[0] in members)
        if tied:
            return tied
    named = tuple(refit for refit in result.refits if set(refit.ids) == set(result.named))
    return named[:1] or result.refits[:1]


def first_refit(result: DiagnosisResult) -> VerifiedRefit | None:
    """Select the refitted effect whose moments are reported as ``after``; None if no effect was refitted."""
    return next(iter(reported_refits(result)), None)


def shrinkage(result: DiagnosisResult, which: str) -> list[Estimate]:
    """List the known shares of the explainable error that the reported refits remove.

    Parameters
    ----------
    result
        Result of the diagnosis.
    which
        Kind of held-out data, one of `HELD_OUT`.
    """
    estimates = (getattr(refit, which) for refit in reported_refits(result))
    return [estimate for estimate in estimates if estimate.known]


def why_no_shrinkage(result: DiagnosisResult, which: str) -> str:
    """Write why no reported refit has a known shrinkage; empty if one has."""
    if shrinkage(result, which):
        return ""
    first = first_refit(result)
    return "no effect was fitted" if first is None else getattr(first, which).reason


def mean_absolute_errors(result: DiagnosisResult) -> dict[str, dict[str, float]]:
    """Compute mean absolute errors of held-out cycles, N m, by coordinate and averaged (``mean``).

    Returns
    -------
    dict
        ``before``: plain model; ``after``: with the best explanation; ``floor``: error that noise alone
        would leave. NaN where unknown.
    """
    after = first_refit(result)
    return {
        "before": _pooled(result, result.plain),
        "after": _unknown(result) if after is None else _pooled(result, after.predicted),
        "floor": _unknown(result) if result.budget is None else _floor(result, result.budget),
    }


def at_speed(speeds: Float[np.ndarray, " cycle"], speed: float) -> Bool[np.ndarray, " cycle"]:
    """Mark the cycles at a walking speed, m/s; NaN selects cycles without a given speed."""
    return np.isnan(speeds) if math.isnan(speed) else speeds == speed


def speed_label(speed: float) -> str:
    """Write a walking speed with its unit."""
    return "speed not given" if math.isnan(speed) else f"{speed:g} m/s"


def _pooled(
    result: DiagnosisResult, predicted: Float[np.ndarray, "cycle coordinate frame"]
) -> dict[str, float]:
    errors = [moment_errors(*pair) for pair in zip(result.measured, predicted, strict=True)]
    return pooled_mae(errors, result.coordinates) or _unknown(result)


def _unknown(result: DiagnosisResult) -> dict[str, float]:
    return dict.fromkeys((*result.coordinates, "mean"), math.nan)


def _floor(result: DiagnosisResult, budget: ErrorBudget) -> dict[str, float]:
    """Compute the mean absolute value of the noise from its mean squares.

    Noise is assumed to be normal, with a mean absolute value of sqrt(2 / pi) times its standard deviation.
    The deviation is that of each bin, because noise varies over the gait cycle; zero for negative estimates.
    """
    deviation = np.sqrt(np.maximum(budget.noise, 0.0))
    floor = np.sqrt(2.0 / np.pi) * deviation.mean(axis=(0, 2))
    return dict(zip(result.coordinates, floor.tolist(), strict=True)) | {"mean": float(floor.mean())}


#: Version of the layout of ``gap.json``.
SCHEMA = 2

# Frames closer in time than this (s) are identical, given the digits of times in files.
_SAME_TIME = 1e-6


def describe_diagnosis(subject: Subject, result: DiagnosisResult) -> dict[str, Any]:
    """Describe a diagnosis as plain numbers and strings.

    Returns
    -------
    dict
        Content of ``gap.json``; NaN is written as null. The last two of ``effects`` are ``none`` and
        ``unknown``, so that probabilities sum to one. Besides the guaranteed keys: reasons for null values
        (``reason``), withheld effects, parts of the error by coordinate in (N m)^2, all refitted effects,
        and the convergence check.
    """
    files = file_stems(tuple(dict.fromkeys(result.recordings)))
    return {
        "schema": SCHEMA,
        "subject": subject.name,
        "outcome": result.outcome,
        "reason": result.reason,
        "named": result.named,
        "ties": result.ties,
        "best_partial": result.best_partial,
        "credible_set": result.credible_set,
        "family": _family(result),
        "credible_families": result.credible_families,
        "gates": _gates(result.gates),
        "effects": [
            *map(_effect, result.effects),
            _no_effect("none", result.none_probability),
            _no_effect("unknown", result.unknown_probability),
        ],
        "where": [*error_locations(result), *task_locations(result)],
        "other_tasks": _other_tasks(result),
        "explainable_share": _estimate(result.explainable_share),
        "shrinkage": _shrinkage(result),
        "mae_Nm": mean_absolute_errors(result),
        "not_testable": [asdict(one) for one in result.not_testable],
        "undetectable": [asdict(one) for one in result.undetectable],
        "advice": [asdict(one) for one in result.advice],
        "muscle_law": {"parameters": result.muscle_law, "evidence_nats": result.law_evidence},
        "undriven_capacity": {name: asdict(one) for name, one in result.undriven_capacity.items()},
        "uncertain_joints": None if result.joints is None else asdict(result.joints),
        "withheld": result.withheld,
        "trials": {
            name: {"use": use, "speed_m_s": float(speed), "file": files[recording]}
            for name, recording, use, speed in zip(
                result.trials, result.recordings, result.uses, result.speeds, strict=True
            )
        },
        "budget_Nm2": None if result.budget is None else _budget(result, result.budget),
        "alternatives": list(map(_describe_refit, result.refits)),
        "shares": result.shares,
        "alarm_nats": result.detection_threshold,
        "global_p": result.global_p,
        "certificate": _certificate(result.convergence_check),
        "seconds": result.seconds,
    }


def _family(result: DiagnosisResult) -> dict[str, Any] | None:
    if not result.family:
        return None
    testable = {one.id for one in result.effects}
    return {
        "id": result.family,
        "probability": result.family_probability,
        "members": [id for id in family_members(result.family) if id in testable],
    }


def _gates(gates: Gates | None) -> dict[str, dict[str, Any]]:
    """Describe the gates; values are null for gates that were not examined, as nothing was claimed."""
    described: dict[str, dict[str, Any]] = {
        "adequate": {"passed": None, "left_rms_Nm": None, "floor_rms_Nm": None},
        "plausible": {"passed": None, "worst": None},
        "stable": {"passed": None, "agreement": None},
        "specific": {"passed": None, "shrinkage": None, "sham_shrinkage": None},
    }
    if gates is None:
        return described
    described["adequate"] = {
        "passed": gates.adequate.passed,
        "left_rms_Nm": gates.adequate.left_rms,
        "floor_rms_Nm": gates.adequate.floor_rms,
    }
    if gates.plausible is not None:
        described["plausible"] = {"passed": gates.plausible.passed, "worst": asdict(gates.plausible)}
    if gates.stable is not None:
        described["stable"] = {
            "passed": gates.stable.passed,
            "agreement": gates.stable.agreement,
            "first": dict(gates.stable.first),
        }
    if gates.specific is not None:
        described["specific"] = {
            "passed": gates.specific.passed,
            "shrinkage": gates.specific.shrinkage,
            "sham_shrinkage": gates.specific.sham_shrinkage,
        }
    return described


def error_locations(result: DiagnosisResult) -> list[dict[str, Any]]:
    """List every coordinate, phase bin and speed with its error in N m, largest repeatable error first.

    Explainable error is repeatable error (see `repeatable_error_map`). Its shares are NaN if it is zero.
    """
    budget = result.budget
    if budget is None:
        return []
    total = float(np.sum(result.error_map**2))
    shares = result.error_map**2 / total if total > 0.0 else np.full_like(result.error_map, np.nan)
    rms = np.sqrt(np.maximum(budget.total, 0.0))  # estimates of mean squares can be below zero by chance
    rows = []
    for place in np.argsort(-result.error_map, axis=None, kind="stable"):
        speed, coordinate, number = np.unravel_index(place, shares.shape)
        rows.append(
            {
                "coordinate": result.coordinates[coordinate],
                "phase_percent": [int(number) * BIN_PERCENT, (int(number) + 1) * BIN_PERCENT],
                "speed_m_s": float(result.budget_speeds[speed]),
                "rms_Nm": float(rms.flat[place]),
                "explainable_rms_Nm": float(result.error_map.flat[place]),
                "share_of_gap": float(shares.flat[place]),
            }
        )
    return rows


def task_locations(result: DiagnosisResult) -> list[dict[str, Any]]:
    """List the worst window of each recording of another task by joint angle and time, largest error first.

    The parts of its error are unknown, as the movement was recorded once.
    """
    errors = () if result.task_evidence is None else result.task_evidence.errors
    return [
        {
            "coordinate": one.coordinate,
            "recording": one.recording,
            "task": one.task,
            "angle_deg": list(one.angle),
            "time_s": list(one.time),
            "speed_m_s": None,
            "rms_Nm": one.worst_rms,
            "explainable_rms_Nm": None,
            "share_of_gap": None,
        }
        for one in sorted(errors, key=lambda one: -one.worst_rms)
    ]


def _other_tasks(result: DiagnosisResult) -> dict[str, Any] | None:
    """Describe what tasks other than gait added to the evidence; null if there are none."""
    found = result.task_evidence
    if found is None:
        return None
    return {
        "added_nats": found.added,
        "error_by_angle": found.error_by_angle,
        "errors": [
            {
                "recording": one.recording,
                "task": one.task,
                "coordinate": one.coordinate,
                "windows": one.windows,
                "rms_Nm": one.rms,
            }
            for one in found.errors
        ],
        "not_used": dict(found.not_used),
    }


def moment_table(result: DiagnosisResult, recording: str) -> Storage:
    """Tabulate the moments of a recording's cycles in N m.

    ``<coordinate>_moment`` is measured, ``_before`` and ``_after`` are predicted. Moments that were not
    predicted (no fit, or not of these cycles) have no column, because OpenSim reads only finite numbers. A
    frame that two adjacent cycles share is that of the earlier cycle.
    """
    cycles = [number for number, name in enumerate(result.recordings) if name == recording]
    cycles.sort(key=lambda number: float(result.time[number, 0]))
    after = first_refit(result)
    curves = {"": result.measured, "_before": result.plain}
    if after is not None:
        curves["_after"] = after.predicted
    finite = {suffix: curve for suffix, curve in curves.items() if np.isfinite(curve[cycles]).all()}
    columns = tuple(f"{name}_moment{suffix}" for suffix in finite for name in result.coordinates)
    time = np.concatenate(result.time[cycles])
    joined = [np.concatenate(list(curve[cycles]), axis=-1) for curve in finite.values()]
    values = np.concatenate(joined) if joined else np.zeros((0, len(time)))
    latest = np.maximum.accumulate(np.append(-np.inf, time[:-1]))
    forward = time > latest + _SAME_TIME
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
    """Describe a hypothesis that has only a probability, with the keys of all effects."""
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
    """Describe the shrinkage by the reported refits; for a tie, the range over its members."""
    described: dict[str, Any] = {"of": [refit.ids for refit in reported_refits(result)]}
    for which in HELD_OUT:
        known, reason = shrinkage(result, which), why_no_shrinkage(result, which)
        if not known:
            described[which] = _estimate(Estimate.unknown(reason))
        elif result.outcome == "tie":
            values = [estimate.value for estimate in known]
            described[which] = {
                "estimate": [min(values), max(values)],
                "ci95": [
                    min(estimate.low for estimate in known),
                    max(estimate.high for estimate in known),
                ],
                "reason": None,
            }
        else:
            described[which] = _estimate(known[0])
    # Null if there is no other speed to test on; the reason is in the preceding key.
    described["held_out_speed_reason"] = why_no_shrinkage(result, "held_out_speed") or None
    if described["held_out_speed_reason"] is not None:
        described["held_out_speed"] = None
    return described


def _budget(result: DiagnosisResult, budget: ErrorBudget) -> dict[str, dict[str, float]]:
    pooled = budget.pooled()
    return {
        name: {part: float(values[row]) for part, values in pooled.items()}
        for row, name in enumerate(result.coordinates)
    }


def _describe_refit(refit: VerifiedRefit) -> dict[str, Any]:
    return {
        "ids": refit.ids,
        **{which: _estimate(getattr(refit, which)) for which in HELD_OUT},
        "gains_nats": refit.gains,
        "speed_conflict": refit.speed_conflict,
        "released": [asdict(one) for one in refit.released],
    }


def _certificate(convergence_check: ConvergenceCheck) -> dict[str, Any]:
    return {"holds": convergence_check.holds, **asdict(convergence_check)}
