"""Properties of a subject and its recorded cycles that effects are built from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.paths import PathState
from wrapjax.model.parameters import ModelParameters
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles
from wrapjax.subject.joint_spread import JointSpread
from wrapjax.subject.muscle_groups import standard_name
from wrapjax.subject.trials import GAIT

Kinematics = Float[np.ndarray, "trial coordinate frame"]
#: Function from effect sizes to what the effect adds to the prediction of the measured moments, N m.
MeasuredChange = Callable[[Float[Array, " parameter"]], Float[Array, "trial coordinate frame"]]


#: Fewest calibration cycles of a condition, see `Context.conditions`.
_FEWEST_CYCLES = 2


class PathChanges(eqx.Module):
    """Changes of muscle paths by parameters, each of which changes one or several muscles.

    They are linear in the parameters.
    """

    #: Derivatives of each muscle's path by its own changes; the first axes of all leaves are ``muscle mode``.
    derivatives: PathState
    #: Number of the parameter that gives each change of a muscle; -1 for none.
    places: Int[np.ndarray, "muscle mode"]
    #: Name, unit and prior standard deviation of each parameter.
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    prior_sd: tuple[float, ...] = eqx.field(static=True)

    def by_muscle(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Compute what the changes of every muscle add to the paths."""
        added: PathState = jax.tree.map(
            lambda leaf: jnp.einsum("mk,mk...->m...", changes, leaf), self.derivatives
        )
        return added


@dataclass(frozen=True)
class AtBound:
    """Calibrated parameter that is at a bound.

    Parameters
    ----------
    muscle, parameter
        Name of the muscle, and name of the parameter in `ModelParameters`.
    outward
        1 at the upper bound, -1 at the lower.
    prior_sd
        Prior standard deviation of the distance beyond the bound, in the parameter's unit.
    unit
        Unit of the parameter.
    limit
        Largest plausible distance beyond the bound.
    """

    muscle: str
    parameter: str
    outward: int
    prior_sd: float
    unit: str
    limit: float = np.inf


