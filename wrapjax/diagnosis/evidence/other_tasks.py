"""Evidence of recorded tasks other than gait for each effect, given that of gait.

A joint that is moved at rest, or held against a dynamometer, shows what walking does not: effects that are
alike in walking differ there. The plain model and the effects are linearised over the gait cycles and over
windows of these tasks together, about the fit to gait. The logarithm of the Bayes factor of an effect over
all rows, less the same over the rows of gait, is what the other tasks add; it is averaged over the unknown
sizes of errors. What walking leaves open shows at other angles and efforts in everybody: a usual amount of
each effect, and errors of the model that follow the joint angle, are part of every null of these tasks.

Moments of passive, isometric and isokinetic trials are those of a device: what errors of force plates,
markers or body masses change in gait changes nothing in them. Moments of other movements (squats, stairs,
running) come from inverse dynamics, as those of gait do, and change with the same errors: what these change
is computed from the movement's own motion and forces.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from wrapjax.calibration.calibration import Calibration
from wrapjax.diagnosis.effects.catalogue import available_effects, catalogue
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel, linearized_model
from wrapjax.diagnosis.evidence.score import COMPARED, Scores
from wrapjax.diagnosis.evidence.score_test import Projection, Score, distinguishability, score_projected
from wrapjax.diagnosis.evidence.task_covariance import (
    ERRORS_BY_ANGLE,
    ErrorSizes,
    LinearizedTasks,
    TaskCovariance,
)
from wrapjax.diagnosis.inputs.context import ChangesOfCycles, Context, with_changes
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames, speed_numbers
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.diagnosis.inputs.subject_context import build_context, changes_by_inverse_dynamics
from wrapjax.diagnosis.null_hypotheses.error_sources import Matrix
from wrapjax.diagnosis.null_hypotheses.null_covariance import (
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    FORCE_ERRORS,
    REPEATABLE_ERRORS,
)
from wrapjax.model.forward import Recording, joint_moments
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import GAIT, MOVEMENT, Trials

#: Largest number of windows of 1 s that are used, spread evenly over the recordings and over each of them.
MOST_WINDOWS = 24
# Nulls less plausible than the most plausible one by this many nats do not change the result and are omitted.
_NEGLIGIBLE = 6.0


@dataclass(frozen=True)
class OtherTasks:
    """Gait cycles and windows of other tasks, in that order, as inputs of the forward model.

    Parameters
    ----------
    recording, context
        Inputs of the forward model, and context of the effects.
    measured
        Measured moments, N m; NaN where none was measured or a frame does not count.
    tasks, recordings
        Task and recording of each cycle and window.
    time
        Time of each frame, s.
    not_used
        Recordings of other tasks that are not used, and why.
    """

    recording: Recording
    context: Context
    measured: Float[np.ndarray, "cycle coordinate frame"]
    tasks: tuple[str, ...]
    recordings: tuple[str, ...]
    time: Float[np.ndarray, "cycle frame"]
    not_used: Mapping[str, str]


@dataclass(frozen=True)
class TaskError:
    """Error of the model that was fitted to gait, in one recording of another task.

    Parameters
    ----------
    recording, task, coordinate
        Names of the recording, its task, and the coordinate whose moment was measured.
    windows
        Number of windows of 1 s that were used.
    rms
        Root mean square of measured less predicted moments, N m.
    worst_rms, angle, time
        That of the worst window, with its range of the coordinate (degrees) and of time (s).
    """

    recording: str
    task: str
    coordinate: str
    windows: int
    rms: float
    worst_rms: float
    angle: tuple[float, float]
    time: tuple[float, float]


@dataclass(frozen=True)
class TaskEvidence:
    """What tasks other than gait add.

    Parameters
    ----------
    added
        Evidence (nats) that they add to that of gait, by effect.
    detectability
        Detectability of each effect by gait and these tasks.
    errors
        Error in each recording and measured coordinate.
    error_by_angle
        Most plausible size of errors by joint angle, relative to the moments; see `ErrorSizes`.
    not_used
        See `OtherTasks`.
    """

    added: Mapping[str, float]
    detectability: Mapping[str, float]
    errors: tuple[TaskError, ...]
    error_by_angle: float
    not_used: Mapping[str, str]


def other_tasks(calibration: Calibration, data: DiagnosisInput, subject: Subject) -> OtherTasks | None:
    """Collect the gait cycles for calibration and the windows of other tasks; None if there are none.

    Parameters
    ----------
    calibration
        Calibration of one leg to its gait.
    data
        Input of the diagnosis of the gait.
    subject
        The same leg with all its tasks.
    """
    trials, one_leg = subject.trials, replace(subject, other_leg=None)
    # The gait gives the unit of errors in the inputs of other movements.
    gait = read_recorded_movement(calibration.subject)[0] if MOVEMENT in trials.tasks else None
    not_used = _not_used(subject, forces_needed=gait is not None)
    windows = chosen_windows(trials, set(trials.recordings) - set(not_used))
    moving = windows[np.array([trials.tasks[place] == MOVEMENT for place in windows], dtype=bool)]
    movement = None
    if gait is not None and len(moving):
        leg = _with_trials(one_leg, moving)
        movement, reason = read_recorded_movement(leg, gait)
        if movement is None:
            not_used |= dict.fromkeys(leg.trials.recordings, reason)
            windows = np.setdiff1d(windows, moving)
    used = {trials.recordings[place] for place in windows}
    for entry in subject.recordings:
        if entry.task != GAIT and entry.name not in used | set(not_used):
            not_used[entry.name] = "none of its windows of 1 s has enough measured moments"
    if not len(windows):
        return None
    cycles = np.flatnonzero(trials.is_gait & (np.array(trials.uses) == "calibration"))
    leg = _with_trials(one_leg, np.concatenate([cycles, windows]))
    chosen = leg.trials
    recording, context = build_context(
        replace(calibration, subject=leg), (None, data.calibration_context.no_measured_changes)
    )
    context = replace(context, tasks=chosen.tasks)
    known = [ChangesOfCycles.of_first(data.calibration_context)]
    if movement is not None:
        own = replace(calibration, subject=_with_trials(one_leg, moving))
        places = np.flatnonzero(np.array(chosen.tasks) == MOVEMENT)
        known.append(changes_by_inverse_dynamics(own, movement, context, places))
    return OtherTasks(
        recording,
        with_changes(context, known),
        chosen.moments,
        chosen.tasks,
        chosen.recordings,
        chosen.time,
        not_used,
    )


def _with_trials(subject: Subject, places: Int[np.ndarray, " chosen"]) -> Subject:
    """Select cycles and windows, and the recordings that they are of."""
    trials = subject.trials.select(places)
    kept = [place for place, entry in enumerate(subject.recordings) if entry.name in trials.recordings]
    return replace(
        subject,
        trials=trials,
        recordings=tuple(subject.recordings[place] for place in kept),
        emg_rates=tuple(subject.emg_rates[place] for place in kept),
    )


def _not_used(subject: Subject, *, forces_needed: bool) -> dict[str, str]:
    """List the recordings of other tasks that are not used, with the reason."""
    reasons = {}
    for entry in subject.recordings:
        if entry.task == GAIT:
            continue
        if entry.use != "calibration":
            reasons[entry.name] = "it is for validation"
        elif (
            forces_needed
            and entry.task == MOVEMENT
            and (entry.ground_forces is None or entry.external_loads is None)
        ):
            reasons[entry.name] = "its ground reaction forces are not given, which those of the gait are"
    return reasons


def chosen_windows(trials: Trials, recordings: Collection[str]) -> Int[np.ndarray, " window"]:
    """Choose the windows of other tasks that are used, at most `MOST_WINDOWS`.

    Those for calibration in which a moment was measured, the same number of each recording, as far as it has
    them, at equal distances.

    Parameters
    ----------
    trials
        Cycles and windows of one leg.
    recordings
        Names of the recordings that can be used.
    """
    counts = (
        ~trials.is_gait
        & np.isin(trials.recordings, list(recordings))
        & (np.array(trials.uses) == "calibration")
        & (trials.counted.sum(axis=1) >= trials.time.shape[1] // 4)
    )
    names = np.array(trials.recordings)
    of_recordings = [np.flatnonzero(counts & (names == name)) for name in dict.fromkeys(names[counts])]
    numbers = [0] * len(of_recordings)
    for _ in range(min(MOST_WINDOWS, int(counts.sum()))):
        open_places = [place for place, own in enumerate(of_recordings) if numbers[place] < len(own)]
        numbers[min(open_places, key=lambda place: numbers[place])] += 1
    return np.array(
        sorted(
            int(own[place])
            for own, number in zip(of_recordings, numbers, strict=True)
            for place in np.linspace(0, len(own) - 1, number).round().astype(int)
        ),
        dtype=int,
    )


def task_evidence(
    data: DiagnosisInput,
    others: OtherTasks,
    linearized: LinearizedModel,
    variables: Float[np.ndarray, " variable"],
    scores: Scores,
) -> tuple[TaskEvidence, Scores]:
    """Compute what other tasks add to the evidence of each effect, and the scores of gait with it.

    Parameters
    ----------
    data, others
        Input of the diagnosis, and the other tasks.
    linearized, variables
        Linearised model of the gait cycles, and the calibrated variables about which it was linearised.
    scores
        Scores on the gait cycles.
    """
    problem, at = data.law.free, jnp.asarray(data.law.with_free_law(variables))
    predicted = np.asarray(joint_moments(problem.curves, problem.parameters(at), others.recording))
    known = np.isfinite(others.measured)
    measured = np.where(known, others.measured, predicted)
    gait = others.context.is_gait
    speeds = speed_numbers(np.where(gait, others.context.speeds, np.nan))
    groups = np.where(gait, speeds, speeds.max() + 1 + np.arange(len(gait)))
    groups = np.unique(groups, return_inverse=True)[1]
    effects = available_effects(catalogue(others.context, data.withheld))
    together = linearized_model(problem, at, others.recording, measured, others.context, effects, groups)
    together = replace(together, known_noise=linearized.noise)
    size = _moment_size(others, data.measured_moment_sd)
    frames = phase_frames(measured.shape[-1])
    trial = np.unique(others.recordings, return_inverse=True)[1]
    angles = np.asarray(others.context.angles)[..., frames]
    tasks = LinearizedTasks(together, groups, gait, known.any(axis=-1), size, trial, angles)
    rows = np.flatnonzero(known[..., frames])
    of_gait = int(np.sum(rows < gait.sum() * together.residual[0].size))
    candidates = [
        replace(one, variants=tuple(variant[:, rows] for variant in one.variants))
        for one in together.candidates
        if one.id in scores.by_id
    ]
    candidates += [
        replace(
            one,
            variants=tuple(np.pad(variant, ((0, 0), (0, len(rows) - of_gait))) for variant in one.variants),
        )
        for one in linearized.candidates
        if one.id not in {other.id for other in together.candidates}
    ]
    projections, covariance, error_by_angle = _projections(
        together.residual.reshape(-1)[rows], of_gait, candidates, TaskCovariance.of(tasks, rows)
    )
    (by_gait,), (by_all,) = (score_projected(part, candidates) for part in zip(*projections, strict=True))
    gait_alone = {one.id: one for one in by_gait.scores}
    of_all = {one.id: one for one in by_all.scores}
    found = TaskEvidence(
        {id: one.evidence - gait_alone[id].evidence for id, one in of_all.items()},
        {id: one.detectability for id, one in of_all.items()},
        tuple(_errors(others, known, measured - predicted)),
        error_by_angle,
        others.not_used,
    )
    by_id = {one.id: one for one in candidates}
    return found, _with_evidence(scores, found, of_all, by_id, covariance)


def _projections(
    residual: Float[np.ndarray, " row"],
    of_gait: int,
    candidates: Sequence[Candidate],
    covariance: TaskCovariance,
) -> tuple[list[tuple[Projection, Projection]], Matrix, float]:
    """Project the residual and the signatures by the plausible nulls.

    Returns
    -------
    projections, covariance, error_by_angle
        Projections of the rows of gait (the first ones) and of all rows, by each null; covariance of the most
        plausible null, and its size of errors by joint angle.
    """
    signatures = np.concatenate([variant for one in candidates for variant in one.variants])
    stacked = np.concatenate([residual[None], signatures]).T
    found: list[tuple[float, float, tuple[Projection, Projection], ErrorSizes]] = []
    for sizes, log_prior in _plausible_sizes(residual, of_gait, covariance):
        factor = scipy.linalg.cholesky(covariance(sizes), lower=True, check_finite=False)
        # The first rows of a lower factor whiten the first rows alone, so that one factor serves both.
        white = scipy.linalg.solve_triangular(factor, stacked, lower=True, check_finite=False)
        logs = np.log(np.diag(factor))
        pair = (
            _projection(white[:of_gait], logs[:of_gait], log_prior),
            _projection(white, logs, log_prior),
        )
        found.append((float(pair[0].weight[0]), float(pair[1].weight[0]), pair, sizes))
    best = max(found, key=lambda one: one[1])
    return [one[2] for one in found], covariance(best[3]), best[3].by_angle


def _projection(
    white: Float[np.ndarray, "row column"], logs: Float[np.ndarray, " row"], log_prior: float
) -> Projection:
    residual, signatures = white[:, :1], white[:, 1:]
    weight = log_prior - 0.5 * np.sum(residual**2, axis=0) - np.sum(logs)
    return Projection(weight, residual.T @ signatures, signatures.T @ signatures)


def _plausible_sizes(
    residual: Float[np.ndarray, " row"], of_gait: int, covariance: TaskCovariance
) -> Iterator[tuple[ErrorSizes, float]]:
    """List sizes of errors that gait does not rule out, with the logarithm of their prior probability."""
    log_priors = {
        (force, error): -force / EXPECTED_FORCE_ERROR - error / EXPECTED_REPEATABLE_ERROR
        for force, error in product(FORCE_ERRORS, REPEATABLE_ERRORS)
    }
    weights = {}
    for (force, error), log_prior in log_priors.items():
        own = covariance(ErrorSizes(force, error))[:of_gait, :of_gait]
        factor = scipy.linalg.cholesky(own, lower=True, check_finite=False)
        white = scipy.linalg.solve_triangular(factor, residual[:of_gait], lower=True, check_finite=False)
        weights[force, error] = log_prior - 0.5 * float(white @ white) - float(np.log(np.diag(factor)).sum())
    least = max(weights.values()) - _NEGLIGIBLE
    for (force, error), weight in weights.items():
        for by_angle in ERRORS_BY_ANGLE if weight >= least else ():
            yield ErrorSizes(force, error, by_angle), log_priors[force, error]


def _with_evidence(
    scores: Scores,
    found: TaskEvidence,
    of_all: Mapping[str, Score],
    candidates: Mapping[str, Candidate],
    covariance: Matrix,
) -> Scores:
    """Add what other tasks say to the scores of gait."""
    by_id = {
        id: replace(
            one,
            evidence=one.evidence + found.added[id],
            detectability=max(one.detectability, found.detectability[id]),
        )
        for id, one in scores.by_id.items()
    }
    by_id = dict(sorted(by_id.items(), key=lambda item: -item[1].evidence))
    compared = tuple(by_id)[:COMPARED]
    variants = [candidates[id].variants[of_all[id].variant] for id in compared]
    distances = distinguishability(
        [of_all[id].effect_sizes @ variant for id, variant in zip(compared, variants, strict=True)],
        [variant[list(of_all[id].part)] for id, variant in zip(compared, variants, strict=True)],
        covariance,
    )
    return replace(
        scores,
        by_id=by_id,
        compared=compared,
        distinguishability=distances,
        jointly_significant=tuple(id for id in by_id if id in scores.jointly_significant),
        added_by_other_tasks=dict(found.added),
    )


def _moment_size(
    others: OtherTasks, gait_sd: Float[np.ndarray, " coordinate"]
) -> Float[np.ndarray, "cycle coordinate"]:
    """Compute the size of the moments: of gait their standard deviation, of a recording its mean square."""
    size = np.tile(np.asarray(gait_sd, dtype=float), (len(others.tasks), 1))
    names = np.array(others.recordings)
    gait = others.context.is_gait
    squares = np.where(np.isfinite(others.measured), others.measured, 0.0) ** 2
    counts = np.isfinite(others.measured).sum(axis=-1)
    for name in dict.fromkeys(names[~gait].tolist()):
        own = (names == name) & ~gait
        total = np.maximum(counts[own].sum(axis=0), 1)
        size[own] = np.sqrt(squares[own].sum(axis=(0, 2)) / total)
    return size


def _errors(
    others: OtherTasks,
    known: np.ndarray,
    residual: Float[np.ndarray, "cycle coordinate frame"],
) -> Iterator[TaskError]:
    """Summarise the error of each recording of another task, by measured coordinate."""
    names, gait = np.array(others.recordings), others.context.is_gait
    for name in dict.fromkeys(names[~gait].tolist()):
        own = np.flatnonzero((names == name) & ~gait)
        for place, coordinate in enumerate(others.context.coordinates):
            counted = known[own, place]
            if not counted.any():
                continue
            squares = np.where(counted, residual[own, place] ** 2, 0.0)
            frames = counted.sum(axis=1)
            by_window = np.sqrt(squares.sum(axis=1) / np.maximum(frames, 1))
            worst = int(np.argmax(by_window))
            inside = counted[worst]
            angle = np.degrees(others.context.angles[own[worst], place][inside])
            time = others.time[own[worst]][inside]
            yield TaskError(
                name,
                others.tasks[own[0]],
                coordinate,
                int(np.sum(frames > 0)),
                float(np.sqrt(squares.sum() / frames.sum())),
                float(by_window[worst]),
                (float(angle.min()), float(angle.max())),
                (float(time.min()), float(time.max())),
            )
