"""Two-level surrogate of muscle paths after Ao, Fregly et al.: paths that depend on wrap parameters.

The outer level gives paths over joint coordinates (`PathSurrogate`). At the inner level each coefficient of
the outer level is a cubic polynomial of the six or nine parameters of a wrap. Here its variables are the
differences from nominal parameters and it has no constant, so that nominal parameters give the nominal
coefficients exactly. The contributions of several wraps of one muscle are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS
from wrapjax.geometry.paths import AbstractPath, PathState
from wrapjax.geometry.surrogates.feasibility import Feasibility
from wrapjax.geometry.surrogates.surrogate import monomial_exponents, monomials

#: Highest total degree of the inner level.
DEGREE = 3
#: Ridge penalties among which leave-one-out validation chooses.
RIDGES = (0.0, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0, 3.0)
# Smallest value of one less a sample's leverage, by which its leave-one-out residual is divided.
_MIN_DENOMINATOR = 1e-6
# Feasibility score of wraps without a limit: well within it.
_WITHIN_LIMIT = -1.0


@cache
def wrap_exponents(parameters: int) -> Int[np.ndarray, "monomial wrap_parameter"]:
    """Exponents of the monomials of one wrap's parameters, without the constant."""
    return monomial_exponents(parameters, DEGREE)[1:]


class InnerLevel(eqx.Module):
    """Cubic polynomials from wrap parameters to coefficients of the outer level, padded to one shape.

    Muscles with fewer wraps or coefficients than others have zero weights there.
    """

    #: Coefficients of the cubic polynomials, m.
    weights: Float[Array, "*muscle wrap monomial term"]
    #: Half width of the sampled box, in the parameters' units.
    half_range: Float[Array, "*muscle wrap wrap_parameter"]

    def __call__(self, changes: Float[Array, "muscle mode"]) -> Float[Array, "muscle term"]:
        """Compute the differences of coefficients from their nominal values (m).

        Parameters
        ----------
        changes
            Differences of the parameters of each muscle's wraps from nominal, in their units, one wrap after
            the other in the order of its path.
        """
        return jax.vmap(InnerLevel.for_one_muscle)(self, changes)

    def derivatives(self, changes: Float[Array, "muscle mode"]) -> Float[Array, "muscle mode term"]:
        """Compute the derivatives of each muscle's coefficients by its wrap parameters."""
        return jax.vmap(lambda level, own: jax.jacfwd(level.for_one_muscle)(own).T)(self, changes)

    def curvature(
        self, changes: Float[Array, "muscle mode"], weights: Float[Array, "muscle term"]
    ) -> Float[Array, "muscle mode mode"]:
        """Compute the weighted sum of the second derivatives of each muscle's coefficients."""

        def of_muscle(level, own, weight):
            return jax.hessian(lambda at: weight @ level.for_one_muscle(at))(own)

        return jax.vmap(of_muscle)(self, changes, weights)

    def for_one_muscle(self, changes: Float[Array, " mode"]) -> Float[Array, " term"]:
        """Compute the differences of coefficients (m) of one muscle, whose level has no axis ``muscle``."""
        scaled = changes.reshape(self.half_range.shape) / self.half_range
        exponents = jnp.asarray(wrap_exponents(scaled.shape[1]))
        return jnp.einsum("wk,wkt->t", monomials(exponents, scaled), self.weights)


