"""Limits on quantities of muscles about a point, from which a solver foresees which ones a step exceeds."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.penalties import Limit, weighted_products
from wrapjax.calibration.solvers.interface import AbstractLinearizedLimits
from wrapjax.model.variables import LocalBlocks, Variables


class MuscleLimits(AbstractLinearizedLimits):
    """Limits on quantities of muscles, each of which depends on the local variables of one muscle.

    The rows are limit after limit, and in each ``muscle value``.
    """

    excess: Float[Array, " row"]
    weight: Float[Array, " row"]
    #: By limit: factor that turns a change of the limited quantity into one of the excess.
    factors: tuple[Float[Array, "muscle _"], ...]
    #: By quantity: derivatives by the local variables of each muscle.
    slopes: tuple[LocalBlocks, ...]
    #: By limit: which quantity it limits. Upper and lower limits on one quantity share its derivatives.
    quantities: tuple[int, ...] = eqx.field(static=True)
    variables: Variables

    def change(self, move: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute the change of the excess by a move."""
        local = self.variables.scatter(move)
        changes = []
        for slopes in self.slopes:
            change = jnp.zeros(self._shape(slopes))
            for batch, own, slope in zip(local.batches, local.parts, slopes.parts, strict=True):
                change = change.at[np.array(batch.muscles)].set(jnp.einsum("mp,mpk->mk", own, slope))
            changes.append(change)
        by_limit = zip(self.factors, self.quantities, strict=True)
        return jnp.concatenate([(factor * changes[place]).ravel() for factor, place in by_limit])

    def gradient(self, multipliers: Float[Array, " row"]) -> Float[Array, " variable"]:
        """Compute the sum of the gradients of the excesses, times multipliers."""
        first, *others = [
            slopes.map(lambda slope, own: jnp.einsum("mk,mpk->mp", own, slope)[..., None], own)
            for slopes, own in zip(self.slopes, self._by_quantity(multipliers, power=1), strict=True)
        ]
        return self.variables.gather(sum(others, start=first))[:, 0]

    def gram(self, weights: Float[Array, " row"]) -> Float[Array, "variable variable"]:
        """Compute the sum of the outer products of the gradients of the excesses, times weights."""
        first, *others = map(weighted_products, self.slopes, self._by_quantity(weights, power=2))
        return self.variables.assemble(sum(others, start=first))

    def _shape(self, slopes: LocalBlocks) -> tuple[int, int]:
        return self.variables.index.shape[0], slopes.parts[0].shape[-1]

    def _by_quantity(self, rows: Float[Array, " row"], power: int) -> list[Float[Array, "muscle _"]]:
        """Sum rows, times a power of the factors, over the limits on each quantity."""
        shapes = [self._shape(self.slopes[place]) for place in self.quantities]
        ends = np.cumsum([muscles * values for muscles, values in shapes])
        totals = [jnp.zeros(self._shape(slopes)) for slopes in self.slopes]
        parts = zip(self.quantities, self.factors, jnp.split(rows, ends[:-1]), shapes, strict=True)
        for place, factor, own, shape in parts:
            totals[place] += factor**power * own.reshape(shape)
        return totals


def muscle_limits(
    limits: Sequence[Limit],
    values: Sequence[Float[Array, "muscle _"]],
    slopes: Sequence[LocalBlocks],
    variables: Variables,
) -> MuscleLimits | None:
    """Linearise limits.

    Parameters
    ----------
    limits
        Limits with their shifts and weights.
    values, slopes
        Values of the limited quantities, and their derivatives by local variables.
    variables
        Variables of the problem.

    Returns
    -------
    MuscleLimits or None
        None if there are no limits.
    """
    if not limits:
        return None
    excess = [limit.excess(value) + limit.shift for limit, value in zip(limits, values, strict=True)]
    keys = [(limit.read, limit.reduce) for limit in limits]
    distinct = list(dict.fromkeys(keys))
    return MuscleLimits(
        excess=jnp.concatenate([own.ravel() for own in excess]),
        weight=jnp.concatenate([limit.weight.ravel() for limit in limits]),
        factors=tuple(limit.factor for limit in limits),
        slopes=tuple(slopes[keys.index(key)] for key in distinct),
        quantities=tuple(distinct.index(key) for key in keys),
        variables=variables,
    )
