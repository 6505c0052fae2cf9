"""Lengths, rates and moment arms of all muscle paths, and the interface of paths that can be adjusted."""

from __future__ import annotations

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class PathState(eqx.Module):
    """Muscle-tendon lengths, their rates and moment arms of all muscles at all frames.

    ``moment_arm = -dL/dq`` (OpenSim's sign) is positive where tension in the muscle increases the coordinate.
    """

    #: m
    length: Float[Array, "*muscle trial frame"]
    #: m/s, lengthening positive
    velocity: Float[Array, "*muscle trial frame"]
    #: m (m/rad)
    moment_arm: Float[Array, "*muscle trial coordinate frame"]
    #: Proximity to discontinuities of the length (dimensionless; see `Barriers.proximity`), for paths with
    #: barriers.
    proximity: Float[Array, "*muscle trial frame"] | None = None
    #: Feasibility score of each wrap, positive where it is not feasible (dimensionless; see
    #: `Feasibility.excess`), for paths with a fitted feasibility.
    infeasibility: Float[Array, "*muscle wrap"] | None = None


class AbstractPath(eqx.Module):
    """Paths of all muscles, adjustable by a vector of *changes* for each muscle.

    Zero changes give the nominal paths.
    """

    #: Paths as the model has them.
    nominal: eqx.AbstractVar[PathState]

    @property
    @abc.abstractmethod
    def modes_count(self) -> int:
        """Largest number of changes of a muscle."""

    @property
    def resolution(self) -> float:
        """Relative difference below which a function of the paths may deviate from its linearization."""
        return 0.0

    @abc.abstractmethod
    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Compute all paths at given changes."""

    @abc.abstractmethod
    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Compute all paths, and the derivatives of each path by its own changes.

        The first axes of the derivatives are ``muscle mode``.
        """

    @abc.abstractmethod
    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Compute the weighted sum of the second derivatives of each path by its own changes.

        Implementations may leave out terms that are expensive: solvers use the result to converge in fewer
        iterations, and converge to the same solution without it.

        Parameters
        ----------
        changes
            Changes at which to differentiate.
        weights
            Weight of each number of the paths.
        expansion
            Result of `linearized` at these changes.
        """


class AdjustablePath(AbstractPath):
    """Paths that are linear in their changes, the amplitudes of modes.

    A mode changes length, rate and moment arms consistently. Fixed paths have no modes.
    """

    nominal: PathState
    #: Change of the paths per unit of each mode; the first axes of all leaves are ``muscle mode``.
    modes: PathState

    @property
    def modes_count(self) -> int:
        """Largest number of modes of a muscle."""
        return self.modes.length.shape[1]

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Add the modes, multiplied by their amplitudes, to the nominal paths."""
        return jax.tree.map(
            lambda nominal, modes: (
                nominal + jnp.einsum("mk,mk...->m...", changes[:, : modes.shape[1]], modes)
            ),
            self.nominal,
            self.modes,
        )

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Compute all paths, and return their derivatives, the modes."""
        return self.at(changes), self.modes

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Return zeros, because the paths are linear in their modes."""
        return jnp.zeros((*changes.shape, changes.shape[1]))


def fixed_path(path: PathState) -> AdjustablePath:
    """Convert paths of all muscles to an `AdjustablePath` without modes."""
    none = jax.tree.map(lambda leaf: jnp.zeros((leaf.shape[0], 0, *leaf.shape[1:])), path)
    return AdjustablePath(path, none)
