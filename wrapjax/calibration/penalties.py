"""What a calibration avoids besides moment error.

Every penalty is the mean square of a quantity of each muscle, less its center, over an allowable
error: the allowable error is the weight. Some compare a muscle with the mean of its group.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.model.forward import MuscleState
from wrapjax.model.parameters import ModelParameters

#: Reads a quantity off one muscle: one number; one a frame, which may depend on the path at that frame
#: alone; one a frame and coordinate, which may depend on that coordinate's moment arm as well; or the
#: path's infeasibility, one a cylinder.
Reader = Callable[[ModelParameters, MuscleState], Float[Array, "..."]]
#: What of the quantity counts: a linear function of it.
Reduction = Callable[[Float[Array, "..."]], Float[Array, " value"]]


class Gram(eqx.Module):
    """Inner products of residuals' derivatives by local variables, where they are not zero."""

    #: Of every muscle with itself.
    own: Float[Array, "muscle local local"]
    #: Of the members of each group with one another: their numbers, and one block each.
    groups: tuple[tuple[tuple[int, ...], Float[Array, "_ _"]], ...] = ()


class AbstractPenalty(eqx.Module):
    """Sum of squares of what a quantity has that it should not have."""

    name: eqx.AbstractVar[str]
    read: eqx.AbstractVar[Reader]
    reduce: eqx.AbstractVar[Reduction]

    @abstractmethod
    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Turn the reduced quantity of all muscles into residuals."""

    @abstractmethod
    def gram(self, values: Float[Array, "muscle value"], slopes: Float[Array, "muscle local value"]) -> Gram:
        """Multiply the residuals' derivatives, given the reduced quantity and its derivatives."""

    def values(self, parameters: ModelParameters, states: MuscleState) -> Float[Array, "muscle value"]:
        """Read and reduce the quantity of all muscles."""
        return jax.vmap(lambda *muscle: self.reduce(self.read(*muscle)))(parameters, states)


