"""How the coefficients of a muscle path follow the cylinders that it wraps round: the inner level.

After Ao, Fregly et al., each coefficient of the outer level is a cubic polynomial of the six wrap
parameters of a cylinder. Here it is one of what they differ from nominal by, without a constant: nominal
parameters give the nominal coefficients exactly. Several cylinders of one muscle add up.

Paths that follow their cylinders through polynomials: the two-level surrogate of Ao, Fregly et al.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.feasibility import Feasibility
from wrapjax.geometry.paths import AbstractPath, PathState
from wrapjax.geometry.surrogate import monomial_exponents, monomials
from wrapjax.geometry.wrapping import NOMINAL, WRAP_PARAMETERS

#: Highest total degree: 84 monomials of six parameters, of which the constant is the nominal path's.
DEGREE = 3
_PER_WRAP = len(WRAP_PARAMETERS)
_EXPONENTS = monomial_exponents(_PER_WRAP, DEGREE)[1:]
#: How strongly weights are held to zero, in samples at an end of the box; what foretells best is taken.
RIDGES = (0.0, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0, 3.0)
# A sample that alone decides its own value is foretold by nothing.
_LEAST = 1e-6
#: Monomials of one cylinder's changes.
MONOMIALS = len(_EXPONENTS)


class InnerLevel(eqx.Module):
    """Cubic polynomials from cylinders to outer coefficients, all muscles in one shape.

    A muscle with fewer cylinders, or fewer coefficients, than others has zeros there.
    """

    #: m
    weights: Float[Array, "*muscle wrap monomial term"]
    #: Half width of the sampled box, in the parameters' units.
    half_range: Float[Array, "*muscle wrap wrap_parameter"]

    def __call__(self, changes: Float[Array, "muscle mode"]) -> Float[Array, "muscle term"]:
        """Give what coefficients differ from nominal by (m).

        Parameters
        ----------
        changes
            What the parameters of each muscle's cylinders differ from nominal by, in their units, one
            cylinder after the other in the order of its path.
        """
        return jax.vmap(InnerLevel.of_one)(self, changes)

    def slopes(self, changes: Float[Array, "muscle mode"]) -> Float[Array, "muscle mode term"]:
        """Differentiate each muscle's coefficients by its own changes."""

        return jax.vmap(lambda level, own: jax.jacfwd(level.of_one)(own).T)(self, changes)

    def curvature(
        self, changes: Float[Array, "muscle mode"], weights: Float[Array, "muscle term"]
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate each muscle's coefficients twice, and sum with these weights."""

        def of_one(level, own, weight):
            return jax.hessian(lambda at: weight @ level.of_one(at))(own)

        return jax.vmap(of_one)(self, changes, weights)

    def of_one(self, changes: Float[Array, " mode"]) -> Float[Array, " term"]:
        """Do the same for a level that is of one muscle, without the axis ``muscle``."""
        scaled = changes.reshape(self.half_range.shape) / self.half_range
        return jnp.einsum("wk,wkt->t", monomials(jnp.asarray(_EXPONENTS), scaled), self.weights)


def fit_inner_level(
    changes: Float[np.ndarray, "sample wrap wrap_parameter"],
    half_range: Float[np.ndarray, "wrap wrap_parameter"],
    coefficients: Float[np.ndarray, "sample term"],
    used: Bool[np.ndarray, " sample"],
    metric: Float[np.ndarray, "term term"],
) -> Float[np.ndarray, "wrap monomial term"]:
    """Fit one muscle's inner level by ridge regression.

    Where few placements are physiological, a cubic follows single samples. So of `RIDGES` the one is
    taken by which each sample is best foretold from all others.

    Parameters
    ----------
    changes
        What the parameters of its cylinders differ from nominal by at each sample, all moved at once.
    half_range
        Of the sampled box.
    coefficients
        What outer coefficients differ from the nominal path's by at each sample, m.
    used
        Which samples count.
    metric
        Quadratic form of an error in the coefficients that says how bad it is.

    Returns
    -------
    Array
        Of least norm where there are fewer samples than monomials.
    """
    scaled = (changes / half_range).reshape(-1, _PER_WRAP)
    count, wraps = changes.shape[:2]
    design = np.asarray(monomials(jnp.asarray(_EXPONENTS), jnp.asarray(scaled))).reshape(count, -1)[used]
    left, strengths, right = np.linalg.svd(design, full_matrices=False)
    seen = strengths > strengths.max(initial=0.0) * max(design.shape) * np.finfo(float).eps
    left, strengths, right = left[:, seen], strengths[seen], right[seen]
    along = left.T @ coefficients[used]

    def foretelling_error(ridge: float) -> float:
        kept = strengths**2 / (strengths**2 + ridge)
        own_share = np.sum(left**2 * kept, axis=1, keepdims=True)
        missed = (coefficients[used] - left @ (kept[:, None] * along)) / np.maximum(1.0 - own_share, _LEAST)
        return float(np.einsum("si,ij,sj->", missed, metric, missed))

    ridge = min(RIDGES, key=foretelling_error)
    weights = right.T @ ((strengths / (strengths**2 + ridge))[:, None] * along)
    return weights.reshape(wraps, len(_EXPONENTS), -1)


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
