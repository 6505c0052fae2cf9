"""What wrong inputs of inverse dynamics do to measured moments, where ground forces were recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from wrapjax.diagnosis.context import MeasuredChange, change_id
from wrapjax.diagnosis.inverse_dynamics.recorded_walk import Walk
from wrapjax.diagnosis.inverse_dynamics.wrong_inputs import BY_SHAPE, SLOPES
from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.osim.inverse_dynamics import analyse_mechanics
from wrapjax.osim.model import describe_model
from wrapjax.osim.motion import Motion
from wrapjax.subject.external_loads import GroundLoads, read_ground_loads
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

#: By how much latency is moved to see what it does, s: half a prior deviation.
_LATENCY = 0.005


#: Why there is no change of moments where all that inverse dynamics need was recorded.
INDEPENDENT = "inverse dynamics about these coordinates do not depend on it"


def measured_changes(walk: Walk) -> dict[str, MeasuredChange]:
    """Say what each effect on the measurement chain adds to the moments that were measured.

    Measured is what a laboratory's inverse dynamics gave; an amount says how wrong their input was, and a
    change is what that added. It is exact, and linear in the amounts.

    Parameters
    ----------
    walk
        From `recorded_walk`.

    Returns
    -------
    changes
        By the id of an effect, or of one of its shapes (`change_id`), from amounts to N m (trial x
        coordinate x frame); those that change nothing (`INDEPENDENT`) are left out.
    """
    found = {id: slopes_of(walk) for id, slopes_of in SLOPES.items()}
    for id, by_shape in BY_SHAPE.items():
        found |= {change_id(id, shape): slopes for shape, slopes in by_shape(walk).items()}
    changes: dict[str, MeasuredChange] = {}
    for id, slopes in found.items():
        if slopes.any():
            cut = slopes.reshape(*slopes.shape[:2], *walk.time.shape)
            changes[id] = Partial(_along, jnp.asarray(np.moveaxis(cut, 1, 2)))
    return changes


def recorded_walk(subject: Subject) -> tuple[Walk | None, str]:
    """Gather what inverse dynamics of all cycles need; or None, and what is missing for that.

    Parameters
    ----------
    subject
        Whose trials name ground forces and external loads, and whose angles hold every coordinate from
        ground to the foot.

    Raises
    ------
    InputError
        If the files of forces are unfit, or name bodies that the model lacks.
    """
    reason = _files_lack(subject)
    if reason:
        return None, reason
    loads = {trial.name: read_ground_loads(trial) for trial in subject.recordings}
    model = _structure(subject.model_file)
    _check_bodies(subject, model, loads)
    loaded = _below(subject, model, dict.fromkeys(body for entry in loads.values() for body in entry.bodies))
    if not loaded:
        return None, "no ground reaction forces act on this leg in these trials"
    reason = _angles_lack(subject, model, loaded)
    return (None, reason) if reason else (_walk(subject, model, loads, loaded), "")


@dataclass(frozen=True)
class _Structure:
    """Coordinates between each body and ground; those that are locked; those that follow others."""

    above: dict[str, tuple[str, ...]]
    locked: frozenset[str]
    following: frozenset[str]


def _structure(model_file: Path) -> _Structure:
    model = describe_model(model_file)
    return _Structure(
        above={joint.child_body: model.coordinates_above(joint.child_body) for joint in model.joints},
        locked=frozenset(entry.name for entry in model.coordinates if entry.locked),
        following=frozenset(entry.name for entry in model.coordinates if entry.coupled_to),
    )


def _along(
    slopes: Float[Array, "parameter trial coordinate frame"], effect_sizes: Float[Array, " parameter"]
) -> Float[Array, "trial coordinate frame"]:
    return jnp.tensordot(effect_sizes, slopes, axes=1)


def _files_lack(subject: Subject) -> str:
    """Say what files are missing; empty where none is."""
    if any(trial.ground_forces is None for trial in subject.recordings):
        return "no ground reaction forces are given for these trials"
    if any(trial.external_loads is None for trial in subject.recordings):
        return "no external loads are given, which say on what body the ground reaction forces act"
    return ""


def _check_bodies(subject: Subject, model: _Structure, loads: Mapping[str, GroundLoads]) -> None:
    problems = [
        Problem(
            str(trial.external_loads),
            f"the model {subject.model_file} has no such body",
            f"<applied_to_body> {body}",
            nearest_name(body, tuple(model.above)),
        )
        for trial in subject.recordings
        for body in loads[trial.name].bodies
        if body not in model.above
    ]
    if problems:
        raise InputError(dict.fromkeys(problems))


def _below(subject: Subject, model: _Structure, bodies: dict[str, None]) -> tuple[str, ...]:
    """Keep the bodies that a coordinate of this leg moves."""
    own = set(subject.trials.moment_coordinates)
    return tuple(body for body in bodies if own & set(model.above[body]))


def _angles_lack(subject: Subject, model: _Structure, loaded: tuple[str, ...]) -> str:
    """Say what coordinates between ground and the foot were not recorded; empty where all were."""
    missing = dict.fromkeys(
        name
        for body in loaded
        for name in model.above[body]
        if name not in subject.trials.coordinates and name not in model.following and name not in model.locked
    )
    if not missing:
        return ""
    return f"the angles of these trials lack {', '.join(missing)}, which inverse dynamics need"


def _walk(
    subject: Subject, model: _Structure, loads: Mapping[str, GroundLoads], loaded: tuple[str, ...]
) -> Walk:
    trials = subject.trials

    def wrench(later: float) -> Float[np.ndarray, "load 6 pose"]:
        return np.stack([_acting(trials, loads, (body,), later) for body in loaded])

    own = wrench(0.0)
    others = tuple({body for entry in loads.values() for body in entry.bodies} - set(loaded))
    analyse = partial(analyse_mechanics, subject.model_file, trials.moment_coordinates)
    motion = _motion(subject, model)
    return Walk(
        side=subject.side,
        time=trials.time,
        motion=motion,
        mechanics=analyse(motion),
        loaded=loaded,
        wrench=own,
        # What is recorded later by an amount is, now, what it was that amount ago.
        by_latency=(wrench(_LATENCY) - wrench(-_LATENCY)) / (2.0 * _LATENCY),
        other=_acting(trials, loads, others, 0.0) if others else None,
        analyse=analyse,
    )


def _acting(
    trials: Trials, loads: Mapping[str, GroundLoads], bodies: tuple[str, ...], later: float
) -> Float[np.ndarray, "6 pose"]:
    """Sum up what acted on bodies some time (s) before each frame of each cycle."""
    found = np.zeros((6, *trials.time.shape))
    recordings = np.array(trials.recordings)
    for name, entry in loads.items():
        rows = recordings == name
        acting = [row for row, body in enumerate(entry.bodies) if body in bodies]
        found[:, rows] = entry.at(trials.time[rows] - later)[acting].sum(axis=0)
    return found.reshape(6, -1)


def _motion(subject: Subject, model: _Structure) -> Motion:
    """Give the recorded motion."""
    trials = subject.trials
    chosen = [row for row, name in enumerate(trials.coordinates) if name not in model.following]
    values, speeds = trials.angles[:, chosen], trials.angular_velocities[:, chosen]
    accelerations = np.zeros_like(values)
    for number, time in enumerate(trials.time):
        accelerations[number] = CubicSpline(time, speeds[number], axis=1)(time, 1)

    def in_a_row(
        signals: Float[np.ndarray, "trial coordinate frame"],
    ) -> Float[np.ndarray, "coordinate pose"]:
        return np.moveaxis(signals, 1, 0).reshape(len(chosen), -1)

    names = tuple(trials.coordinates[row] for row in chosen)
    return Motion(names, in_a_row(values), in_a_row(speeds), in_a_row(accelerations))
