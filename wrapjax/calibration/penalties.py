"""Penalty terms and hard limits of the calibration's objective.

A penalty is the mean square of ``(quantity - center) / allowable_error`` over muscles and the quantity's
values; the allowable error determines its weight. Group penalties compare each muscle with the mean of its
group. The allowable errors are those of the NMSM Pipeline. Priors on single parameters (the electromechanical
delay, for example) are in `wrapjax.model.freedom`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.model.forward import MuscleState
from wrapjax.model.parameters import ModelParameters
from wrapjax.model.variables import LocalBlocks

#: Function from the parameters and state of one muscle to a quantity: one number; one per frame, which may
#: depend on the path in that frame alone; one per frame and coordinate, which may depend on the moment arm
#: about that coordinate as well; or the infeasibility of the path, one per wrap.
Reader = Callable[[ModelParameters, MuscleState], Float[Array, "..."]]
#: Linear function of the quantity whose values are penalised.
Reduction = Callable[[Float[Array, "..."]], Float[Array, " value"]]

# Number of a muscle's weighted values that are multiplied at a time.
_FEW = 256


class Gram(eqx.Module):
    """Nonzero blocks of ``J'J``, with J the Jacobian of residuals by the local variables of the muscles."""

    #: Diagonal block of every muscle; None for zeros.
    own: LocalBlocks | None
    #: Block of each group of muscles: the indices of its members, and the block of their local variables.
    groups: tuple[tuple[tuple[int, ...], Float[Array, "_ _"]], ...] = ()


class AbstractPenalty(eqx.Module):
    """Sum of squares of a function of muscle quantities, a term of the objective."""

    name: eqx.AbstractVar[str]
    read: eqx.AbstractVar[Reader]
    reduce: eqx.AbstractVar[Reduction]

    @abstractmethod
    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Compute the residuals from the reduced quantity of all muscles."""

    @abstractmethod
    def gram_matrix(self, values: Float[Array, "muscle value"], slopes: LocalBlocks) -> Gram:
        """Compute ``J'J`` of the residuals from the reduced quantity and its derivatives."""

    def values(self, parameters: ModelParameters, states: MuscleState) -> Float[Array, "muscle value"]:
        """Compute the reduced quantity of all muscles."""
        return jax.vmap(lambda *muscle: self.reduce(self.read(*muscle)))(parameters, states)


