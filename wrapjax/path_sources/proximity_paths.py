"""Muscle paths with the proximity to discontinuities of the exact paths."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.exact_paths.wrapped_paths import WrappedPaths
from wrapjax.geometry.paths import AbstractPath, PathState

#: Deviations of length and moment arm from the exact path (m), beyond those of the nominal paths, that add
#: one to the squared proximity.
LENGTH_DEVIATION, ARM_DEVIATION = 1.5e-4, 4e-4
# Keeps the derivative of the square root finite at zero.
_TINY = 1e-24


class ProximityPaths(AbstractPath):
    """Approximate paths whose proximity is computed from exact paths with the same changes.

    Polynomial paths are smooth where the exact path has a discontinuity: a path point inside the wrap, the
    end of the wrap, or loss of contact. At the edge of the range of their samples they can also deviate by a
    millimeter. The proximity of these paths is ``sqrt(p^2 + d^2)``, with p the proximity of the exact path
    and d its deviation from the approximate path in units of `LENGTH_DEVIATION` and `ARM_DEVIATION`. It is
    evaluated in every n-th frame.
    """

    nominal: PathState
    #: Source of lengths and moment arms.
    paths: AbstractPath
    #: Exact paths in every n-th frame of the same cycles.
    exact: WrappedPaths
    #: Step n of the frames with exact paths.
    every: int = eqx.field(static=True)

    @property
    def modes_count(self) -> int:
        """Largest number of modes of a muscle."""
        return self.paths.modes_count

    @property
    def resolution(self) -> float:
        """Resolution of the exact paths, which have kinks."""
        return self.exact.resolution

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Evaluate the paths with these changes."""
        return self._with_proximity(self.paths.at(changes), self.exact.at(changes))

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Evaluate the paths and their derivatives by the changes (leading axes ``muscle mode``)."""
        at = self.paths.linearized(changes), self.exact.linearized(changes)
        (state, slopes), (exact, exact_slopes) = at

        def along(slope: PathState, exact_slope: PathState) -> tuple[PathState, PathState]:
            return jax.jvp(self._with_proximity, (state, exact), (slope, exact_slope))

        return jax.vmap(along, in_axes=1, out_axes=(None, 1))(slopes, exact_slopes)

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Compute the weighted second derivatives of the paths, including the proximity.

        The proximity is the square root of a sum of squares. Its first derivatives alone, which the
        Gauss-Newton part of the Hessian uses, represent one of the directions of that sum; without second
        derivatives the solver's steps would be short.
        """
        (state, slopes), (exact, exact_slopes) = (
            self.paths.linearized(changes),
            self.exact.linearized(changes),
        )

        def weighted_gradient(state: PathState, exact: PathState) -> tuple[PathState, PathState]:
            def weighted(state: PathState, exact: PathState) -> Float[Array, ""]:
                proximity = self._with_proximity(state, exact).proximity
                assert proximity is not None and weights.proximity is not None, "these paths have a proximity"
                return jnp.vdot(weights.proximity, proximity)

            return jax.grad(weighted, argnums=(0, 1))(state, exact)

        def hessian_along(*slope: PathState) -> tuple[PathState, PathState]:
            return jax.jvp(weighted_gradient, (state, exact), slope)[1]

        hessian_slopes = jax.vmap(hessian_along, in_axes=1, out_axes=1)(slopes, exact_slopes)
        products = jax.tree.map(
            lambda one, other: jnp.einsum("mi...,mj...->mij", one, other),
            hessian_slopes,
            (slopes, exact_slopes),
        )
        of_proximity = jax.tree.reduce(jnp.add, products)
        by_state, by_exact = weighted_gradient(state, exact)
        of_state = jax.tree.map(jnp.add, replace(weights, proximity=None), by_state)
        of_paths = self.paths.curvature(changes, of_state, (state, slopes))
        return of_proximity + of_paths + self.exact.curvature(changes, by_exact, (exact, exact_slopes))

    def _with_proximity(self, state: PathState, exact: PathState) -> PathState:
        """Add the proximity; between the frames with exact paths it is constant."""
        assert exact.proximity is not None, "paths of the engine have a proximity"
        length, arm = (
            (own - usual)[..., :: self.every] - (true - usually_true)
            for own, usual, true, usually_true in (
                (state.length, self.nominal.length, exact.length, self.exact.nominal.length),
                (state.moment_arm, self.nominal.moment_arm, exact.moment_arm, self.exact.nominal.moment_arm),
            )
        )
        # Squares, not higher powers: these suit a solver of least squares.
        deviation = (length / LENGTH_DEVIATION) ** 2 + jnp.sum((arm / ARM_DEVIATION) ** 2, axis=-2)
        within = jnp.isfinite(exact.proximity)
        # Beyond a discontinuity the proximity is infinite, and derivatives are zero.
        finite = jnp.where(within, exact.proximity, 0.0)
        proximity = jnp.where(within, jnp.sqrt(finite**2 + deviation + _TINY), jnp.inf)
        frames = state.length.shape[-1]
        return replace(state, proximity=jnp.repeat(proximity, self.every, axis=-1)[..., :frames])


def with_exact_proximity(paths: AbstractPath, exact: WrappedPaths, every: int) -> ProximityPaths:
    """Build paths with the proximity of exact paths.

    Parameters
    ----------
    paths
        Approximate paths over cycles.
    exact
        Exact paths in every n-th frame of the same cycles, from the first on.
    every
        Step n of these frames.
    """
    without_proximity = ProximityPaths(paths.nominal, paths, exact, every)
    return replace(without_proximity, nominal=without_proximity._with_proximity(paths.nominal, exact.nominal))