def fit_inner_level(
    changes: Float[np.ndarray, "sample wrap wrap_parameter"],
    half_range: Float[np.ndarray, "wrap wrap_parameter"],
    coefficients: Float[np.ndarray, "sample term"],
    used: Bool[np.ndarray, " sample"],
    metric: Float[np.ndarray, "term term"],
) -> Float[np.ndarray, "wrap monomial term"]:
    """Fit the inner level of one muscle by ridge regression.

    The penalty is the one of `RIDGES` with the smallest leave-one-out error. It prevents overfitting where
    few samples are physiological.

    Parameters
    ----------
    changes
        Differences of the parameters of the muscle's wraps from nominal, all of them changed in each sample.
    half_range
        Half width of the sampled box, in the parameters' units.
    coefficients
        Differences of the outer level's coefficients from nominal, m.
    used
        Samples to fit.
    metric
        Quadratic form of an error in the coefficients, the error measure of the leave-one-out validation.

    Returns
    -------
    Array
        Weights of the monomials, m. They have minimum norm if there are fewer samples than monomials.
    """
    count, wraps, parameters = changes.shape
    scaled = (changes / half_range).reshape(-1, parameters)
    exponents = jnp.asarray(wrap_exponents(parameters))
    design = np.asarray(monomials(exponents, jnp.asarray(scaled))).reshape(count, -1)[used]
    left, singular_values, right = np.linalg.svd(design, full_matrices=False)
    nonzero = singular_values > singular_values.max(initial=0.0) * max(design.shape) * np.finfo(float).eps
    left, singular_values, right = left[:, nonzero], singular_values[nonzero], right[nonzero]
    along = left.T @ coefficients[used]

    def leave_one_out_error(ridge: float) -> float:
        shrinkage = singular_values**2 / (singular_values**2 + ridge)
        leverage = np.sum(left**2 * shrinkage, axis=1, keepdims=True)
        residual = coefficients[used] - left @ (shrinkage[:, None] * along)
        residual = residual / np.maximum(1.0 - leverage, _MIN_DENOMINATOR)
        return float(np.einsum("si,ij,sj->", residual, metric, residual))

    ridge = min(RIDGES, key=leave_one_out_error)
    weights = right.T @ ((singular_values / (singular_values**2 + ridge))[:, None] * along)
    return weights.reshape(wraps, len(exponents), -1)


class FeasibilityLimits(eqx.Module):
    """Feasibility limits of wraps, each evaluated for one of the muscles that wrap round it."""

    #: Number of the muscle, and of the wrap in the order of its path.
    muscles: Int[np.ndarray, " limit"]
    places: Int[np.ndarray, " limit"]
    #: The first axis of all leaves is ``limit``.
    feasibility: Feasibility

    def excess(self, changes: Float[Array, "muscle mode"], wraps: int) -> Float[Array, "muscle wrap"]:
        """Compute the excess of each wrap over its limit (`Feasibility.excess`), negative without a limit.

        Parameters
        ----------
        changes
            Differences of the parameters of each muscle's wraps from nominal, in their units.
        wraps
            Largest number of wraps of a muscle.
        """
        changed, own = self._of_wraps(changes, wraps)
        excess = jax.vmap(Feasibility.excess)(self.feasibility, own)
        return jnp.full(changed.shape[:2], _WITHIN_LIMIT).at[self.muscles, self.places].set(excess)

    def derivatives(
        self, changes: Float[Array, "muscle mode"], wraps: int
    ) -> Float[Array, "muscle mode wrap"]:
        """Compute the derivatives of `excess` by the wrap parameters of each muscle."""
        changed, own = self._of_wraps(changes, wraps)
        gradients = jax.vmap(jax.grad(Feasibility.excess, argnums=1))(self.feasibility, own)
        zeros = jnp.zeros((*changed.shape, wraps))
        placed = zeros.at[self.muscles, self.places, :, self.places].set(gradients)
        return placed.reshape(*changes.shape, wraps)

    def curvature(
        self, changes: Float[Array, "muscle mode"], weights: Float[Array, "muscle wrap"]
    ) -> Float[Array, "muscle mode mode"]:
        """Compute the weighted sum of the second derivatives of `excess`."""
        wraps = weights.shape[1]
        changed, own = self._of_wraps(changes, wraps)
        hessians = jax.vmap(jax.hessian(Feasibility.excess, argnums=1))(self.feasibility, own)
        weighted = weights[self.muscles, self.places, None, None] * hessians
        count = changed.shape[-1]
        zeros = jnp.zeros((len(changed), wraps, wraps, count, count))
        placed = zeros.at[self.muscles, self.places, self.places].set(weighted)
        return jnp.swapaxes(placed, 2, 3).reshape(*changes.shape, changes.shape[1])

    def _of_wraps(
        self, changes: Float[Array, "muscle mode"], wraps: int
    ) -> tuple[Float[Array, "muscle wrap wrap_parameter"], Float[Array, "limit wrap_parameter"]]:
        """Arrange changes by wrap, and return also the parameters of the limited wraps."""
        count = self.feasibility.center.shape[-1]
        changed = changes.reshape(-1, wraps, count)
        return changed, changed[self.muscles, self.places] + jnp.asarray(NOMINAL_PARAMETERS)[None, :count]


