"""Muscle paths along candidate trials, by the exact engine, and their derivatives by wraps and muscle ends.

Candidate trials are smooth, and many of their frames have the same posture. Paths are therefore computed in
few postures of each movement and interpolated over its phase by cubic splines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from wrapjax.diagnosis.protocol.trials import Movement, positions, rates
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.path_derivatives import (
    compute_nominal_paths,
    derivatives_by_ends,
    derivatives_by_wrap_parameters,
)
from wrapjax.geometry.paths import PathState

# Postures of a movement in which paths are computed. A movement goes there and back through the same ones.
_POSTURES = 13
# The number of postures is a multiple of this, so that different legs use the same compiled code.
_POSTURE_STEP = 64


@dataclass(frozen=True)
class CandidatePostures:
    """Postures of several movements, each computed once.

    Parameters
    ----------
    movements
        Movements, one for each cycle.
    coordinates
        Coordinates of the model, with their default values (rad or m) in `defaults`.
    about
        Coordinates of the moment arms.
    frames
        Number of frames of a cycle.
    """

    movements: tuple[Movement, ...]
    defaults: Mapping[str, float]
    about: tuple[str, ...]
    frames: int

    @property
    def phase(self) -> Float[np.ndarray, " frame"]:
        """Phase of each frame of a movement."""
        return np.linspace(0.0, 1.0, self.frames)

    def angles(self, names: Sequence[str]) -> Float[np.ndarray, "cycle coordinate frame"]:
        """Compute the values of coordinates over the cycles, rad."""
        return np.stack([positions(one, names, self.defaults, self.phase) for one in self.movements])

    def rates(self, names: Sequence[str]) -> Float[np.ndarray, "cycle coordinate frame"]:
        """Compute the rates of coordinates over the cycles, rad/s."""
        return np.stack([rates(one, names, self.phase) for one in self.movements])

    def paths(self, engine: ExactPaths) -> PathState:
        """Compute the paths of an engine's muscles over all cycles; leaves lead with ``muscle cycle``."""
        poses = self._poses(engine.coordinates)
        found = compute_nominal_paths(engine, poses, np.zeros_like(poses), self.about)
        return self._over_cycles(found)

    def by_ends(self, engine: ExactPaths) -> PathState:
        """Differentiate the paths by the muscles' ends, see `derivatives_by_ends`."""
        poses = self._poses(engine.coordinates)
        return self._over_cycles(derivatives_by_ends(engine, poses, np.zeros_like(poses), self.about))

    def by_wraps(self, engine: ExactPaths, moving: np.ndarray) -> PathState:
        """Differentiate the paths by wrap parameters, see `derivatives_by_wrap_parameters`."""
        poses = self._poses(engine.coordinates)
        found = derivatives_by_wrap_parameters(engine, poses, np.zeros_like(poses), self.about, moving)
        return self._over_cycles(found)

    def _poses(self, names: Sequence[str]) -> Float[np.ndarray, "1 coordinate pose"]:
        """Collect the postures of all movements, one after the other; the last one fills up."""
        phase = np.linspace(0.0, 0.5, _POSTURES)
        own = [
            positions(one, names, self.defaults, phase if one.angles else phase[:1]) for one in self.movements
        ]
        poses = np.concatenate(own, axis=1)
        missing = -poses.shape[1] % _POSTURE_STEP
        return np.concatenate([poses, np.repeat(poses[:, -1:], missing, axis=1)], axis=1)[None]

    def _over_cycles(self, paths: PathState) -> PathState:
        """Interpolate paths, or derivatives with further leading axes, from the postures over all cycles."""
        length = np.moveaxis(self._interpolated(np.asarray(paths.length)[..., 0, :]), 0, -2)
        arm = np.moveaxis(self._interpolated(np.asarray(paths.moment_arm)[..., 0, :, :]), 0, -3)
        # Lengths shorten by the moment arm about each coordinate that moves.
        velocity = -np.einsum("...ckf,ckf->...cf", arm, self.rates(self.about))
        return PathState(*(jnp.asarray(leaf) for leaf in (length, velocity, arm)))

    def _interpolated(self, values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Interpolate values, whose last axis is that of `_poses`; the axis ``cycle`` comes first."""
        first, cycles = 0, []
        half = np.minimum(self.phase, 1.0 - self.phase)
        # The share of the way is a smooth function of the phase, and its own variable of interpolation.
        at = 0.5 * (1.0 - np.cos(2.0 * np.pi * half))
        knots = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.linspace(0.0, 0.5, _POSTURES)))
        for one in self.movements:
            count = _POSTURES if one.angles else 1
            own = values[..., first : first + count]
            first += count
            if one.angles:
                cycles.append(CubicSpline(knots, own, axis=-1)(at))
            else:
                cycles.append(np.repeat(own, self.frames, axis=-1))
        return np.stack(cycles)


def joined_paths(parts: Sequence[PathState]) -> PathState:
    """Join paths, whose leaves lead with ``muscle trial``, along the cycles."""
    return jax.tree.map(lambda *leaves: jnp.concatenate([*map(jnp.asarray, leaves)], axis=1), *parts)


def joined_derivatives(parts: Sequence[PathState]) -> PathState:
    """Join derivatives of paths, whose leaves lead with ``muscle mode trial``, along the cycles."""
    return jax.tree.map(lambda *leaves: jnp.concatenate([*map(jnp.asarray, leaves)], axis=2), *parts)


def sped_up(paths: PathState, factor: float) -> PathState:
    """Multiply the velocities of paths, or of their derivatives, as for the same motion in less time."""
    return PathState(paths.length, paths.velocity * factor, paths.moment_arm)


def by_angles_through_length(moment_arm: Float[Array, "muscle trial coordinate frame"]) -> PathState:
    """Differentiate paths by the angles about which they have moment arms, through their lengths alone.

    Lengths change by the moment arm. What the arms and the velocities change by is left out.
    """
    arms = jnp.moveaxis(jnp.asarray(moment_arm), 2, 1)
    count = arms.shape[1]
    none = jnp.zeros((arms.shape[0], count, arms.shape[2], count, arms.shape[3]))
    return PathState(-arms, jnp.zeros_like(arms), none)
