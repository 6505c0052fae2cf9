"""Least-squares problem of joint personalisation, with the pose of every frame eliminated exactly.

Variables are freed parameters in units of their prior standard deviations. Given these, each frame's pose
solves inverse kinematics, so that the cost is a function of the variables alone (variable projection, Golub &
Pereyra 1973, doi:10.1137/0710036). By the envelope theorem its gradient is the partial one. Its Gauss-Newton
matrix is that of all unknowns with each frame's pose eliminated by the Schur complement (Kaufman 1975,
doi:10.1007/BF01932995): with residuals r, Jacobians J of the variables and K of the pose,
``sum over frames of J'J - J'K inverse(K'K) K'J``. One step costs about as much as inverse kinematics.

Skin moves over bone with the joints near it. Markers may therefore have movements on their bodies in
proportion to given features of the frame (standardised joint angles), with a prior of their own.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy as jsp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.solvers.interface import AbstractLeastSquares, Linearization
from wrapjax.geometry.inverse_kinematics import Bounds, MarkerGoals, PoseFit, expand, fit_frame
from wrapjax.geometry.marker_model import MarkerModel
from wrapjax.geometry.skeleton import body_poses
from wrapjax.joints.changed_skeleton import SkeletonChange

#: Number of frames that are solved at once.
FRAME_BLOCK = 32
#: Share of the largest information of a pose added to all, for coordinates that no marker determines.
_RIDGE = 1e-10


class Frames(NamedTuple):
    """Frames of all trials, in blocks: the first axis is the block, the second the frame.

    Parameters
    ----------
    goals
        Measured markers; their weights are shares of a frame's sum.
    precision
        Weight of a frame's mean squared distance in the cost, 1/m^2; zero for frames that only fill a block.
    features
        Standardised joint angles that may move the skin.
    starts
        Poses near the solutions.
    """

    goals: MarkerGoals
    precision: Float[Array | np.ndarray, "block frame"]
    features: Float[Array | np.ndarray, "block frame feature"]
    starts: Float[Array | np.ndarray, "block frame coordinate"]


class SkinMovement(eqx.Module):
    """Movements of markers on their bodies in proportion to features.

    Parameters
    ----------
    markers, axes, features
        Marker, axis of its body and feature of each movement.
    sd
        Prior standard deviation of each movement, m per standard deviation of the feature.
    """

    markers: tuple[int, ...] = eqx.field(static=True)
    axes: tuple[int, ...] = eqx.field(static=True)
    features: tuple[int, ...] = eqx.field(static=True)
    sd: Float[np.ndarray, " movement"]


class JointProblem(AbstractLeastSquares):
    """Least-squares problem of joint personalisation.

    Parameters
    ----------
    model
        Starting skeleton with markers.
    change
        Map from parameters to skeletons.
    skin
        Movements of markers with joint angles; their amplitudes are variables after the parameters.
    frames
        Measured frames.
    pose_bounds
        Bounds of the coordinates.
    sd
        Prior standard deviations of the parameters.
    limits
        Bounds of the parameters.
    """

    model: MarkerModel
    change: SkeletonChange
    skin: SkinMovement
    frames: Frames
    pose_bounds: Bounds
    sd: Float[np.ndarray, " parameter"]
    limits: tuple[Float[np.ndarray, " parameter"], Float[np.ndarray, " parameter"]]

    @property
    def lower(self) -> Float[np.ndarray, " variable"]:
        """Lower bounds; movements of skin have none."""
        return np.concatenate([self.limits[0] / self.sd, np.full(self.skin.sd.shape, -1e6)])

    @property
    def upper(self) -> Float[np.ndarray, " variable"]:
        """Upper bounds."""
        return np.concatenate([self.limits[1] / self.sd, np.full(self.skin.sd.shape, 1e6)])

    def parameters(
        self, variables: Float[Array | np.ndarray, " variable"]
    ) -> Float[Array | np.ndarray, " parameter"]:
        """Values of the parameters in their units."""
        return variables[: self.sd.shape[0]] * self.sd

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute the cost, half its gradient and its Gauss-Newton matrix."""

        def add(total: tuple[Array, Array, Array], block: Frames) -> tuple[tuple[Array, Array, Array], None]:
            cost, residuals, rows, followed = jax.vmap(lambda frame: self._frame_terms(variables, frame))(
                block
            )
            # One product of tall matrices is far quicker than one a frame.
            tall, wide = (array.reshape(-1, variables.shape[0]) for array in (rows, followed))
            terms = (cost.sum(), tall.T @ residuals.reshape(-1), tall.T @ tall - wide.T @ wide)
            return (total[0] + terms[0], total[1] + terms[1], total[2] + terms[2]), None

        count = variables.shape[0]
        start = (jnp.zeros(()), jnp.zeros(count), jnp.zeros((count, count)))
        (cost, gradient, matrix), _ = jax.lax.scan(add, start, self.frames)
        return Linearization(
            cost=cost + jnp.sum(variables**2),
            gradient=gradient + variables,
            gauss_newton=matrix + jnp.eye(count),
            remainder=jnp.zeros((count, count)),
        )

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Compute the cost."""

        def add(total: Array, block: Frames) -> tuple[Array, None]:
            costs = jax.vmap(lambda frame: frame.precision * self._fit(variables, frame).cost)(block)
            return total + costs.sum(), None

        cost, _ = jax.lax.scan(add, jnp.zeros(()), self.frames)
        return cost + jnp.sum(variables**2)

    def fit(self, variables: Float[Array | np.ndarray, " variable"]) -> PoseFit:
        """Solve the poses of all frames, ``block frame``."""
        return jax.lax.map(
            lambda block: jax.vmap(lambda frame: self._fit(variables, frame))(block), self.frames
        )

    def _skeleton(self, variables: Float[Array | np.ndarray, " variable"], frame: Frames) -> MarkerModel:
        """Skeleton of a frame: changed by the parameters, and markers moved with the skin."""
        changed = self.change.apply(self.model, self.parameters(variables))
        moved = (
            variables[self.sd.shape[0] :] * self.skin.sd * frame.features[np.array(self.skin.features, int)]
        )
        return self._with_moved_skin(changed, moved)

    def _with_moved_skin(self, changed: MarkerModel, moved: Float[Array, " movement"]) -> MarkerModel:
        if not self.skin.markers:
            return changed
        places = (np.array(self.skin.markers), np.array(self.skin.axes))
        locations = jnp.asarray(changed.locations).at[places].add(moved)
        return MarkerModel(changed.structure, changed.carriers, changed.skeleton, locations)

    def _fit(self, variables: Float[Array | np.ndarray, " variable"], frame: Frames) -> PoseFit:
        return fit_frame(self._skeleton(variables, frame), frame.goals, self.pose_bounds, frame.starts)

    def _frame_terms(
        self, variables: Float[Array, " variable"], frame: Frames
    ) -> tuple[Array, Array, Array, Array]:
        """Compute cost, residuals, their Jacobian J, and C with ``C'C = J'K inverse(K'K) K'J``."""
        model = self._skeleton(variables, frame)
        fit = fit_frame(model, frame.goals, self.pose_bounds, frame.starts)
        pose = jnp.asarray(jax.lax.stop_gradient(fit.poses))
        root = jnp.sqrt(frame.goals.weights * frame.precision)[:, None]
        by_variable = self._marker_jacobian(variables, frame, pose) * root[..., None]
        positions, rates, _ = model.motion(pose)
        by_mover = jnp.swapaxes(rates, 0, 1) * root[None]
        by_coordinate = model.by_coordinate(by_mover).reshape(pose.shape[0], -1)
        flat = by_variable.reshape(-1, variables.shape[0])
        residuals = ((positions - frame.goals.measured) * root).reshape(-1)
        # Coordinates held at a bound do not follow the variables.
        slope = expand(model, frame.goals, pose).gradient
        held = ((pose <= self.pose_bounds.lower) & (slope > 0.0)) | (
            (pose >= self.pose_bounds.upper) & (slope < 0.0)
        )
        free = by_coordinate * (1.0 - held)[:, None]
        information = free @ free.T + jnp.diag(frame.goals.value_weights * frame.precision)
        scale = _RIDGE * jnp.maximum(jnp.diagonal(information).max(), 1e-30)
        factor = jnp.linalg.cholesky(information + jnp.diag(scale + held))
        crossed = jsp.linalg.solve_triangular(factor, free @ flat, lower=True)
        return jnp.asarray(fit.cost * frame.precision), residuals, flat, crossed

    def _marker_jacobian(
        self, variables: Float[Array, " variable"], frame: Frames, pose: Float[Array, " coordinate"]
    ) -> Float[Array, "marker 3 variable"]:
        """Differentiate the markers' positions by the variables at a fixed pose."""
        count = self.sd.shape[0]

        def positions(head: Float[Array, " parameter"]) -> Float[Array, "marker 3"]:
            return self._skeleton(jnp.concatenate([head, variables[count:]]), frame).positions(pose)

        by_parameter = jax.jacfwd(positions)(variables[:count]) if count else jnp.zeros((0,))
        if not self.skin.markers:
            return by_parameter
        model, markers = self._skeleton(variables, frame), np.array(self.skin.markers)
        bodies = np.array(model.carriers)[markers]
        rotation = body_poses(model.structure, model.skeleton, pose).rotation[bodies]
        columns = rotation[np.arange(markers.size), :, np.array(self.skin.axes)]
        columns = columns * (self.skin.sd * frame.features[np.array(self.skin.features)])[:, None]
        moved = (markers == np.arange(len(model.carriers))[:, None]) * 1.0
        return jnp.concatenate([by_parameter, moved[:, None, :] * columns.T[None]], axis=-1)


@eqx.filter_jit
def fit_poses(problem: JointProblem, variables: Float[Array | np.ndarray, " variable"]) -> PoseFit:
    """Solve the poses of all frames given the variables, ``block frame``."""
    return problem.fit(variables)


def in_blocks(array: Float[Array | np.ndarray, "frame ..."]) -> Float[np.ndarray, "block frame_in_block ..."]:
    """Cut frames into blocks of `FRAME_BLOCK`; the last frame is repeated to fill the last block."""
    count = len(array)
    rows = np.minimum(np.arange(count + -count % FRAME_BLOCK), count - 1)
    return np.asarray(array)[rows].reshape(-1, FRAME_BLOCK, *array.shape[1:])
