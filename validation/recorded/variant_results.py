"""A recording with something amiss: evidence along straight lines, or a whole diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from wrapjax.diagnosis.effects.drive import drive_over_cycle

import wrapjax
from wrapjax.calibration.calibration import Calibration, cached_calibration
from wrapjax.diagnosis.diagnosis import diagnose_calibrated, diagnosis_input
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.pipeline import linearize_effects
from wrapjax.diagnosis.refit import fit_jointly, joint_problem
from wrapjax.diagnosis.score import Score, score_each
from wrapjax.subject.subject import Subject

#: Phases of a cycle in which drives are compared, and by how many of them activation may be later than EMG.
PHASES, LATEST = 101, 10


def scored(folder: Path, starts: int, beside: Sequence[float]) -> dict[str, Any]:
    """Score every effect of a recording, without refits.

    Parameters
    ----------
    folder
        Of the subject.
    starts
        Of its calibration.
    beside
        Variables where another calibration of the same person ended, from where to start as well.

    Returns
    -------
    dict
        Evidence in nats by effect, the cost, and the variables where the calibration ended.
    """
    case = diagnosis_input(_calibrated(wrapjax.load_subject(folder), starts))
    problem = joint_problem(case.problem, Effects(()), case.variables, np.zeros(0), 0.0)
    begun = [case.variables, *([np.array(beside)] if len(beside) else [])]
    fitted = min((fit_jointly(problem, start) for start in begun), key=lambda one: one.cost)
    _, _, gap = linearize_effects(case, fitted.calibrated)
    return {
        "evidence": {one.id: one.evidence for one in _scores(gap, case.measured_sizes)},
        "cost": float(fitted.cost),
        "variables": fitted.calibrated.tolist(),
    }


def diagnosed(folder: Path, starts: int, whole: Path, hidden: str) -> dict[str, Any]:
    """Diagnose a recording; where an electrode was hidden, compare the drive that is found with it.

    Parameters
    ----------
    folder, starts
        As of `scored`.
    whole
        Folder of the subject with all electrodes.
    hidden
        The channel that was taken away; empty where none was.
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
    others = done.case.context.undriven_muscles
    if hidden and found.lines is not None and others is not None:
        sizes = done.case.measured_sizes
        out["drive"] = _drive(found.lines, sizes, others.groups, wrapjax.load_subject(whole), hidden)
    return out


def _calibrated(subject: Subject, starts: int) -> Calibration:
    alone = replace(subject, other_leg=None)
    return cached_calibration(alone, "NGA", wrapjax.fit(alone, "engine", processes=1), starts=starts)


def _scores(gap: LinearizedModel, sizes: Float[np.ndarray, " coordinate"]) -> tuple[Score, ...]:
    (found,) = score_each(gap.residual.reshape(1, -1), nulls(gap, sizes), gap.candidates)
    return found.scores


def _drive(
    gap: LinearizedModel,
    sizes: Float[np.ndarray, " coordinate"],
    groups: Sequence[tuple[str, tuple[str, ...]]],
    whole: Subject,
    hidden: str,
) -> dict[str, Any]:
    """Compare the drive of every group without an electrode with the hidden channel, the likeliest first."""
    candidate = next(one for one in gap.candidates if one.id == "missing_drive")
    channel = whole.trials.channels.index(hidden)
    drove = {
        muscle
        for muscle, own in zip(whole.muscles.names, whole.muscle_channels, strict=True)
        if own == channel
    }
    emg = heard(whole, channel)
    # Each group for itself, as if it were the only one.
    each = tuple(
        replace(candidate, id=group, variants=(shape,))
        for (group, _), shape in zip(groups, candidate.variants, strict=True)
    )
    found = []
    for (group, members), score in zip(groups, _scores(replace(gap, candidates=each), sizes), strict=True):
        drive = np.asarray(drive_over_cycle(jnp.asarray(score.effect_sizes), PHASES))
        found.append(
            {
                "group": group,
                "own": bool(drove & set(members)),
                "evidence": score.evidence,
                **likeness(drive, emg),
            }
        )
    return {"groups": sorted(found, key=lambda one: -one["evidence"])}


def heard(subject: Subject, channel: int) -> Float[np.ndarray, " phase"]:
    """Mean of a channel over calibration cycles, at the phases that drives are compared in."""
    trials = subject.trials
    inside = slice(trials.padding, trials.emg.shape[-1] - trials.padding)
    seen = [number for number, use in enumerate(trials.uses) if use == "calibration"]
    mean = trials.emg[seen, channel, inside].mean(axis=0)
    return np.asarray(np.interp(np.linspace(0.0, 1.0, PHASES), np.linspace(0.0, 1.0, mean.size), mean))


def likeness(drive: Float[np.ndarray, " phase"], emg: Float[np.ndarray, " phase"]) -> dict[str, float | None]:
    """Correlate a drive with EMG, as it is and at the delay that suits it best; None for a drive of zero."""
    if np.ptp(drive) == 0.0:
        return {"correlation": None, "correlation_delayed": None}
    # The last phase is the first of the next cycle.
    found = [float(np.corrcoef(drive[:-1], np.roll(emg[:-1], later))[0, 1]) for later in range(LATEST + 1)]
    return {"correlation": found[0], "correlation_delayed": max(found)}
