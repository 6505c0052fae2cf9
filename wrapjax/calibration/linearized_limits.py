"""Limits on quantities of muscles about a point, from which a solver foresees which ones a step exceeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

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
    #: By limit: derivatives of the limited quantity by the local variables of each muscle, and factor that
    #: turns them into derivatives of the excess.
    slopes: tuple[LocalBlocks, ...]
    factors: tuple[Float[Array, "muscle _"], ...]
    variables: Variables

    def change(self, move: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute the change of the excess by a move."""
        local = self.variables.scatter(move)
        changes = []
        for slopes, factor in zip(self.slopes, self.factors, strict=True):
            values = slopes.parts[0].shape[-1]
            change = jnp.zeros((len(factor), values))
            for batch, own, slope in zip(local.batches, local.parts, slopes.parts, strict=True):
                change = change.at[np.array(batch.muscles)].set(jnp.einsum("mp,mpk->mk", own, slope))
            changes.append((factor * change).ravel())
        return jnp.concatenate(changes)

    def gradient(self, multipliers: Float[Array, " row"]) -> Float[Array, " variable"]:
        """Compute the sum of the gradients of the excesses, times multipliers."""
        blocks = self._sum(
            lambda slopes, own: slopes.map(
                lambda slope, own: jnp.einsum("mk,mpk->mp", own, slope)[..., None], own
            ),
            [factor * own for factor, own in zip(self.factors, self._by_limit(multipliers), strict=True)],
        )
        return self.variables.gather(blocks)[:, 0]

    def gram(self, weights: Float[Array, " row"]) -> Float[Array, "variable variable"]:
        """Compute the sum of the outer products of the gradients of the excesses, times weights."""
        weighted = [
            factor**2 * own for factor, own in zip(self.factors, self._by_limit(weights), strict=True)
        ]
        return self.variables.assemble(self._sum(weighted_products, weighted))

    def _by_limit(self, rows: Float[Array, " row"]) -> list[Float[Array, "muscle _"]]:
        """Divide an array of rows into those of each limit."""
        shapes = [
            (len(factor), one.parts[0].shape[-1])
            for one, factor in zip(self.slopes, self.factors, strict=True)
        ]
        ends = np.cumsum([muscles * values for muscles, values in shapes])
        parts = jnp.split(rows, ends[:-1])
        return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]

    def _sum(self, function: Callable[..., LocalBlocks], by_limit: Sequence[Array]) -> LocalBlocks:
        first, *others = map(function, self.slopes, by_limit)
        return sum(others, start=first)


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
    return MuscleLimits(
        excess=jnp.concatenate([own.ravel() for own in excess]),
        weight=jnp.concatenate([limit.weight.ravel() for limit in limits]),
        slopes=tuple(slopes),
        factors=tuple(limit.factor for limit in limits),
        variables=variables,
    )