class MusclePenalty(AbstractPenalty):
    """Penalty on the difference of each muscle's quantity from a center."""

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    reduce: Reduction = eqx.field(static=True)
    center: Float[Array, " muscle #value"]
    allowable_error: float = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Divide by the allowable error and the root of the number of values."""
        return (values - self.center) / (self.allowable_error * np.sqrt(values.size))

    def gram_matrix(self, values: Float[Array, "muscle value"], slopes: LocalBlocks) -> Gram:
        """Compute one block per muscle."""
        weight = 1.0 / (self.allowable_error**2 * values.size)
        return Gram(slopes.map(lambda own: weight * _squares(own)))


class SubsetPenalty(AbstractPenalty):
    """Penalty on the quantity of some muscles, with center zero."""

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    reduce: Reduction = eqx.field(static=True)
    allowable_error: float = eqx.field(static=True)
    muscles: tuple[int, ...] = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Divide by the allowable error and the root of the number of penalised values."""
        return self._weight(values) * values

    def gram_matrix(self, values: Float[Array, "muscle value"], slopes: LocalBlocks) -> Gram:
        """Compute one block per muscle."""
        weight = self._weight(values)[:, :, None] ** 2
        return Gram(slopes.map(lambda own, weight: weight * _squares(own), weight))

    def _weight(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle 1"]:
        weight = np.zeros((values.shape[0], 1))
        weight[list(self.muscles)] = 1.0 / (
            self.allowable_error * np.sqrt(len(self.muscles) * values.shape[1])
        )
        return jnp.asarray(weight)


class GroupPenalty(AbstractPenalty):
    """Penalty on the difference of each muscle's quantity, less its center, from the mean of its group.

    Muscles in no group are not penalised.
    """

    name: str = eqx.field(static=True)
    read: Reader = eqx.field(static=True)
    reduce: Reduction = eqx.field(static=True)
    center: Float[Array, " muscle #value"]
    allowable_error: float = eqx.field(static=True)
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Subtract group means, and divide by the allowable error and the root of the number of values."""
        change = values - self.center
        rows = jnp.zeros_like(change)
        for group in self.groups:
            members = np.array(group)
            rows = rows.at[members].set(change[members] - change[members].mean(axis=0, keepdims=True))
        return rows * self._weight(values)

    def gram_matrix(self, values: Float[Array, "muscle value"], slopes: LocalBlocks) -> Gram:
        """Compute one block per group; the muscles of a group are coupled."""
        blocks = []
        for group in self.groups:
            by_muscle = [slopes.of_muscle(muscle) for muscle in group]
            group_slopes = jnp.concatenate(by_muscle)
            member = np.repeat(np.arange(len(group)), [len(one) for one in by_muscle])
            # Subtraction of the mean is a projection, so its square is itself.
            projection = np.eye(len(group)) - 1.0 / len(group)
            shares = self._weight(values) ** 2 * jnp.asarray(projection[member[:, None], member])
            blocks.append((group, shares * (group_slopes @ group_slopes.T)))
        return Gram(None, tuple(blocks))

    def _weight(self, values: Float[Array, "muscle value"]) -> float:
        members = sum(len(group) for group in self.groups)
        return 1.0 / (self.allowable_error * np.sqrt(members * values.shape[1]))


class Limit(AbstractPenalty):
    """Upper limit on a quantity of each muscle, as a term of an augmented Lagrangian.

    The term is ``weight * max(0, excess + shift)**2``. Repeatedly increasing the shift by the excess makes
    ``2 * weight * shift`` converge to the multiplier and the excess to zero, for any weight (Hestenes 1969,
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
        """Compute the excess of values over the bound; negative below it."""
        return self.factor * values - self.bound

    def rows(self, values: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
        """Compute the weighted excess over the shifted bound; zero below it."""
        return jnp.sqrt(self.weight) * jnp.maximum(self.excess(values) + self.shift, 0.0)

    def gram_matrix(self, values: Float[Array, "muscle value"], slopes: LocalBlocks) -> Gram:
        """Compute one block per muscle from the values above the shifted bound."""
        above = self.weight * self.factor**2 * (self.excess(values) + self.shift > 0.0)
        return Gram(weighted_products(slopes, above))


def weighted_products(slopes: LocalBlocks, weights: Float[Array, "muscle value"]) -> LocalBlocks:
    """Sum products of derivatives by two local variables over a muscle's values, times mostly zero weights.

    Only values with a weight are multiplied, a few at a time, because few limits are exceeded.
    """
    values = weights.shape[1]
    few = min(_FEW, values)
    number = jnp.cumsum(weights != 0.0, axis=1)

    def add_products(carry: tuple[Int[Array, ""], LocalBlocks]) -> tuple[Int[Array, ""], LocalBlocks]:
        done, total = carry
        wanted = done + 1 + jnp.arange(few)
        places = jax.vmap(lambda own: jnp.searchsorted(own, wanted))(number)
        inside = jnp.minimum(places, values - 1)
        chosen = jnp.where(places < values, jnp.take_along_axis(weights, inside, axis=1), 0.0)
        products = slopes.map(
            lambda slope, place, own: _squares(
                jnp.take_along_axis(slope, place[:, None], axis=2), own[:, None]
            ),
            inside,
            chosen,
        )
        return done + few, total + products

    nothing = slopes.map(lambda own: jnp.zeros((*own.shape[:2], own.shape[1])))
    start = jnp.zeros((), number.dtype), nothing
    most = number[:, -1].max()
    return jax.lax.while_loop(lambda carry: carry[0] < most, add_products, start)[1]


def _squares(
    slopes: Float[Array, "muscle local value"], weight: Float[Array, "muscle 1 value"] | float = 1.0
) -> Float[Array, "muscle local local"]:
    """Sum the weighted products of derivatives by two local entries over the values of each muscle."""
    return jnp.einsum("mpk,mqk->mpq", slopes * weight, slopes)


def flatten(quantity: Float[Array, "*shape"]) -> Float[Array, " value"]:
    """Use every value of the quantity."""
    return quantity.ravel()


@dataclass(frozen=True)
class SomeTrials:
    """Use the values of the quantity in some trials."""

    trials: tuple[int, ...]

    def __call__(self, quantity: Float[Array, "trial frame"]) -> Float[Array, " value"]:
        """Select the trials, and flatten."""
        return quantity[np.array(self.trials)].ravel()


def mean_over_trials_and_frames(quantity: Float[Array, "*shape"]) -> Float[Array, " value"]:
    """Compute the mean over trials and frames."""
    return quantity.mean()[None]


def mean_over_trials(quantity: Float[Array, "trial frame"]) -> Float[Array, " value"]:
    """Compute the mean over trials, frame by frame."""
    return quantity.mean(axis=0)


def subtract_mean(quantity: Float[Array, "trial frame"]) -> Float[Array, " value"]:
    """Subtract the mean over trials and frames: the shape of the curves."""
    return (quantity - quantity.mean()).ravel()


def normalized_length(parameters: ModelParameters, state: MuscleState) -> Float[Array, "trial frame"]:
    """Return the normalised fiber length."""
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
    relaxed: Sequence[int] = (),
) -> tuple[AbstractPenalty, ...]:
    """Build the penalties of the NMSM Pipeline, except priors on single parameters.

    Allowable errors are in parentheses. Penalised are: the difference of normalised fiber lengths from the
    reference in mean (0.1) and shape (0.1); the passive force (50 N); differences within groups of the mean
    and shape of normalised fiber lengths (0.05 each), of EMG scales (0.1) and of delays (20 ms); and the
    activation of muscles without EMG (0.3).

    Parameters
    ----------
    reference
        States of all muscles before calibration.
    activation_groups, fiber_length_groups
        Groups of muscles that are expected to be similar, as muscle indices.
    extrapolated
        Indices of the muscles without an EMG channel.
    relaxed
        Indices of the passive trials. Their passive forces are measured, and not penalised.

    Returns
    -------
    tuple of AbstractPenalty
        Penalties with nonempty groups.
    """
    length = reference.fiber.normalized_length  # (muscle, trial, frame)
    muscles = length.shape[0]
    zero = jnp.zeros((muscles, 1))
    overall = length.mean(axis=(1, 2))[:, None]
    shape = (length - overall[:, :, None]).reshape(muscles, -1)
    mean = length.mean(axis=1)
    penalties: list[AbstractPenalty] = [
        MusclePenalty("normalized_fiber_length_mean", normalized_length, mean_over_trials, mean, 0.1),
        MusclePenalty("normalized_fiber_length_shape", normalized_length, subtract_mean, shape, 0.1),
    ]
    trials = length.shape[1]
    if not relaxed:
        penalties.append(MusclePenalty("passive_force", _passive_force, flatten, zero, 50.0))
    elif len(relaxed) < trials:
        active = SomeTrials(tuple(trial for trial in range(trials) if trial not in relaxed))
        penalties.append(MusclePenalty("passive_force", _passive_force, active, zero, 50.0))
    length_groups = tuple(tuple(group) for group in fiber_length_groups)
    if length_groups:
        penalties += [
            GroupPenalty(
                "grouped_fiber_length_mean",
                normalized_length,
                mean_over_trials_and_frames,
                overall,
                0.05,
                length_groups,
            ),
            GroupPenalty(
                "grouped_fiber_length_shape", normalized_length, subtract_mean, zero, 0.05, length_groups
            ),
        ]
    excitation_groups = tuple(tuple(group) for group in activation_groups)
    if excitation_groups:
        penalties += [
            GroupPenalty("grouped_emg_scale", _emg_scale, flatten, zero, 0.1, excitation_groups),
            GroupPenalty("grouped_delay", _delay, flatten, zero, 0.02, excitation_groups),
        ]
    if extrapolated:
        chosen = tuple(extrapolated)
        penalties.append(SubsetPenalty("extrapolated_activation", _activation, flatten, 0.3, chosen))
    return tuple(penalties)