@dataclass(frozen=True)
class Context:
    """Properties of a subject and its cycles that effects are built from.

    Parameters
    ----------
    muscles
        Names of the muscles with EMG, in the order of the model's axis ``muscle``.
    channels, muscle_channels
        Names of the EMG channels, and number of the channel that drives each muscle.
    coordinates
        Coordinates whose moments are matched.
    trials, recordings, uses
        Names of the cycles, and recording and use (``calibration`` or ``validation``) of each cycle.
    angles, velocities
        Angles and angular velocities of these coordinates, rad and rad/s.
    step
        Time between frames of each cycle, s.
    speeds
        Walking speed of each cycle, m/s; NaN where unknown.
    order
        Place of each cycle in the session: 0 for the first, 1 for the last.
    padding
        Frames of EMG before and after each cycle.
    parameters
        Parameters of the plain model, from which effects take thresholds and normalisation.
    paths
        Paths of the plain model.
    envelopes
        Coefficients of the envelope of each muscle, see `EmgSpline`.
    paretic
        Whether the leg is paretic; None if unknown.
    undriven_muscles
        Muscles without EMG; None if there are none, or their paths are not known.
    no_undriven_muscles
        Reason why there are none.
    paths_by_angle
        Derivatives of the paths by each joint angle (rad); leaves lead with ``muscle coordinate``. None where
        they are not known.
    wraps, attachments
        Changes of the paths by their wraps, and by the ends of the muscles; None where they are not known.
    at_bounds
        Calibrated parameters that are at a bound.
    path_changes
        By identifier of an effect and label of its variant: what a unit of each effect size adds to the
        recorded paths to give those that the person's muscles had; leaves lead with ``muscle parameter``.
    measured_changes
        By identifier of an effect and label of its variant: what effect sizes add to the prediction of the
        measured moments, by inverse dynamics (`effects.measured_changes`).
    no_measured_changes
        Reason why there are none.
    joint_spread
        Standard deviations of the places of joints that were personalised from markers, by coordinate.
    all_cycles
        Context of all cycles, of which this one is a selection; None if nothing was selected.
    tasks
        Task of each cycle; all ``gait`` if not given.
    """

    muscles: tuple[str, ...]
    channels: tuple[str, ...]
    muscle_channels: tuple[int, ...]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    recordings: tuple[str, ...]
    uses: tuple[str, ...]
    angles: Kinematics
    velocities: Kinematics
    step: Float[np.ndarray, " trial"]
    speeds: Float[np.ndarray, " trial"]
    order: Float[np.ndarray, " trial"]
    padding: int
    parameters: ModelParameters
    paths: PathState
    envelopes: Float[Array, "muscle trial 4 interval"]
    paretic: bool | None = None
    undriven_muscles: UndrivenMuscles | None = None
    no_undriven_muscles: str = "every muscle of this leg has an EMG channel"
    paths_by_angle: PathState | None = None
    wraps: PathChanges | None = None
    attachments: PathChanges | None = None
    at_bounds: tuple[AtBound, ...] = ()
    path_changes: Mapping[str, Mapping[str, PathState]] = field(default_factory=dict)
    measured_changes: Mapping[str, Mapping[str, MeasuredChange]] = field(default_factory=dict)
    no_measured_changes: str = "no ground reaction forces are given for these trials"
    joint_spread: Mapping[str, JointSpread] = field(default_factory=dict)
    all_cycles: Context | None = None
    tasks: tuple[str, ...] = ()

    @property
    def is_gait(self) -> Bool[np.ndarray, " trial"]:
        """Whether each cycle is a gait cycle; effects of the phase of gait are zero in the others."""
        return np.array([task == GAIT for task in self.tasks or (GAIT,) * len(self.trials)], dtype=bool)

    @property
    def gait_cycles(self) -> tuple[str, ...]:
        """Names of the gait cycles."""
        return tuple(name for name, gait in zip(self.trials, self.is_gait, strict=True) if gait)

    @property
    def reference(self) -> Context:
        """Context of all cycles, which normalises effects: sizes then mean the same in any selection."""
        return self if self.all_cycles is None else self.all_cycles

    @property
    def duration(self) -> Float[np.ndarray, " trial"]:
        """Duration of each cycle, s."""
        return self.step * (self.angles.shape[-1] - 1)

    @property
    def phase(self) -> Float[np.ndarray, " frame"]:
        """Phase of each frame: 0 at the start of a cycle, 1 at its end."""
        return np.linspace(0.0, 1.0, self.angles.shape[-1])

    @property
    def conditions(self) -> dict[str, Bool[np.ndarray, " trial"]]:
        """Cycles of each recording, and of each walking speed of several recordings, by a label.

        The labels are those of all cycles (`reference`). A condition has several calibration cycles, as an
        error in a single one cannot be distinguished from noise. Empty where these were all recorded under
        one condition.
        """
        every = self.reference
        calibrating = np.array([use == "calibration" for use in every.uses]) & every.is_gait
        gait = [place for place, is_gait in enumerate(every.is_gait) if is_gait]
        groups = {
            f"in {every.recordings[place]} only": np.array(every.recordings) == every.recordings[place]
            for place in gait
        }
        for speed in every.speeds[gait]:
            groups.setdefault(f"at {speed:.2f} m/s only", every.speeds == speed)
        masks: dict[str, Bool[np.ndarray, " trial"]] = {}
        for label, cycles in groups.items():
            count = int(cycles[calibrating].sum())
            known = any(np.array_equal(cycles, other) for other in masks.values())
            if not known and _FEWEST_CYCLES <= count < calibrating.sum():
                masks[label] = cycles
        own = [every.trials.index(name) for name in self.trials]
        return {label: cycles[own] for label, cycles in masks.items()}

    def muscle_rows(self, names: Sequence[str]) -> list[int]:
        """Find the rows of muscles by their names without side (`standard_name`), of those that there are."""
        return [row for row, muscle in enumerate(self.muscles) if standard_name(muscle) in names]

    def coordinate(self, stem: str) -> int | None:
        """Find the row of the first coordinate whose name starts with a stem; None if there is none."""
        return next((row for row, name in enumerate(self.coordinates) if name.startswith(stem)), None)

    def select(self, trials: Sequence[int]) -> Context:
        """Select cycles; effect sizes keep the meaning that they have for all cycles (`reference`)."""
        chosen = np.asarray(trials, dtype=int)
        keep = jnp.asarray(chosen)
        undriven = self.undriven_muscles
        if undriven is not None:
            undriven = eqx.tree_at(lambda tree: tree.path, undriven, _select_paths(undriven.path, keep))
        return replace(
            self,
            trials=tuple(self.trials[number] for number in chosen),
            recordings=tuple(self.recordings[number] for number in chosen),
            uses=tuple(self.uses[number] for number in chosen),
            angles=self.angles[chosen],
            velocities=self.velocities[chosen],
            step=self.step[chosen],
            speeds=self.speeds[chosen],
            order=self.order[chosen],
            tasks=tuple(self.tasks[number] for number in chosen) if self.tasks else (),
            paths=_select_paths(self.paths, keep),
            envelopes=self.envelopes[:, keep],
            undriven_muscles=undriven,
            paths_by_angle=None
            if self.paths_by_angle is None
            else _select_derivatives(self.paths_by_angle, keep),
            wraps=_select_changes(self.wraps, keep),
            attachments=_select_changes(self.attachments, keep),
            path_changes={
                id: {label: _select_derivatives(derivatives, keep) for label, derivatives in variants.items()}
                for id, variants in self.path_changes.items()
            },
            measured_changes={
                id: {label: Partial(_selected_change, change, keep) for label, change in variants.items()}
                for id, variants in self.measured_changes.items()
            },
            all_cycles=self.reference,
        )


