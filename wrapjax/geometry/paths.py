"""What the rest of the model needs to know of muscle paths, and how they may change."""

from __future__ import annotations

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class PathState(eqx.Module):
    """Muscle-tendon length, its rate and moment arms, all muscles at all frames.

    ``moment_arm = -dL/dq`` (OpenSim's sign): positive where the muscle pulls its coordinate up.
    """

    #: m
    length: Float[Array, "*muscle trial frame"]
    #: m/s, lengthening positive
    velocity: Float[Array, "*muscle trial frame"]
    #: m (m/rad)
    moment_arm: Float[Array, "*muscle trial coordinate frame"]
    #: How near to where the length would jump, for paths that can: see `wrapped_paths`.
    proximity: Float[Array, "*muscle trial frame"] | None = None
    #: How far each of its cylinders is beyond where paths are physiological (`Feasibility.excess`; no
    #: unit), for paths that have learned it.
    infeasibility: Float[Array, "*muscle wrap"] | None = None


class AbstractPath(eqx.Module):
    """Paths of all muscles, of which some can be changed by numbers, *changes*.

    All changes zero leave the paths as the model has them.
    """

    #: As the model has them.
    nominal: eqx.AbstractVar[PathState]

    @property
    @abc.abstractmethod
    def modes_count(self) -> int:
        """How many changes a muscle has at most."""

    @property
    def resolution(self) -> float:
        """Relative change below which a function of the paths need not follow its expansion."""
        return 0.0

    @abc.abstractmethod
    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Give all paths, changed by these amounts."""

    @abc.abstractmethod
    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Give all paths, and how each moves with its own changes (leaves lead with ``muscle mode``)."""

    @abc.abstractmethod
    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate each path twice by its own changes, and sum with these weights.

        What costs more than it helps may be left out: a solver gets to the same end without.

        Parameters
        ----------
        changes, weights
            Where, and one number for each of the paths'.
        expansion
            What `linearized` gives there.
        """


class AdjustablePath(AbstractPath):
    """Paths that change by any sum of modes.

    A mode is a change of shape, consistent in length, rate and moment arms. Paths that must stay as
    they are have no modes.
    """

    nominal: PathState
    #: Change by one unit of each mode; leaves lead with ``muscle mode``.
    modes: PathState

    @property
    def modes_count(self) -> int:
        """How many modes a muscle has at most."""
        return self.modes.length.shape[1]

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Add the modes, by these amounts, to the nominal paths."""
        return jax.tree.map(
            lambda nominal, modes: (
                nominal + jnp.einsum("mk,mk...->m...", changes[:, : modes.shape[1]], modes)
            ),
            self.nominal,
            self.modes,
        )

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Give all paths, and the modes."""
        return self.at(changes), self.modes

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Zero: paths are linear in their modes."""
        return jnp.zeros((*changes.shape, changes.shape[1]))


def fixed_path(path: PathState) -> AdjustablePath:
    """Wrap paths, of all muscles, that do not change."""
    none = jax.tree.map(lambda leaf: jnp.zeros((leaf.shape[0], 0, *leaf.shape[1:])), path)
    return AdjustablePath(path, none)
