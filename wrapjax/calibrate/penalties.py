"""What a calibration avoids besides moment error.

Every penalty is the mean square of a quantity of each muscle, less its center, over an allowable
error: the allowable error is the weight. Some compare a muscle with the mean of its group.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.model import ModelParameters, MuscleState

#: Reads a quantity (any number of values) off one muscle.
Reader = Callable[[ModelParameters, MuscleState], Float[Array, " value"]]


class AbstractPenalty(eqx.Module):
    """Mean square of a quantity about its center, in allowable errors."""

    name: eqx.AbstractVar[str]
    read: eqx.AbstractVar[Reader]

    @abstractmethod
    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Turn the quantity of all muscles into residuals; their sum of squares is the penalty."""

    @abstractmethod
    def gram(self, slopes: Float[Array, "muscle local value"]) -> Float[Array, "muscle local muscle local"]:
        """Inner products of the residuals' derivatives, given the derivatives of the quantity."""


class MusclePenalty(AbstractPenalty):
    """Each muscle on its own."""

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    center: Float[Array, " muscle #value"]
    allowable_error: float = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Divide by the allowable error and the root of the number of values."""
        return (values - self.center) / (self.allowable_error * np.sqrt(values.size))

    def gram(self, slopes: Float[Array, "muscle local value"]) -> Float[Array, "muscle local muscle local"]:
        """Muscles do not mix: only the diagonal blocks are filled."""
        muscles, local, values = slopes.shape
        weight = 1.0 / (self.allowable_error**2 * muscles * values)
        blocks = weight * jnp.einsum("mpk,mqk->mpq", slopes, slopes)
        each = np.arange(muscles)
        return jnp.zeros((muscles, local, muscles, local)).at[each, :, each, :].set(blocks)


class GroupPenalty(AbstractPenalty):
    """Each muscle against the mean of its group; muscles in no group do not count."""

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    center: Float[Array, " muscle #value"]
    allowable_error: float = eqx.field(static=True)
    #: Takes the group's mean off its members and everything off the others. A projection.
    deviation: Float[np.ndarray, "muscle muscle"]
    members: int = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Take the group means off, then divide as for single muscles."""
        scale = self.allowable_error * np.sqrt(self.members * values.shape[1])
        return self.deviation @ (values - self.center) / scale

    def gram(self, slopes: Float[Array, "muscle local value"]) -> Float[Array, "muscle local muscle local"]:
        """Members of one group mix."""
        weight = 1.0 / (self.allowable_error**2 * self.members * slopes.shape[2])
        products = jnp.einsum("mpk,nqk->mpnq", slopes, slopes)
        return weight * products * self.deviation[:, None, :, None]


def group_penalty(
    name: str,
    read: Reader,
    center: Float[Array, " muscle #value"],
    allowable_error: float,
    groups: Sequence[Sequence[int]],
) -> GroupPenalty:
    """Build a penalty on deviations from group means; groups are lists of muscle indices."""
    muscles = center.shape[0]
    deviation = np.zeros((muscles, muscles))
    for group in groups:
        place = np.ix_(group, group)
        deviation[place] = np.eye(len(group)) - 1.0 / len(group)
    return GroupPenalty(
        name, read, center, allowable_error, deviation, members=sum(len(group) for group in groups)
    )


def _mean_length(parameters: ModelParameters, state: MuscleState) -> Float[Array, " value"]:
    return state.fiber.normalized_length.mean(axis=0)


def _length_shape(parameters: ModelParameters, state: MuscleState) -> Float[Array, " value"]:
    length = state.fiber.normalized_length
    return (length - length.mean()).ravel()


def _passive_force(parameters: ModelParameters, state: MuscleState) -> Float[Array, " value"]:
    return state.fiber.passive_force.ravel()


def _overall_length(parameters: ModelParameters, state: MuscleState) -> Float[Array, " value"]:
    return state.fiber.normalized_length.mean()[None]


def _emg_scale(parameters: ModelParameters, state: MuscleState) -> Float[Array, " value"]:
    return parameters.emg_scale[None]


def _delay(parameters: ModelParameters, state: MuscleState) -> Float[Array, " value"]:
    return parameters.electromechanical_delay[None]


def pipeline_penalties(
    reference: MuscleState,
    activation_groups: Sequence[Sequence[int]],
    fiber_length_groups: Sequence[Sequence[int]],
) -> tuple[AbstractPenalty, ...]:
    """Build the NMSM Pipeline's penalties that are not priors on single parameters.

    Normalised fiber lengths stay near the reference in mean (0.1) and in shape (0.1) and alike within
    groups (0.05, in mean and in shape); passive forces stay small (50 N); EMG scales (0.1) and delays
    (20 ms) are alike within groups.

    Parameters
    ----------
    reference
        States of all muscles before calibration.
    activation_groups, fiber_length_groups
        Lists of muscle indices.
    """
    length = reference.fiber.normalized_length  # (muscle, trial, frame)
    muscles = length.shape[0]
    nothing = jnp.zeros((muscles, 1))
    overall = length.mean(axis=(1, 2))[:, None]
    shape = length - overall[:, :, None]
    penalties: list[AbstractPenalty] = [
        MusclePenalty("normalized_fiber_length_mean", _mean_length, length.mean(axis=1), 0.1),
        MusclePenalty("normalized_fiber_length_shape", _length_shape, shape.reshape(muscles, -1), 0.1),
        MusclePenalty("passive_force", _passive_force, nothing, 50.0),
    ]
    if fiber_length_groups:
        penalties += [
            group_penalty("grouped_fiber_length_mean", _overall_length, overall, 0.05, fiber_length_groups),
            group_penalty("grouped_fiber_length_shape", _length_shape, nothing, 0.05, fiber_length_groups),
        ]
    if activation_groups:
        penalties += [
            group_penalty("grouped_emg_scale", _emg_scale, nothing, 0.1, activation_groups),
            group_penalty("grouped_delay", _delay, nothing, 0.02, activation_groups),
        ]
    return tuple(penalties)
