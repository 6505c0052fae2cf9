"""Evidence in the linearized model, or complete diagnosis, of a recording with an added error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import wrapjax
from wrapjax.calibration.calibration import Calibration, cached_calibration
from wrapjax.diagnosis.diagnosis import diagnose_calibrated, diagnosis_input
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.effects.unrecorded_excitation import drive_over_cycle
from wrapjax.diagnosis.joint_fit import fit_jointly, joint_problem
from wrapjax.diagnosis.linearization import LinearizedModel, linearize
from wrapjax.diagnosis.null_covariance import nulls
from wrapjax.diagnosis.score_test import Score, score_each
from wrapjax.subject.subject import Subject

#: Phases of a cycle at which excitation is compared with EMG, and the largest delay in phases.
PHASES, LARGEST_DELAY = 101, 10


def scored(folder: Path, starts: int, beside: Sequence[float]) -> dict[str, Any]:
    """Score every effect of a recording, without refits.

    Parameters
    ----------
    folder
        Subject folder.
    starts
        Starts of its calibration.
    beside
        Variables of another calibration of the same person, used as an additional starting point.

    Returns
    -------
    dict
        Log Bayes factor (nats) of each effect, the cost, and the calibrated variables.
    """
    case = diagnosis_input(_calibrated(wrapjax.load_subject(folder), starts))
    problem = joint_problem(case.problem, Effects(()), case.variables, np.zeros(0), 0.0)
    begun = [case.variables, *([np.array(beside)] if len(beside) else [])]
    fitted = min((fit_jointly(problem, start) for start in begun), key=lambda one: one.cost)
    linearized = linearize(case, fitted.calibrated)
    return {
        "evidence": {one.id: one.evidence for one in _scores(linearized, case.measured_moment_sd)},
        "cost": float(fitted.cost),
        "variables": fitted.calibrated.tolist(),
    }


def diagnosed(folder: Path, starts: int, whole: Path, hidden: str) -> dict[str, Any]:
    """Diagnose a recording; for a hidden electrode, compare the estimated excitation with its EMG.

    Parameters
    ----------
    folder, starts
        As in `scored`.
    whole
        Subject folder with all electrodes.
    hidden
        Removed channel; empty for none.
    """
    subject = wrapjax.load_subject(folder)
    done = diagnose_calibrated(_calibrated(subject, starts))
    found = done.result
    out: dict[str, Any] = {
        "outcome": found.outcome,
        "named": list(found.named),
        "ties": [list(tie) for tie in found.ties],
        "probabilities": {one.id: one.probability for one in found.effects[:5]},
        "drive": None,
    }
    others = done.data.context.undriven_muscles
    if hidden and found.linearized is not None and others is not None:
        measured_moment_sd = done.data.measured_moment_sd
        out["drive"] = _drive(
            found.linearized, measured_moment_sd, others.groups, wrapjax.load_subject(whole), hidden
        )
    return out


def _calibrated(subject: Subject, starts: int) -> Calibration:
    alone = replace(subject, other_leg=None)
    return cached_calibration(alone, "NGA", wrapjax.fit(alone, "engine", processes=1), starts=starts)


def _scores(
    linearized: LinearizedModel, measured_moment_sd: Float[np.ndarray, " coordinate"]
) -> tuple[Score, ...]:
    (found,) = score_each(
        linearized.residual.reshape(1, -1), nulls(linearized, measured_moment_sd), linearized.candidates
    )
    return found.scores


def _drive(
    linearized: LinearizedModel,
    measured_moment_sd: Float[np.ndarray, " coordinate"],
    groups: Sequence[tuple[str, tuple[str, ...]]],
    whole: Subject,
    hidden: str,
) -> dict[str, Any]:
    """Compare the excitation of every group without an electrode with the hidden channel."""
    candidate = next(one for one in linearized.candidates if one.id == "missing_drive")
    channel = whole.trials.channels.index(hidden)
    drove = {
        muscle
        for muscle, own in zip(whole.muscles.names, whole.muscle_channels, strict=True)
        if own == channel
    }
    emg = mean_emg(whole, channel)
    # Score each group separately.
    each = tuple(
        replace(candidate, id=group, variants=(shape,))
        for (group, _), shape in zip(groups, candidate.variants, strict=True)
    )
    found = []
    for (group, members), score in zip(
        groups, _scores(replace(linearized, candidates=each), measured_moment_sd), strict=True
    ):
        drive = np.asarray(drive_over_cycle(jnp.asarray(score.effect_sizes), PHASES))
        found.append(
            {
                "group": group,
                "own": bool(drove & set(members)),
                "evidence": score.evidence,
                **correlations(drive, emg),
            }
        )
    return {"groups": sorted(found, key=lambda one: -one["evidence"])}


def mean_emg(subject: Subject, channel: int) -> Float[np.ndarray, " phase"]:
    """Compute the mean of a channel over calibration cycles at `PHASES` phases."""
    trials = subject.trials
    inside = slice(trials.padding, trials.emg.shape[-1] - trials.padding)
    calibration = [number for number, use in enumerate(trials.uses) if use == "calibration"]
    mean = trials.emg[calibration, channel, inside].mean(axis=0)
    return np.asarray(np.interp(np.linspace(0.0, 1.0, PHASES), np.linspace(0.0, 1.0, mean.size), mean))


def correlations(
    drive: Float[np.ndarray, " phase"], emg: Float[np.ndarray, " phase"]
) -> dict[str, float | None]:
    """Correlate excitation with EMG, undelayed and at the best delay; None for excitation of zero."""
    if np.ptp(drive) == 0.0:
        return {"correlation": None, "correlation_delayed": None}
    # The last phase equals the first of the next cycle.
    found = [
        float(np.corrcoef(drive[:-1], np.roll(emg[:-1], later))[0, 1]) for later in range(LARGEST_DELAY + 1)
    ]
    return {"correlation": found[0], "correlation_delayed": max(found)}
