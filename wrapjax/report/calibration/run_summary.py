"""Numerical summary of a calibration: the content of ``summary.json``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.calibration_result import CalibrationResult, describe_limits
from wrapjax.evaluation.metrics import MomentErrors, errors_by_task, moment_errors, pooled_mae, pooled_rmse
from wrapjax.report.calibration.calibration_curves import describe_drive
from wrapjax.report.calibration.starts import describe_starts
from wrapjax.report.cycle_panels import MomentCurves
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import GAIT, Trials

#: Version of the layout of ``summary.json``.
SCHEMA = 1
USES = ("calibration", "validation")


def summarize(subject: Subject, result: CalibrationResult) -> dict[str, Any]:
    """Summarize a calibration as plain numbers and strings.

    Returns
    -------
    dict
        Guaranteed keys, with moment errors in N m over all frames of the cycles. Further keys: errors before
        calibration, root mean square errors by use, drive of each muscle, hard limits, result of each start,
        cost and its terms, and the file name of each trial.
    """
    errors = errors_of(result.measured, result.modelled)
    before = errors_of(result.measured, result.initial_modelled)
    solution = result.solution
    return {
        "schema": SCHEMA,
        "subject": subject.name,
        "method": result.method,
        "converged": solution.status.converged,
        "message": solution.status.value,
        "iterations": solution.iterations,
        "starts": len(result.outcomes),
        "n_variables": len(solution.variables),
        "n_residuals": result.n_residuals,
        "seconds": {"compile": result.compile_seconds, "solve": result.solve_seconds},
        "max_constraint_violation": solution.max_violation,
        "mae_Nm": by_use(pooled_mae, errors, result),
        "rmse_Nm": by_use(pooled_rmse, errors, result),
        "before": {
            "mae_Nm": by_use(pooled_mae, before, result),
            "rmse_Nm": by_use(pooled_rmse, before, result),
        },
        "trials": by_trial(errors, result),
        **describe_tasks(subject.trials, result.modelled),
        "drive": describe_drive(subject),
        "geometry_change": geometry_change(result),
        "at_bounds": list(result.at_bounds),
        "limits": describe_limits(result),
        "start_costs": describe_starts(result),
        "cost": solution.cost,
        "cost_by_term": dict(result.cost_by_term),
    }


def describe_tasks(
    trials: Trials, modelled: Float[np.ndarray, "trial coordinate frame"]
) -> dict[str, dict[str, Any]]:
    """Describe errors by task, coordinate and use under the key ``tasks``; nothing where all is gait."""
    if trials.is_gait_only:
        return {}
    found: dict[str, Any] = {}
    for use in USES:
        keep = np.array([entry == use for entry in trials.uses])
        for row in errors_by_task(trials.select(keep), modelled[keep]):
            by_use = found.setdefault(row.task, {}).setdefault(row.coordinate, {})
            by_use[use] = {
                "mae_Nm": row.mae,
                "rmse_Nm": row.rmse,
                "r2": row.r2 if np.isfinite(row.r2) else None,
                "seconds": row.seconds,
            }
    return {"tasks": found}


def geometry_change(result: CalibrationResult) -> dict[str, float]:
    """Compute mean absolute changes of path lengths (m) and moment arms (m) over all frames of all cycles.

    Moment arms are averaged over the coordinates that a muscle spans.
    """
    before, after = result.initial_states.path, result.states.path
    arms = np.asarray(before.moment_arm)
    spanned = np.broadcast_to((arms != 0.0).any(axis=(1, 3), keepdims=True), arms.shape)
    return {
        "length_mae_m": float(np.abs(after.length - before.length).mean()),
        "moment_arm_mae_m": float(np.abs(after.moment_arm - before.moment_arm)[spanned].mean()),
    }


def file_stems(trials: Sequence[str]) -> dict[str, str]:
    """Choose the file name of each trial: its name with ``/`` replaced by ``_``.

    If two names become equal (also on file systems that ignore case), the later one gets a number, so that
    no trial's files replace another's.
    """
    stems: dict[str, str] = {}
    taken: set[str] = set()
    for trial in trials:
        plain = stem = trial.replace("/", "_")
        number = 1
        while stem.lower() in taken:
            number += 1
            stem = f"{plain}-{number}"
        taken.add(stem.lower())
        stems[trial] = stem
    return stems


def errors_of(
    measured: Float[np.ndarray, "trial coordinate frame"],
    modelled: Float[np.ndarray, "trial coordinate frame"],
) -> list[MomentErrors]:
    """Compute the errors of modelled moments (N m) of each cycle."""
    return [moment_errors(*pair) for pair in zip(measured, modelled, strict=True)]


def by_trial(errors: list[MomentErrors], cycles: MomentCurves) -> dict[str, dict[str, Any]]:
    """Describe each cycle: its use, errors in N m, and the name of its files."""
    files = file_stems(cycles.trials)
    return {
        trial: {
            "use": use,
            "mae_Nm": pooled_mae([error], cycles.coordinates),
            "rmse_Nm": pooled_rmse([error], cycles.coordinates),
            "file": files[trial],
            **({} if task == GAIT else {"task": task, "recording": recording}),
        }
        for trial, use, error, task, recording in zip(
            cycles.trials, cycles.uses, errors, cycles.tasks, cycles.recordings, strict=True
        )
    }


def by_use(
    pool: Callable[[Sequence[MomentErrors], Sequence[str]], dict[str, float] | None],
    errors: list[MomentErrors],
    cycles: MomentCurves,
) -> dict[str, dict[str, float] | None]:
    """Pool the errors of the cycles of each use; None for a use without cycles."""
    return {
        use: pool(
            [error for error, cycle_use in zip(errors, cycles.uses, strict=True) if cycle_use == use],
            cycles.coordinates,
        )
        for use in USES
    }