class TwoLevelPaths(AbstractPath):
    """Paths over recorded cycles as two-level surrogates of wrap parameters.

    The changes of a muscle are the differences of its wraps' parameters (in their units) from nominal, one
    wrap after the other in the order of its path.
    """

    nominal: PathState
    #: Numbers of the muscles whose wraps may change.
    moving: Int[np.ndarray, " moving"]
    #: Inner level of these muscles.
    inner: InnerLevel
    #: Change of their paths per unit (1 m) of each coefficient; the first axes of all leaves are ``moving
    #: term``.
    by_coefficient: PathState
    #: Feasibility limits of wraps; None if no wrap has one.
    limits: FeasibilityLimits | None
    #: Largest number of wraps of a muscle.
    wraps: int = eqx.field(static=True)

    @property
    def modes_count(self) -> int:
        """Largest number of changes of a muscle."""
        return self.wraps * self.inner.half_range.shape[-1]

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Compute all paths at given changes of wrap parameters."""
        coefficients = self.inner(changes[self.moving])
        infeasibility = None if self.limits is None else self.limits.excess(changes, self.wraps)
        # It depends on the wrap parameters themselves, and is no sum over polynomial coefficients.
        moved = jax.tree.map(
            lambda nominal, by: nominal.at[self.moving].add(jnp.einsum("mt,mt...->m...", coefficients, by)),
            replace(self.nominal, infeasibility=None),
            self.by_coefficient,
        )
        return replace(moved, infeasibility=infeasibility)

    def derivatives(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Compute the derivatives of each path by the wrap parameters of its muscle."""
        by_change = self.inner.derivatives(changes[self.moving])
        muscles, modes = changes.shape

        def placed(by: Float[Array, "moving term ..."]) -> Float[Array, "muscle mode ..."]:
            own = jnp.einsum("mkt,mt...->mk...", by_change, by)
            return jnp.zeros((muscles, modes, *by.shape[2:])).at[self.moving].set(own)

        infeasibility = None if self.limits is None else self.limits.derivatives(changes, self.wraps)
        return replace(jax.tree.map(placed, self.by_coefficient), infeasibility=infeasibility)

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Compute all paths, and the derivatives of each path by the wrap parameters of its muscle."""
        return self.at(changes), self.derivatives(changes)

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Compute the weighted sum of the second derivatives of each path by its own changes."""
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
    """Create paths from both levels of the surrogate and the feasibility limits of wraps.

    Parameters
    ----------
    nominal
        Nominal paths of all muscles.
    moving
        Numbers of the muscles whose wraps may change.
    inner
        Inner level of these muscles.
    by_coefficient
        Change of their paths per unit (1 m) of each coefficient.
    limits
        Number of a muscle, number of the wrap in the order of its path, and the wrap's feasibility; one entry
        for each limited wrap.
    """
    wraps, per_wrap = inner.half_range.shape[1:]
    placed = None
    if limits:
        muscles, places, feasibility = zip(*limits, strict=True)
        placed = FeasibilityLimits(np.array(muscles), np.array(places), _stacked(feasibility))
        unchanged = jnp.zeros((nominal.length.shape[0], wraps * per_wrap))
        nominal = replace(nominal, infeasibility=placed.excess(unchanged, wraps))
    return TwoLevelPaths(nominal, np.array(moving), inner, by_coefficient, placed, wraps)


def _stacked(limits: Sequence[Feasibility]) -> Feasibility:
    """Stack feasibilities, padded to the same number of support vectors by some of zero weight."""
    most = max(one.weights.shape[0] for one in limits)

    def padded(one: Feasibility) -> Feasibility:
        missing = most - one.weights.shape[0]
        support = jnp.pad(one.support, ((0, missing), (0, 0)))
        return replace(one, support=support, weights=jnp.pad(one.weights, (0, missing)))

    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(padded, limits))
