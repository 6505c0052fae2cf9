"""What effects need to know of a subject and its recorded cycles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.geometry.paths import PathState
from wrapjax.model.parameters import ModelParameters
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles
from wrapjax.subject.muscle_groups import standard_name

Kinematics = Float[np.ndarray, "trial coordinate frame"]
#: From amounts of an effect to what it adds to the prediction of measured moments, N m.
MeasuredChange = Callable[[Float[Array, " parameter"]], Float[Array, "trial coordinate frame"]]


def change_id(effect: str, shape: str) -> str:
    """Name what a shape of an effect adds to measured moments and paths (`Context.measured_changes`).

    The one shape of an effect may have no name.
    """
    return f"{effect}, {shape}" if shape else effect


def known_shape(id: str, effect: str) -> str | None:
    """Undo `change_id`: name the shape, or say by None that it is another effect's."""
    own, _, shape = id.partition(", ")
    return shape if own == effect else None


class PathChanges(eqx.Module):
    """Amounts that change paths, each of one or several muscles."""

    #: From every muscle's own changes to all paths (`AbstractPath.at`).
    paths: Callable[[Float[Array, "muscle mode"]], PathState]
    #: Which amount stands at each place of a muscle's changes; -1 for none.
    places: Int[np.ndarray, "muscle mode"]
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    prior_sd: tuple[float, ...] = eqx.field(static=True)


@dataclass(frozen=True)
class AtBound:
    """A calibrated parameter that stands at a bound.

    Parameters
    ----------
    muscle, parameter
        Whose, and which leaf of `ModelParameters`.
    outward
        1 at the upper bound, -1 at the lower.
    prior_sd
        How far beyond the bound it might want to be, in the leaf's unit.
    unit
        Of the leaf.
    limit
        How far beyond the bound it may go and still make sense.
    """

    muscle: str
    parameter: str
    outward: int
    prior_sd: float
    unit: str
    limit: float = np.inf


