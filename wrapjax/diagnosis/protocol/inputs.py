"""Linearised model over recorded cycles and candidate trials, of a calibrated subject or of a model alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.calibration.calibration import Calibration
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.problem import build_objective
from wrapjax.diagnosis.effects.catalogue import available_effects, catalogue
from wrapjax.diagnosis.evidence.linearization import LinearizedModel, linearized_model
from wrapjax.diagnosis.evidence.other_tasks import OtherTasks
from wrapjax.diagnosis.evidence.task_covariance import LinearizedTasks
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames, speed_numbers
from wrapjax.diagnosis.inputs.priors import with_published_priors
from wrapjax.diagnosis.null_hypotheses.cycle_noise import CycleNoise, cycle_noise
from wrapjax.diagnosis.protocol.context import Leg, at_other_speed, candidate_context, joined
from wrapjax.diagnosis.protocol.trials import CandidateTrial, candidate_trials
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.paths import AbstractPath
from wrapjax.model.forward import Recording, joint_moments
from wrapjax.model.freedom import Freedom, nga_freedom
from wrapjax.model.variables import free_variables
from wrapjax.muscle.personal_law import given_law
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import ExactGeometry, build_engine
from wrapjax.path_sources.model_inputs import model_parameters
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import FRAMES, GAIT, Trials

#: Expected standard deviation of joint moments by motion capture, N m, where no recorded gait shows it.
EXPECTED_NOISE = 3.0
#: Frames of EMG before and after each movement, of a model alone.
_PADDING = 20
#: Cycles of a candidate trial of gait, and the factors on the walking speed and on the EMG (about 55 % a m/s:
#: Hof et al. 2002, doi:10.1016/S0966-6362(01)00206-5).
_GAIT_CYCLES = 3
_SPEEDS = {"gait_faster": (1.3, 1.2, "faster"), "gait_slower": (0.7, 0.8, "slower")}


@dataclass(frozen=True)
class ProtocolInput(LinearizedTasks):
    """Linearised model over recorded cycles and candidate trials.

    Parameters
    ----------
    trials
        Candidate trials.
    known
        Rows whose moments are measured, or would be.
    negative_controls
        Identifiers of effects that cannot be present.
    """

    trials: tuple[CandidateTrial, ...]
    known: Bool[np.ndarray, "cycle coordinate phase"]
    negative_controls: tuple[str, ...]

    @property
    def recorded(self) -> Bool[np.ndarray, " cycle"]:
        """Whether each cycle was recorded; their trials have negative numbers, those of gait -1."""
        return self.trial < 0


@dataclass(frozen=True)
class _Recorded:
    """What was recorded: inputs of the forward model, context, moments, and trials.

    Parameters
    ----------
    recording, context
        Inputs of the forward model, and context of the effects.
    measured
        Measured moments, N m; NaN where none was measured.
    trial
        -1 for gait; a smaller number for each recording of another task.
    """

    recording: Recording
    context: Context
    measured: Float[np.ndarray, "recorded coordinate frame"]
    trial: Int[np.ndarray, " recorded"]

    @property
    def after(self) -> int:
        """Frames of EMG after each cycle."""
        knots = self.recording.emg.coefficients.shape[-1] + 1
        return int(knots - self.measured.shape[-1] - self.recording.padding)


def input_of_calibration(
    calibration: Calibration, data: DiagnosisInput, others: OtherTasks | None = None
) -> ProtocolInput:
    """Linearise a calibrated model over its calibration cycles, other recorded tasks, and candidate trials.

    Parameters
    ----------
    calibration
        Calibration of one leg to gait.
    data
        Input of a diagnosis of this calibration.
    others
        Other tasks that were recorded; None for gait alone.
    """
    subject, context = calibration.subject, data.calibration_context
    before = _recorded(data, others)
    engine = build_engine(subject)
    wraps = () if context.wraps is None else tuple(name.rsplit(".", 1)[0] for name in context.wraps.names)
    undriven = context.undriven_muscles
    undriven_engine = None if undriven is None else _engine_of(subject, undriven.names)
    trials = subject.trials
    leg = Leg(
        muscles=context.muscles,
        channels=context.channels,
        muscle_channels=context.muscle_channels,
        coordinates=context.coordinates,
        parameters=context.parameters,
        engine=engine,
        defaults=_defaults(subject),
        frames=context.angles.shape[-1],
        padding=before.recording.padding,
        after=before.after,
        rest=np.percentile(trials.emg, 1.0, axis=(0, 2)),
        wraps=tuple(dict.fromkeys(wraps)),
        undriven=undriven,
        undriven_engine=undriven_engine,
    )
    candidates = candidate_trials(context.coordinates, _ranges(subject, context.coordinates))
    parts = [(before.recording, before.context), candidate_context(leg, candidates, subject.paretic)]
    of_trial = [before.trial, _numbers(candidates)]
    gait_trials: list[CandidateTrial] = []
    for name, (speed, emg, word) in _SPEEDS.items():
        chosen = _cycles_of_speed(context, slowest=speed < 1.0)
        parts.append(
            at_other_speed(before.recording, before.context, chosen, speed=speed, emg=emg, name=name)
        )
        of_trial.append(np.full(len(chosen), len(candidates) + len(gait_trials)))
        gait_trials.append(_gait_trial(name, word, speed, context, chosen))
    return _linearized(
        data.law.free,
        jnp.asarray(data.law.with_free_law(data.variables)),
        parts,
        before.measured,
        (*candidates, *gait_trials),
        np.concatenate(of_trial),
        data.withheld,
    )


def _recorded(data: DiagnosisInput, others: OtherTasks | None) -> _Recorded:
    """Collect the gait cycles for calibration, and the windows of other tasks."""
    if others is None:
        measured = data.measured[data.plan.calibration]
        context = replace(data.calibration_context, all_cycles=None)
        return _Recorded(data.calibration_recording, context, measured, np.full(len(measured), -1))
    names = np.unique(others.recordings, return_inverse=True)[1]
    trial = np.where(others.context.is_gait, -1, -2 - names)
    return _Recorded(others.recording, others.context, others.measured, trial)


def input_of_model(subject: Subject, without: Sequence[str] = ()) -> ProtocolInput:
    """Linearise a model without recordings over candidate trials.

    Parameters
    ----------
    subject
        Leg from `subject_of_model`.
    without
        Identifiers of effects to leave out.
    """
    engine = _engine_of(subject, subject.muscles.names)
    parameters = replace(model_parameters(subject), law=jnp.asarray(given_law(len(subject.muscles.names))))
    coordinates = subject.trials.moment_coordinates
    wraps = dict.fromkeys(wrap for name in engine.muscles for wrap in engine.wraps_of(name))
    leg = Leg(
        muscles=subject.muscles.names,
        channels=subject.trials.channels,
        muscle_channels=subject.muscle_channels,
        coordinates=coordinates,
        parameters=parameters,
        engine=engine,
        defaults=_defaults(subject),
        frames=FRAMES,
        padding=_PADDING,
        after=_PADDING,
        rest=np.zeros(len(subject.trials.channels)),
        wraps=tuple(wraps),
    )
    candidates = candidate_trials(coordinates, _ranges(subject, coordinates))
    recording, context = candidate_context(leg, candidates)
    problem = _objective(subject, engine, recording, context)
    none = np.zeros((0, len(coordinates), FRAMES))
    return _linearized(
        problem,
        jnp.asarray(problem.start(parameters)),
        [(recording, context)],
        none,
        candidates,
        _numbers(candidates),
        without,
    )


@dataclass(frozen=True)
class _GivenPaths(ExactGeometry):
    """Source of paths that are computed already."""

    path: AbstractPath

    def paths(self, subject: Subject, trials: Trials, freedom: Freedom) -> AbstractPath:
        """Return the paths that are given."""
        return self.path


def _objective(subject: Subject, engine: ExactPaths, recording: Recording, context: Context) -> Objective:
    """Build an objective whose priors and penalties are those of a calibration of this model."""
    frames = np.arange(FRAMES)
    padded = np.arange(-context.padding, FRAMES + context.padding)
    count, channels = len(context.trials), len(context.channels)
    trials = Trials(
        names=context.trials,
        recordings=context.recordings,
        uses=("calibration",) * count,
        speeds=context.speeds,
        coordinates=context.coordinates,
        moment_coordinates=context.coordinates,
        channels=context.channels,
        time=context.step[:, None] * frames,
        angles=context.angles,
        angular_velocities=context.velocities,
        moments=np.zeros(context.angles.shape),
        emg_time=context.step[:, None] * padded,
        emg=np.zeros((count, channels, len(padded))),
        tasks=context.tasks,
    )
    freedom = nga_freedom(model_parameters(subject))
    no_wraps = np.zeros((len(engine.muscles), 0), dtype=bool)
    given = _GivenPaths("engine", "", engine, no_wraps, {}, recording.path)
    problem = build_objective(replace(subject, trials=trials), fit=given, freedom=freedom)
    law = jnp.asarray(given_law(len(subject.muscles.names)))
    start = replace(model_parameters(subject), law=law)
    variables = free_variables(start, with_published_priors(freedom), subject.muscles.names)
    return replace(problem, variables=variables)


def _linearized(
    problem: Objective,
    variables: Float[Array, " variable"],
    parts: Sequence[tuple[Recording, Context]],
    measured: Float[np.ndarray, "recorded coordinate frame"],
    trials: tuple[CandidateTrial, ...],
    of_trial: Int[np.ndarray, " cycle"],
    without: Sequence[str],
) -> ProtocolInput:
    recording, context = joined(parts) if len(parts) > 1 else parts[0]
    effects = available_effects(catalogue(context, without))
    groups = _groups(context, of_trial, trials)
    predicted = np.asarray(joint_moments(problem.curves, problem.parameters(variables), recording))
    known = np.ones(predicted.shape, dtype=bool)
    known[: len(measured)] = np.isfinite(measured)
    for cycle in np.flatnonzero(of_trial >= 0):
        known[cycle] &= np.isin(context.coordinates, trials[of_trial[cycle]].measured)[:, None]
    moments = predicted.copy()
    moments[: len(measured)] = np.where(known[: len(measured)], measured, predicted[: len(measured)])
    linearized = linearized_model(problem, variables, recording, moments, context, effects, groups)
    noise = _noise(linearized, of_trial == -1, groups)
    size = np.sqrt(np.mean(moments**2, axis=-1))
    for number in np.unique(of_trial):
        own = of_trial == number
        of_gait = number == -1
        size[own] = moments[own].std(axis=(0, 2)) if of_gait else np.sqrt(np.mean(size[own] ** 2, axis=0))
    frames = phase_frames(moments.shape[-1])
    return ProtocolInput(
        linearized=replace(linearized, known_noise=noise),
        trials=trials,
        known=known[..., frames],
        trial=of_trial,
        groups=groups,
        gait=context.is_gait,
        measured=np.any(known, axis=-1),
        moment_size=size,
        angles=np.asarray(context.angles)[..., frames],
        negative_controls=tuple(effect.id for effect in effects if effect.negative_control),
    )


def _noise(
    linearized: LinearizedModel, gait: Bool[np.ndarray, " cycle"], groups: Int[np.ndarray, " cycle"]
) -> CycleNoise:
    """Estimate the noise of the recorded gait cycles; expected values where none was recorded."""
    if gait.any():
        inputs = [replace(one, signatures=one.signatures[:, gait]) for one in linearized.input_errors]
        return cycle_noise(linearized.fitted_residual[gait], groups[gait], inputs)
    coordinates, phases = linearized.fitted_residual.shape[1:]
    harmonics = np.arange(phases // 2 + 1)
    # The power of a kernel of 4 % of the cycle.
    spectrum = np.exp(-0.5 * (2.0 * np.pi * 0.04 * harmonics) ** 2)
    return CycleNoise(
        EXPECTED_NOISE**2 * np.eye(coordinates), spectrum, (1.0,) * len(linearized.input_errors)
    )


def _groups(
    context: Context, of_trial: Int[np.ndarray, " cycle"], trials: tuple[CandidateTrial, ...]
) -> Int[np.ndarray, " cycle"]:
    """Assign a number to cycles that repeat each other: gait at one speed, the same movement of a trial."""
    gait = context.is_gait
    speeds = np.where(gait, speed_numbers(np.where(gait, context.speeds, np.nan)), 0)
    keys: list[tuple[int, int]] = []
    seen: dict[int, int] = {}
    for cycle, number in enumerate(of_trial.tolist()):
        if gait[cycle]:
            keys.append((number, int(speeds[cycle])))
            continue
        if number < 0:
            # A recorded window of another task repeats nothing.
            keys.append((number, cycle))
            continue
        place = seen.get(number, 0)
        seen[number] = place + 1
        movements = trials[number].movements
        keys.append((number, movements.index(movements[place])))
    distinct = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    return np.array([distinct[key] for key in keys])


def _numbers(trials: Sequence[CandidateTrial]) -> Int[np.ndarray, " cycle"]:
    return np.repeat(np.arange(len(trials)), [len(trial.movements) for trial in trials])


def _cycles_of_speed(context: Context, *, slowest: bool) -> Int[np.ndarray, " chosen"]:
    """Choose cycles of the slowest or the fastest recorded speed."""
    numbers = speed_numbers(context.speeds)
    wanted = numbers.min() if slowest else numbers.max()
    return np.flatnonzero(numbers == wanted)[:_GAIT_CYCLES]


def _gait_trial(
    name: str, word: str, factor: float, context: Context, chosen: Int[np.ndarray, " cycle"]
) -> CandidateTrial:
    speed = context.speeds[chosen[0]] * factor
    at = f"at about {speed:.1f} m/s" if np.isfinite(speed) else f"at {factor:g} times the recorded speed"
    return CandidateTrial(
        id=name,
        task=GAIT,
        what=f"{len(chosen)} gait cycles, {word} than recorded",
        posture={},
        effort=at,
        minutes=5,
        movements=(),
        measured=context.coordinates,
    )


def _engine_of(subject: Subject, muscles: tuple[str, ...]) -> ExactPaths:
    model = describe_model(subject.model_file)
    spanned = {name for muscle in muscles for name in model.spanned_by(muscle)}
    return ExactPaths(model, muscles, tuple(name for name in subject.trials.coordinates if name in spanned))


def _defaults(subject: Subject) -> dict[str, float]:
    return {one.name: one.default_value for one in describe_model(subject.model_file).coordinates}


def _ranges(subject: Subject, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    of_model = {one.name: one.range for one in describe_model(subject.model_file).coordinates}
    return {name: of_model[name] for name in names}
