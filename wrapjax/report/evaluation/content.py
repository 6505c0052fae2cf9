"""Predicted cycles, and their errors in numbers: the content of ``evaluation.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.evaluate import pooled_mae
from wrapjax.report.summary import by_trial, by_use, errors_of, pooled_rmse
from wrapjax.subject import Subject, Trials

#: Version of the layout of ``evaluation.json``.
SCHEMA = 1


@dataclass(frozen=True)
class PredictedCycles:
    """Measured and modelled joint moments of gait cycles (`wrapjax.report.cycles.MomentCurves`).

    Parameters
    ----------
    coordinates, trials, uses
        Names along the axes, and what each cycle is for.
    speeds
        m/s, NaN where unknown.
    time
        s.
    measured, modelled
        N m.
    """

    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " trial"]
    time: Float[np.ndarray, "trial frame"]
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]


def predicted_cycles(
    trials: Trials, modelled: Float[np.ndarray, "trial coordinate frame"]
) -> PredictedCycles:
    """Put a subject's cycles beside what was predicted of them (N m)."""
    return PredictedCycles(
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        uses=trials.uses,
        speeds=trials.speeds,
        time=trials.time,
        measured=trials.moments,
        modelled=modelled,
    )


def describe_evaluation(
    run_summary: dict[str, Any],
    subject: Subject,
    modelled: Float[np.ndarray, "trial coordinate frame"],
    notes: Sequence[str],
) -> dict[str, Any]:
    """Describe an evaluation as plain numbers and words.

    Returns
    -------
    dict
        ``mae_Nm``, ``rmse_Nm`` and ``trials`` as in ``summary.json`` (N m, all frames of the cycles), the
        run's own errors beside them, speeds, and notes.
    """
    cycles = predicted_cycles(subject.trials, modelled)
    errors = errors_of(cycles.measured, cycles.modelled)
    speeds = dict(zip(cycles.trials, cycles.speeds.tolist(), strict=True))
    return {
        "schema": SCHEMA,
        "subject": subject.name,
        "coordinates": cycles.coordinates,
        "run": {
            "subject": run_summary["subject"],
            "method": run_summary["method"],
            "mae_Nm": run_summary["mae_Nm"],
            "rmse_Nm": run_summary["rmse_Nm"],
        },
        "mae_Nm": by_use(pooled_mae, errors, cycles),
        "rmse_Nm": by_use(pooled_rmse, errors, cycles),
        "trials": {name: own | {"speed_m_s": speeds[name]} for name, own in by_trial(errors, cycles).items()},
        "notes": list(notes),
    }
