"""Paths of one source, guarded by the exact engine from where the true paths would jump."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry.paths import AbstractPath, PathState
from wrapjax.geometry.wrapped_paths import WrappedPaths


class GuardedPaths(AbstractPath):
    """Paths that are told their closeness to a jump by the exact ones.

    Polynomials follow cylinders smoothly to where no real path would follow: a path point inside, the
    cylinder's end, a cylinder lost. The exact paths know, and need only be asked in some frames.
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
        return _joined(self.paths.at(changes), self.exact.at(changes), self.every)

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Give all paths, and how each moves with its own changes (leaves lead with ``muscle mode``)."""
        state, slopes = self.paths.linearized(changes)
        exact_state, exact_slopes = self.exact.linearized(changes)
        return _joined(state, exact_state, self.every), _joined(slopes, exact_slopes, self.every)

    def curvature(
        self, changes: Float[Array, "muscle mode"], weights: PathState
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate the paths twice; the closeness is left out, as it costs more than all the rest."""
        return self.paths.curvature(changes, replace(weights, closeness=None))


def guarded_paths(paths: AbstractPath, exact: WrappedPaths, every: int) -> GuardedPaths:
    """Guard paths over cycles by exact ones over every so many frames of them, from the first on."""
    return GuardedPaths(_joined(paths.nominal, exact.nominal, every), paths, exact, every)


def _joined(state: PathState, exact: PathState, every: int) -> PathState:
    """Hold the exact paths' closeness until it is known anew."""
    assert exact.closeness is not None, "the engine's paths know it"
    frames = state.length.shape[-1]
    return replace(state, closeness=jnp.repeat(exact.closeness, every, axis=-1)[..., :frames])
