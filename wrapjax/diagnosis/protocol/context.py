"""Inputs of the forward model and context of the effects over candidate trials, joined to recorded cycles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.diagnosis.inputs.context import ChangesOfCycles, Context, PathChanges, with_changes
from wrapjax.diagnosis.inputs.subject_context import changes_of_ends, changes_of_wraps
from wrapjax.diagnosis.protocol.paths import (
    CandidatePostures,
    by_angles_through_length,
    joined_derivatives,
    joined_paths,
    sped_up,
)
from wrapjax.diagnosis.protocol.trials import CandidateTrial
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import Recording
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.excitation import EmgSpline, fit_emg_spline
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles
from wrapjax.subject.trials import GAIT

#: Excitation of muscles that do not act in an effort, as a share of it.
CO_CONTRACTION = 0.05
#: Largest envelope of an effort, relative to the largest one in gait: an EMG scale that calibration left at
#: its lower bound must not make an effort arbitrarily informative.
LARGEST_ENVELOPE = 3.0
# Share of a channel's moment capacity in a direction from which its muscles act there with the full effort.
_ACTING_SHARE = 0.4


@dataclass(frozen=True)
class Leg:
    """What candidate trials need to know of a leg.

    Parameters
    ----------
    muscles, channels, muscle_channels, coordinates
        See `Context`.
    parameters
        Parameters of the model.
    engine
        Exact engine of the muscles.
    defaults
        Default values of the model's coordinates, rad or m.
    frames, padding, after
        Frames of a cycle, and of EMG before and after it.
    rest
        Envelope of each channel at rest.
    wraps
        Names of the wraps that effects may displace.
    undriven, undriven_engine
        Muscles without EMG, and their engine; None if there are none.
    """

    muscles: tuple[str, ...]
    channels: tuple[str, ...]
    muscle_channels: tuple[int, ...]
    coordinates: tuple[str, ...]
    parameters: ModelParameters
    engine: ExactPaths
    defaults: Mapping[str, float]
    frames: int
    padding: int
    after: int
    rest: Float[np.ndarray, " channel"]
    wraps: tuple[str, ...]
    undriven: UndrivenMuscles | None = None
    undriven_engine: ExactPaths | None = None


def candidate_context(
    leg: Leg, trials: Sequence[CandidateTrial], paretic: bool | None = None
) -> tuple[Recording, Context]:
    """Build the inputs of the forward model and the context of the effects over candidate trials.

    Parameters
    ----------
    leg
        Leg of the candidate trials.
    trials
        Candidate trials; each movement becomes one cycle.
    paretic
        See `Context`.
    """
    movements = tuple(movement for trial in trials for movement in trial.movements)
    postures = CandidatePostures(movements, leg.defaults, leg.coordinates, leg.frames)
    paths = postures.paths(leg.engine)
    step = np.array([movement.seconds for movement in movements]) / (leg.frames - 1)
    emg, time = _envelopes(leg, postures, paths, step)
    channels = np.array(leg.muscle_channels)
    splines: EmgSpline = jax.tree.map(
        lambda leaf: jnp.asarray(np.asarray(leaf)[channels]), fit_emg_spline(time, emg)
    )
    names = [
        trial.id if len(trial.movements) == 1 else f"{trial.id}/{number:02d}"
        for trial in trials
        for number in range(1, len(trial.movements) + 1)
    ]
    each = [trial for trial in trials for _ in trial.movements]
    undriven = leg.undriven
    if undriven is not None:
        assert leg.undriven_engine is not None, "given with the muscles"
        undriven = eqx.tree_at(lambda tree: tree.path, undriven, postures.paths(leg.undriven_engine))
    count = len(each)
    context = Context(
        muscles=leg.muscles,
        channels=leg.channels,
        muscle_channels=leg.muscle_channels,
        coordinates=leg.coordinates,
        trials=tuple(names),
        recordings=tuple(trial.id for trial in each),
        uses=("validation",) * count,
        angles=postures.angles(leg.coordinates),
        velocities=postures.rates(leg.coordinates),
        step=step,
        speeds=np.full(count, np.nan),
        order=np.ones(count),
        padding=leg.padding,
        parameters=leg.parameters,
        paths=paths,
        envelopes=splines.coefficients,
        paretic=paretic,
        undriven_muscles=undriven,
        paths_by_angle=by_angles_through_length(jnp.asarray(paths.moment_arm)),
        wraps=_wrap_changes(leg, postures),
        attachments=changes_of_ends(leg.engine.muscles, postures.by_ends(leg.engine)),
        tasks=tuple(trial.task for trial in each),
    )
    return Recording(splines, fixed_path(paths), leg.padding), context


def _wrap_changes(leg: Leg, postures: CandidatePostures) -> PathChanges | None:
    if not leg.wraps:
        return None
    return changes_of_wraps(leg.engine, leg.wraps, lambda moving: postures.by_wraps(leg.engine, moving))


def _envelopes(
    leg: Leg, postures: CandidatePostures, paths: PathState, step: Float[np.ndarray, " cycle"]
) -> tuple[Float[np.ndarray, "cycle channel padded_frame"], Float[np.ndarray, "cycle padded_frame"]]:
    """Compute envelopes with which the muscles that act in an effort reach its excitation.

    Returns
    -------
    envelopes, time
        Envelopes, and times from the start of each movement, s. Before and after it there is rest.
    """
    frames = np.arange(-leg.padding, leg.frames + leg.after)
    time = step[:, None] * frames
    shape = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.clip(frames / (leg.frames - 1), 0.0, 1.0)))
    acting = _acting(leg, paths)
    scale = np.array(
        [
            np.mean(np.asarray(leg.parameters.emg_scale)[np.array(leg.muscle_channels) == channel])
            if channel in leg.muscle_channels
            else 1.0
            for channel in range(len(leg.channels))
        ]
    )
    envelopes = np.zeros((len(step), len(leg.channels), len(frames)))
    for cycle, movement in enumerate(postures.movements):
        peak = np.zeros(len(leg.channels))
        for name, sign, effort in movement.efforts:
            share = acting[cycle, :, leg.coordinates.index(name), 0 if sign > 0 else 1]
            peak = np.maximum(peak, effort * np.maximum(share, CO_CONTRACTION))
        height = np.minimum(peak / scale, LARGEST_ENVELOPE)
        envelopes[cycle] = leg.rest[:, None] + height[:, None] * shape
    return envelopes, time


def _acting(leg: Leg, paths: PathState) -> Float[np.ndarray, "cycle channel coordinate direction"]:
    """Compute how far the muscles of each channel act in each direction of each coordinate, 0 to 1."""
    arms = np.asarray(paths.moment_arm).mean(axis=-1)
    by_muscle = arms * np.asarray(leg.parameters.max_isometric_force)[:, None, None]
    shares = np.zeros((arms.shape[1], len(leg.channels), arms.shape[2], 2))
    for channel in range(len(leg.channels)):
        own = by_muscle[np.array(leg.muscle_channels) == channel]
        if not len(own):
            continue
        capacity = np.stack([np.maximum(own, 0.0), np.maximum(-own, 0.0)], axis=-1).sum(axis=0)
        total = np.maximum(capacity.sum(axis=(1, 2), keepdims=True), 1e-12)
        shares[:, channel] = np.minimum(capacity / total / _ACTING_SHARE, 1.0)
    return shares


def at_other_speed(
    recording: Recording,
    context: Context,
    cycles: Int[np.ndarray, " chosen"],
    *,
    speed: float,
    emg: float,
    name: str,
) -> tuple[Recording, Context]:
    """Take recorded gait cycles as a candidate trial: the same motion in less time, with larger EMG.

    Parameters
    ----------
    recording, context
        Recorded cycles.
    cycles
        Numbers of the cycles to take.
    speed
        Factor on the walking speed, and on the rate of the motion.
    emg
        Factor on the EMG.
    name
        Name of the trial.
    """
    own, chosen = context.select(cycles.tolist()), recording.select_trials(cycles)
    splines = replace(chosen.emg, coefficients=chosen.emg.coefficients * emg, step=chosen.emg.step / speed)
    paths = sped_up(own.paths, speed)
    undriven = own.undriven_muscles
    if undriven is not None:
        undriven = eqx.tree_at(lambda tree: tree.path, undriven, sped_up(undriven.path, speed))
    count = len(cycles)
    changed = replace(
        own,
        trials=tuple(f"{name}/{number:02d}" for number in range(1, count + 1)),
        recordings=(name,) * count,
        uses=("validation",) * count,
        velocities=own.velocities * speed,
        step=own.step / speed,
        speeds=own.speeds * speed,
        order=np.ones(count),
        paths=paths,
        envelopes=splines.coefficients,
        undriven_muscles=undriven,
        paths_by_angle=None if own.paths_by_angle is None else sped_up(own.paths_by_angle, speed),
        wraps=_sped_up_changes(own.wraps, speed),
        attachments=_sped_up_changes(own.attachments, speed),
        path_changes={},
        measured_changes={},
        all_cycles=None,
    )
    return Recording(splines, fixed_path(paths), recording.padding), changed


def _sped_up_changes(changes: PathChanges | None, factor: float) -> PathChanges | None:
    if changes is None:
        return None
    return replace(changes, derivatives=sped_up(changes.derivatives, factor))


def joined(parts: Sequence[tuple[Recording, Context]]) -> tuple[Recording, Context]:
    """Join cycles of one leg; what only the first part knows changes nothing in the others.

    Parameters
    ----------
    parts
        Inputs of the forward model and contexts; the first one holds the recorded cycles, if there are any.
    """
    recordings, contexts = zip(*parts, strict=True)
    first: Context = contexts[0]
    emg = EmgSpline(
        jnp.concatenate([one.emg.coefficients for one in recordings], axis=1),
        jnp.concatenate([one.emg.step for one in recordings], axis=1),
        start=_joined_starts([one.emg for one in recordings]),
    )
    paths = joined_paths([one.paths for one in contexts])
    undriven = first.undriven_muscles
    if undriven is not None:
        path = joined_paths([one.undriven_muscles.path for one in contexts])
        undriven = eqx.tree_at(lambda tree: tree.path, undriven, path)

    def stacked(field: str) -> np.ndarray:
        return np.concatenate([getattr(one, field) for one in contexts])

    def chained(field: str) -> tuple[str, ...]:
        return tuple(entry for one in contexts for entry in getattr(one, field))

    by_angle = [one.paths_by_angle for one in contexts]
    context = replace(
        first,
        trials=chained("trials"),
        recordings=chained("recordings"),
        uses=chained("uses"),
        angles=stacked("angles"),
        velocities=stacked("velocities"),
        step=stacked("step"),
        speeds=stacked("speeds"),
        order=stacked("order"),
        tasks=tuple(task for one in contexts for task in (one.tasks or (GAIT,) * len(one.trials))),
        paths=paths,
        envelopes=emg.coefficients,
        undriven_muscles=undriven,
        paths_by_angle=None if any(one is None for one in by_angle) else joined_derivatives(by_angle),
        wraps=_joined_changes([one.wraps for one in contexts]),
        attachments=_joined_changes([one.attachments for one in contexts]),
        all_cycles=None,
    )
    context = with_changes(context, [ChangesOfCycles.of_first(first)])
    return Recording(emg, fixed_path(paths), recordings[0].padding), context


def _joined_starts(splines: Sequence[EmgSpline]) -> Int[Array, "muscle cycle"] | None:
    if all(one.start is None for one in splines):
        return None
    return jnp.concatenate(
        [jnp.zeros(one.step.shape, dtype=int) if one.start is None else one.start for one in splines], axis=1
    )


def _joined_changes(parts: Sequence[PathChanges | None]) -> PathChanges | None:
    first, known = parts[0], [one.derivatives for one in parts if one is not None]
    if first is None or len(known) < len(parts):
        return None
    return replace(first, derivatives=joined_derivatives(known))