@dataclass(frozen=True)
class Context:
    """A subject's cycles as effects see them.

    Parameters
    ----------
    muscles
        Names, in the order of the model's axis ``muscle``.
    channels, muscle_channels
        Names of the EMG channels, and which of them drives each muscle.
    coordinates
        Whose moments are matched.
    trials
        Names of the cycles.
    angles, velocities
        Of these coordinates, rad and rad/s.
    step
        Time between frames of each cycle, s.
    speeds
        Of walking, m/s; NaN where unknown.
    order
        When each cycle was recorded: 0 for the first, 1 for the last.
    padding
        Frames of EMG before and after each cycle.
    parameters
        At which effects are off: where thresholds and normalisations are read off the model.
    paths
        As the plain model has them.
    paretic
        Whether the leg is; None if unknown.
    others
        Muscles without EMG, where there are any whose paths are known.
    no_others
        Why there are none.
    paths_by_angle
        How paths change with each joint angle (rad), where that is known; leaves lead with
        ``muscle coordinate``.
    wraps, attachments
        How paths follow their cylinders, and their muscles' ends, where that is known.
    at_bounds
        Parameters at their bounds.
    path_changes
        By the id of an effect on the measurement chain that misplaces joints or angles, or of one of its
        shapes (`change_id`): what a unit of each of its amounts adds to the recorded paths to give those that
        muscles took; leaves lead with ``muscle parameter``. An effect without them changes moments alone.
    measured_changes
        By the id of an effect on the measurement chain, or of one of its shapes (`change_id`): what its
        amounts add to the prediction of what is measured, through the exact change of inverse dynamics (see
        `effects.measurement`).
    no_measured_changes
        Why there are none.
    whole
        The context that this one is a part of; None for one that is whole.
    """

    muscles: tuple[str, ...]
    channels: tuple[str, ...]
    muscle_channels: tuple[int, ...]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    angles: Kinematics
    velocities: Kinematics
    step: Float[np.ndarray, " trial"]
    speeds: Float[np.ndarray, " trial"]
    order: Float[np.ndarray, " trial"]
    padding: int
    parameters: ModelParameters
    paths: PathState
    paretic: bool | None = None
    others: UndrivenMuscles | None = None
    no_others: str = "every muscle of this leg has an EMG channel"
    paths_by_angle: PathState | None = None
    wraps: PathChanges | None = None
    attachments: PathChanges | None = None
    at_bounds: tuple[AtBound, ...] = ()
    path_changes: Mapping[str, PathState] = field(default_factory=dict)
    measured_changes: Mapping[str, MeasuredChange] = field(default_factory=dict)
    no_measured_changes: str = "no ground reaction forces are given for these trials"
    whole: Context | None = None

    @property
    def reference(self) -> Context:
        """All cycles: what every effect is normalised by, so that an amount means one thing everywhere."""
        return self if self.whole is None else self.whole

    @property
    def duration(self) -> Float[np.ndarray, " trial"]:
        """Time of each cycle, s."""
        return self.step * (self.angles.shape[-1] - 1)

    @property
    def phase(self) -> Float[np.ndarray, " frame"]:
        """0 at the start of a cycle, 1 at its end."""
        return np.linspace(0.0, 1.0, self.angles.shape[-1])

    def muscle_rows(self, names: Sequence[str]) -> list[int]:
        """Number the muscles of these names without side (see `anatomy.standard_name`) that there are."""
        return [row for row, muscle in enumerate(self.muscles) if standard_name(muscle) in names]

    def coordinate(self, stem: str) -> int | None:
        """Number the coordinate whose name starts so (``ankle_angle``); None where there is none."""
        return next((row for row, name in enumerate(self.coordinates) if name.startswith(stem)), None)

    def select(self, trials: Sequence[int]) -> Context:
        """Keep some cycles; amounts of effects go on to mean what they mean of all."""
        chosen = np.asarray(trials, dtype=int)
        keep = jnp.asarray(chosen)

        def cut(paths: PathState) -> PathState:
            return _of_trials(paths, keep)

        return replace(
            self,
            trials=tuple(self.trials[number] for number in chosen),
            angles=self.angles[chosen],
            velocities=self.velocities[chosen],
            step=self.step[chosen],
            speeds=self.speeds[chosen],
            order=self.order[chosen],
            paths=cut(self.paths),
            others=None
            if self.others is None
            else eqx.tree_at(lambda tree: tree.path, self.others, cut(self.others.path)),
            paths_by_angle=None
            if self.paths_by_angle is None
            else _slopes_of_trials(self.paths_by_angle, keep),
            wraps=_cut_changes(self.wraps, keep),
            attachments=_cut_changes(self.attachments, keep),
            path_changes={id: _slopes_of_trials(slopes, keep) for id, slopes in self.path_changes.items()},
            measured_changes={
                name: jax.tree_util.Partial(_chosen_trials, change, keep)
                for name, change in self.measured_changes.items()
            },
            whole=self.reference,
        )


def _of_trials(paths: PathState, keep: Int[Array, " trial"]) -> PathState:
    """Keep cycles of paths; the axis ``trial`` is the second."""
    return PathState(
        *(jnp.asarray(leaf)[:, keep] for leaf in (paths.length, paths.velocity, paths.moment_arm))
    )


def _slopes_of_trials(slopes: PathState, keep: Int[Array, " trial"]) -> PathState:
    """Keep cycles of how paths change with several things; the axis ``trial`` is the third."""
    cut: PathState = jax.tree.map(lambda leaf: leaf[:, :, keep], slopes)
    return cut


def _of_trials_at(
    paths: Callable[[Float[Array, "muscle mode"]], PathState],
    keep: Int[Array, " trial"],
    changes: Float[Array, "muscle mode"],
) -> PathState:
    return _of_trials(paths(changes), keep)


def _cut_changes(changes: PathChanges | None, keep: Int[Array, " trial"]) -> PathChanges | None:
    if changes is None:
        return None
    part = jax.tree_util.Partial(_of_trials_at, changes.paths, keep)
    return eqx.tree_at(lambda tree: tree.paths, changes, part)


def _chosen_trials(
    change: MeasuredChange, keep: Int[Array, " trial"], effect_sizes: Float[Array, " parameter"]
) -> Float[Array, "trial coordinate frame"]:
    return change(effect_sizes)[keep]