class MusclePenalty(AbstractPenalty):
    """Each muscle on its own."""

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    reduce: Reduction = eqx.field(static=True)
    center: Float[Array, " muscle #value"]
    allowable_error: float = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Divide by the allowable error and the root of the number of values."""
        return (values - self.center) / (self.allowable_error * np.sqrt(values.size))

    def gram(self, values: Float[Array, "muscle value"], slopes: Float[Array, "muscle local value"]) -> Gram:
        """Muscles do not mix."""
        weight = 1.0 / (self.allowable_error**2 * values.size)
        return Gram(weight * jnp.einsum("mpk,mqk->mpq", slopes, slopes))


class SubsetPenalty(AbstractPenalty):
    """Some muscles, each on its own, about zero; the others do not count."""

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    reduce: Reduction = eqx.field(static=True)
    allowable_error: float = eqx.field(static=True)
    muscles: tuple[int, ...] = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Divide by the allowable error and the root of the number of values that count."""
        return self._weight(values) * values

    def gram(self, values: Float[Array, "muscle value"], slopes: Float[Array, "muscle local value"]) -> Gram:
        """Muscles do not mix."""
        weight = self._weight(values)[:, :, None] ** 2
        return Gram(weight * jnp.einsum("mpk,mqk->mpq", slopes, slopes))

    def _weight(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle 1"]:
        weight = np.zeros((values.shape[0], 1))
        weight[list(self.muscles)] = 1.0 / (
            self.allowable_error * np.sqrt(len(self.muscles) * values.shape[1])
        )
        return jnp.asarray(weight)


class GroupPenalty(AbstractPenalty):
    """Each muscle against the mean of its group; muscles in no group do not count."""

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    reduce: Reduction = eqx.field(static=True)
    center: Float[Array, " muscle #value"]
    allowable_error: float = eqx.field(static=True)
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Take the group means off, then divide as for single muscles."""
        change = values - self.center
        rows = jnp.zeros_like(change)
        for group in self.groups:
            members = np.array(group)
            rows = rows.at[members].set(change[members] - change[members].mean(axis=0, keepdims=True))
        return rows * self._weight(values)

    def gram(self, values: Float[Array, "muscle value"], slopes: Float[Array, "muscle local value"]) -> Gram:
        """Members of one group mix."""
        local = slopes.shape[1]
        blocks = []
        for group in self.groups:
            together = slopes[np.array(group)].reshape(-1, slopes.shape[-1])
            # Taking the mean off is a projection: its product with itself is itself.
            projection = np.eye(len(group)) - 1.0 / len(group)
            shares = self._weight(values) ** 2 * jnp.asarray(np.kron(projection, np.ones((local, local))))
            blocks.append((group, shares * (together @ together.T)))
        return Gram(jnp.zeros((slopes.shape[0], local, local)), tuple(blocks))

    def _weight(self, values: Float[Array, "muscle value"]) -> float:
        members = sum(len(group) for group in self.groups)
        return 1.0 / (self.allowable_error * np.sqrt(members * values.shape[1]))


class Limit(AbstractPenalty):
    """A quantity that must not exceed a bound, as one step of an augmented Lagrangian sees it.

    ``weight * max(0, excess + shift)**2``: raising the shift by the excess, again and again, makes
    ``2 * weight * shift`` the multiplier and the excess zero, whatever the weight (Hestenes 1969,
    doi:10.1007/BF00927673; Powell 1969).
    """

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    reduce: Reduction = eqx.field(static=True)
    #: The excess is ``factor * value - bound``.
    factor: Float[Array, " muscle #value"]
    bound: Float[Array, " muscle #value"]
    shift: Float[Array, "muscle value"]
    weight: Float[Array, "muscle value"]

    def excess(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Give how far values are above the bound; negative where they are below."""
        return self.factor * values - self.bound

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Give what is above the shifted bound."""
        return jnp.sqrt(self.weight) * jnp.maximum(self.excess(values) + self.shift, 0.0)

    def gram(self, values: Float[Array, "muscle value"], slopes: Float[Array, "muscle local value"]) -> Gram:
        """Only what is above the shifted bound counts."""
        above = self.weight * self.factor**2 * (self.excess(values) + self.shift > 0.0)
        return Gram(jnp.einsum("mpk,mqk,mk->mpq", slopes, slopes, above))


def whole(quantity: Float[Array, "*shape"]) -> Float[Array, " value"]:
    """Take every number of a quantity."""
    return quantity.ravel()


def overall_mean(quantity: Float[Array, "*shape"]) -> Float[Array, " value"]:
    """Take the mean over trials and frames."""
    return quantity.mean()[None]


def mean_over_trials(quantity: Float[Array, "trial frame"]) -> Float[Array, " value"]:
    """Take the mean cycle."""
    return quantity.mean(axis=0)


def without_mean(quantity: Float[Array, "trial frame"]) -> Float[Array, " value"]:
    """Take the shape: what is left without the overall mean."""
    return (quantity - quantity.mean()).ravel()


def normalized_length(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial frame"]:
    """Read fiber length in optimal fiber lengths."""
    return state.fiber.normalized_length


def _passive_force(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial frame"]:
    return state.fiber.passive_force


def _activation(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial frame"]:
    return state.activation


def _emg_scale(parameters: ModelParameters, state: MuscleState) -> Float[Array, ""]:
    return parameters.emg_scale


def _delay(parameters: ModelParameters, state: MuscleState) -> Float[Array, ""]:
    return parameters.electromechanical_delay


def pipeline_penalties(
    reference: MuscleState,
    activation_groups: Sequence[Sequence[int]],
    fiber_length_groups: Sequence[Sequence[int]],
    extrapolated: Sequence[int] = (),
) -> tuple[AbstractPenalty, ...]:
    """Build the NMSM Pipeline's penalties that are not priors on single parameters.

    Normalised fiber lengths stay near the reference in mean (0.1) and in shape (0.1) and alike within
    groups (0.05, in mean and in shape); passive forces stay small (50 N); EMG scales (0.1) and delays
    (20 ms) are alike within groups; activations that no EMG vouches for stay small (0.3).

    Parameters
    ----------
    reference
        States of all muscles before calibration.
    activation_groups, fiber_length_groups
        Lists of muscle indices.
    extrapolated
        Muscles without a channel.
    """
    length = reference.fiber.normalized_length  # (muscle, trial, frame)
    muscles = length.shape[0]
    nothing = jnp.zeros((muscles, 1))
    overall = length.mean(axis=(1, 2))[:, None]
    shape = (length - overall[:, :, None]).reshape(muscles, -1)
    mean = length.mean(axis=1)
    penalties: list[AbstractPenalty] = [
        MusclePenalty("normalized_fiber_length_mean", normalized_length, mean_over_trials, mean, 0.1),
        MusclePenalty("normalized_fiber_length_shape", normalized_length, without_mean, shape, 0.1),
        MusclePenalty("passive_force", _passive_force, whole, nothing, 50.0),
    ]
    similar = tuple(tuple(group) for group in fiber_length_groups)
    if similar:
        penalties += [
            GroupPenalty(
                "grouped_fiber_length_mean", normalized_length, overall_mean, overall, 0.05, similar
            ),
            GroupPenalty(
                "grouped_fiber_length_shape", normalized_length, without_mean, nothing, 0.05, similar
            ),
        ]
    together = tuple(tuple(group) for group in activation_groups)
    if together:
        penalties += [
            GroupPenalty("grouped_emg_scale", _emg_scale, whole, nothing, 0.1, together),
            GroupPenalty("grouped_delay", _delay, whole, nothing, 0.02, together),
        ]
    if extrapolated:
        chosen = tuple(extrapolated)
        penalties.append(SubsetPenalty("extrapolated_activation", _activation, whole, 0.3, chosen))
    return tuple(penalties)