def _select_paths(paths: PathState, keep: Int[Array, " trial"]) -> PathState:
    """Select cycles of paths; the axis ``trial`` is the second."""
    return PathState(
        *(jnp.asarray(leaf)[:, keep] for leaf in (paths.length, paths.velocity, paths.moment_arm))
    )


def _select_derivatives(derivatives: PathState, keep: Int[Array, " trial"]) -> PathState:
    """Select cycles of derivatives of paths; the axis ``trial`` is the third."""
    selected: PathState = jax.tree.map(lambda leaf: leaf[:, :, keep], derivatives)
    return selected


def _select_changes(changes: PathChanges | None, keep: Int[Array, " trial"]) -> PathChanges | None:
    if changes is None:
        return None
    return replace(changes, derivatives=_select_derivatives(changes.derivatives, keep))


def _selected_change(
    change: MeasuredChange, keep: Int[Array, " trial"], effect_sizes: Float[Array, " parameter"]
) -> Float[Array, "trial coordinate frame"]:
    return change(effect_sizes)[keep]


@dataclass(frozen=True)
class ChangesOfCycles:
    """Changes by errors in the inputs of inverse dynamics, over some of the cycles of a context.

    Parameters
    ----------
    cycles
        Numbers of the cycles.
    measured, paths
        See `Context.measured_changes` and `Context.path_changes`.
    """

    cycles: Int[np.ndarray, " chosen"]
    measured: Mapping[str, Mapping[str, MeasuredChange]]
    paths: Mapping[str, Mapping[str, PathState]]

    @classmethod
    def of_first(cls, context: Context) -> ChangesOfCycles:
        """Return those of a context whose cycles are the first ones of another."""
        return cls(np.arange(len(context.trials)), context.measured_changes, context.path_changes)


def with_changes(context: Context, parts: Sequence[ChangesOfCycles]) -> Context:
    """Give cycles the changes that are known over some of them; the others have none."""
    count = len(context.trials)
    measured = _by_variant([(part.cycles, part.measured) for part in parts])
    paths = _by_variant([(part.cycles, part.paths) for part in parts])
    return replace(
        context,
        measured_changes={
            id: {label: _joined_measured(known, count) for label, known in variants.items()}
            for id, variants in measured.items()
        },
        path_changes={
            id: {label: _joined_paths(known, count) for label, known in variants.items()}
            for id, variants in paths.items()
        },
    )


_Cycles = Int[np.ndarray, " _"]


def _by_variant(
    parts: Sequence[tuple[_Cycles, Mapping[str, Mapping[str, Any]]]],
) -> dict[str, dict[str, list[tuple[_Cycles, Any]]]]:
    """Collect the changes of each effect and variant, with the cycles over which they are known."""
    found: dict[str, dict[str, list[tuple[_Cycles, Any]]]] = {}
    for cycles, changes in parts:
        for id, variants in changes.items():
            for label, change in variants.items():
                found.setdefault(id, {}).setdefault(label, []).append((cycles, change))
    return found


def _joined_measured(known: Sequence[tuple[_Cycles, MeasuredChange]], count: int) -> MeasuredChange:
    # Row 0 of what `_select_joined` selects from is zero.
    rows, first = np.zeros(count, dtype=int), 1
    for cycles, _ in known:
        rows[cycles] = first + np.arange(len(cycles))
        first += len(cycles)
    return Partial(_select_joined, tuple(change for _, change in known), jnp.asarray(rows))


def _select_joined(
    changes: tuple[MeasuredChange, ...], rows: Int[Array, " trial"], effect_sizes: Float[Array, " parameter"]
) -> Float[Array, "trial coordinate frame"]:
    known = [change(effect_sizes) for change in changes]
    return jnp.concatenate([jnp.zeros_like(known[0][:1]), *known])[rows]


def _joined_paths(known: Sequence[tuple[_Cycles, PathState]], count: int) -> PathState:
    """Join derivatives of paths; leaves lead with ``muscle parameter trial``."""

    def join(*leaves: Array | np.ndarray) -> Array:
        joined = np.zeros((*leaves[0].shape[:2], count, *leaves[0].shape[3:]))
        for leaf, (cycles, _) in zip(leaves, known, strict=True):
            joined[:, :, cycles] = leaf
        return jnp.asarray(joined)

    joined: PathState = jax.tree.map(join, *(paths for _, paths in known))
    return joined
