"""Paths of one source, guarded by the exact engine: from where true paths would jump, and from straying."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.paths import AbstractPath, PathState
from wrapjax.geometry.wrapped_paths import WrappedPaths

#: Differences from the exact length and moment arm (m), beyond those of nominal paths, at which closeness
#: is one.
LENGTH_STRAYING, ARM_STRAYING = 1.5e-4, 4e-4
# Keeps the root's slope finite for paths that no wall is near to.
_TINY = 1e-24


class GuardedPaths(AbstractPath):
    """Paths that are told by the exact ones how close they are to what they must not get to.

    Polynomials follow cylinders smoothly to where no real path would follow: a path point inside, the
    cylinder's end, a cylinder lost. And in a corner of what they were learned from they can be wrong by a
    millimeter. The exact paths know, and need only be asked in some frames.
    """

    nominal: PathState
    #: Where lengths and moment arms come from.
    paths: AbstractPath
    #: In every so many frames of the same cycles, with the same changes.
    exact: WrappedPaths
    every: int = eqx.field(static=True)

    @property
    def modes_count(self) -> int:
        """How many changes a muscle has at most."""
        return self.paths.modes_count

    @property
    def resolution(self) -> float:
        """That of the exact paths' kinks."""
        return self.exact.resolution

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Give all paths, changed by these amounts."""
        return self._guarded(self.paths.at(changes), self.exact.at(changes))

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Give all paths, and how each moves with its own changes (leaves lead with ``muscle mode``)."""
        at = self.paths.linearized(changes), self.exact.linearized(changes)
        (state, slopes), (exact, exact_slopes) = at

        def along(slope: PathState, exact_slope: PathState) -> tuple[PathState, PathState]:
            return jax.jvp(self._guarded, (state, exact), (slope, exact_slope))

        return jax.vmap(along, in_axes=1, out_axes=(None, 1))(slopes, exact_slopes)

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate the paths twice, the closeness included.

        It is a root of a sum of squares: what a solver of least squares makes of its slopes alone is one
        direction of many, and without the rest its steps are short wherever paths are held.
        """
        (state, slopes), (exact, exact_slopes) = (
            self.paths.linearized(changes),
            self.exact.linearized(changes),
        )

        def by_paths(state: PathState, exact: PathState) -> tuple[PathState, PathState]:
            def total(state: PathState, exact: PathState) -> Float[Array, ""]:
                closeness = self._guarded(state, exact).closeness
                assert closeness is not None and weights.closeness is not None, "guarded paths have it"
                return jnp.vdot(weights.closeness, closeness)

            return jax.grad(total, argnums=(0, 1))(state, exact)

        def along(*slope: PathState) -> tuple[PathState, PathState]:
            return jax.jvp(by_paths, (state, exact), slope)[1]

        bent = jax.vmap(along, in_axes=1, out_axes=1)(slopes, exact_slopes)
        products = jax.tree.map(
            lambda one, other: jnp.einsum("mi...,mj...->mij", one, other), bent, (slopes, exact_slopes)
        )
        of_guard = jax.tree.reduce(jnp.add, products)
        by_state, by_exact = by_paths(state, exact)
        of_state = jax.tree.map(jnp.add, replace(weights, closeness=None), by_state)
        of_paths = self.paths.curvature(changes, of_state, (state, slopes))
        return of_guard + of_paths + self.exact.curvature(changes, by_exact, (exact, exact_slopes))

    def _guarded(self, state: PathState, exact: PathState) -> PathState:
        """Add the closeness; it is held from one frame in which it is known to the next."""
        assert exact.closeness is not None, "the engine's paths know it"
        length, arm = (
            (own - usual)[..., :: self.every] - (true - usually_true)
            for own, usual, true, usually_true in (
                (state.length, self.nominal.length, exact.length, self.exact.nominal.length),
                (state.moment_arm, self.nominal.moment_arm, exact.moment_arm, self.exact.nominal.moment_arm),
            )
        )
        # Squares, and no higher powers: they are what a solver of least squares sees through.
        strayed = (length / LENGTH_STRAYING) ** 2 + jnp.sum((arm / ARM_STRAYING) ** 2, axis=-2)
        within = jnp.isfinite(exact.closeness)
        # Beyond a wall nothing has a slope.
        to_wall = jnp.where(within, exact.closeness, 0.0)
        closeness = jnp.where(within, jnp.sqrt(to_wall**2 + strayed + _TINY), jnp.inf)
        frames = state.length.shape[-1]
        return replace(state, closeness=jnp.repeat(closeness, self.every, axis=-1)[..., :frames])


def guarded_paths(paths: AbstractPath, exact: WrappedPaths, every: int) -> GuardedPaths:
    """Guard paths over cycles by exact ones over every so many frames of them, from the first on."""
    unguarded = GuardedPaths(paths.nominal, paths, exact, every)
    return replace(unguarded, nominal=unguarded._guarded(paths.nominal, exact.nominal))
