"""Paths that follow their cylinders through polynomials: the two-level surrogate of Ao, Fregly et al."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.geometry.feasibility import Feasibility
from wrapjax.geometry.inner_level import InnerLevel
from wrapjax.geometry.paths import AbstractPath, PathState
from wrapjax.geometry.surfaces import NOMINAL, WRAP_PARAMETERS

_PER_WRAP = len(WRAP_PARAMETERS)
# What a cylinder that nothing limits counts as: well within.
_FREE = -1.0


class PlacedLimits(eqx.Module):
    """The feasibility of cylinders, each read off one of the muscles that wrap round it."""

    #: Which muscle, and which of its cylinders.
    muscles: Int[np.ndarray, " limit"]
    places: Int[np.ndarray, " limit"]
    #: Leaves lead with ``limit``.
    feasibility: Feasibility

    def excess(self, changes: Float[Array, "muscle mode"], wraps: int) -> Float[Array, "muscle wrap"]:
        """Give how far each cylinder is beyond its limit; those without one are well within."""
        changed = changes.reshape(-1, wraps, _PER_WRAP)
        own = changed[self.muscles, self.places] + jnp.asarray(NOMINAL)[None]
        excess = jax.vmap(Feasibility.excess)(self.feasibility, own)
        return jnp.full(changed.shape[:2], _FREE).at[self.muscles, self.places].set(excess)

    def slopes(self, changes: Float[Array, "muscle mode"], wraps: int) -> Float[Array, "muscle mode wrap"]:
        """Differentiate it by each muscle's own changes."""
        changed = changes.reshape(-1, wraps, _PER_WRAP)
        own = changed[self.muscles, self.places] + jnp.asarray(NOMINAL)[None]
        slopes = jax.vmap(jax.grad(Feasibility.excess, argnums=1))(self.feasibility, own)
        nothing = jnp.zeros((*changed.shape, wraps))
        placed = nothing.at[self.muscles, self.places, :, self.places].set(slopes)
        return placed.reshape(*changes.shape, wraps)

    def curvature(
        self, changes: Float[Array, "muscle mode"], weights: Float[Array, "muscle wrap"]
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate it twice, and sum with these weights."""
        wraps = weights.shape[1]
        changed = changes.reshape(-1, wraps, _PER_WRAP)
        own = changed[self.muscles, self.places] + jnp.asarray(NOMINAL)[None]
        hessians = jax.vmap(jax.hessian(Feasibility.excess, argnums=1))(self.feasibility, own)
        weighted = weights[self.muscles, self.places, None, None] * hessians
        nothing = jnp.zeros((len(changed), wraps, wraps, _PER_WRAP, _PER_WRAP))
        placed = nothing.at[self.muscles, self.places, self.places].set(weighted)
        return jnp.swapaxes(placed, 2, 3).reshape(*changes.shape, changes.shape[1])


class TwoLevelPaths(AbstractPath):
    """Paths over recorded cycles whose coefficients follow their cylinders' parameters.

    The changes of a muscle are what its cylinders' parameters (`WRAP_PARAMETERS`, in their units) differ
    from nominal by, one cylinder after the other in the order of its path.
    """

    nominal: PathState
    #: The muscles whose cylinders may move.
    moving: Int[np.ndarray, " moving"]
    #: Of the moving muscles.
    inner: InnerLevel
    #: What a unit (1 m) of each coefficient adds; leaves lead with ``moving term``.
    by_coefficient: PathState
    limits: PlacedLimits | None
    #: Most cylinders that a muscle has.
    wraps: int = eqx.field(static=True)

    @property
    def modes_count(self) -> int:
        """How many changes a muscle has at most."""
        return self.wraps * _PER_WRAP

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Give all paths round their cylinders where these changes put them."""
        coefficients = self.inner(changes[self.moving])
        infeasibility = None if self.limits is None else self.limits.excess(changes, self.wraps)
        moved = jax.tree.map(
            lambda nominal, by: nominal.at[self.moving].add(jnp.einsum("mt,mt...->m...", coefficients, by)),
            replace(self.nominal, infeasibility=None),
            self.by_coefficient,
        )
        return replace(moved, infeasibility=infeasibility)

    def slopes(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Differentiate each path by its own changes."""
        by_change = self.inner.slopes(changes[self.moving])
        muscles, modes = changes.shape

        def placed(by: Float[Array, "moving term ..."]) -> Float[Array, "muscle mode ..."]:
            own = jnp.einsum("mkt,mt...->mk...", by_change, by)
            return jnp.zeros((muscles, modes, *by.shape[2:])).at[self.moving].set(own)

        infeasibility = None if self.limits is None else self.limits.slopes(changes, self.wraps)
        return replace(jax.tree.map(placed, self.by_coefficient), infeasibility=infeasibility)

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Give all paths, and how each moves with its own changes (leaves lead with ``muscle mode``)."""
        return self.at(changes), self.slopes(changes)

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate each path twice by its own changes, and sum with these weights."""
        own = jax.tree.map(lambda leaf: leaf[self.moving], replace(weights, infeasibility=None))
        by_term = jax.tree.map(
            lambda by, weight: jnp.einsum("mt...,m...->mt", by, weight), self.by_coefficient, own
        )
        of_moving = self.inner.curvature(changes[self.moving], jax.tree.reduce(jnp.add, by_term))
        muscles, modes = changes.shape
        total = jnp.zeros((muscles, modes, modes)).at[self.moving].set(of_moving)
        if self.limits is None or weights.infeasibility is None:
            return total
        return total + self.limits.curvature(changes, weights.infeasibility)


def two_level_paths(
    nominal: PathState,
    moving: Sequence[int],
    inner: InnerLevel,
    by_coefficient: PathState,
    limits: Sequence[tuple[int, int, Feasibility]],
) -> TwoLevelPaths:
    """Join both levels with what limits the cylinders.

    Parameters
    ----------
    nominal
        Paths of all muscles.
    moving
        The muscles whose cylinders may move, by number.
    inner, by_coefficient
        Of those muscles; see `TwoLevelPaths`.
    limits
        Muscle, which of its cylinders, and the cylinder's feasibility: each cylinder once.
    """
    wraps = inner.half_range.shape[1]
    placed = None
    if limits:
        muscles, places, feasibility = zip(*limits, strict=True)
        placed = PlacedLimits(np.array(muscles), np.array(places), _stacked(feasibility))
        unchanged = jnp.zeros((nominal.length.shape[0], wraps * _PER_WRAP))
        nominal = replace(nominal, infeasibility=placed.excess(unchanged, wraps))
    return TwoLevelPaths(nominal, np.array(moving), inner, by_coefficient, placed, wraps)


def _stacked(limits: Sequence[Feasibility]) -> Feasibility:
    """Fill all up to as many support vectors, of no weight."""
    most = max(one.weights.shape[0] for one in limits)

    def filled(one: Feasibility) -> Feasibility:
        missing = most - one.weights.shape[0]
        support = jnp.pad(one.support, ((0, missing), (0, 0)))
        return replace(one, support=support, weights=jnp.pad(one.weights, (0, missing)))

    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(filled, limits))
