"""Least-squares problem of joint personalisation, with the pose of every frame eliminated exactly.

Variables are freed parameters in units of their prior standard deviations. Given these, each frame's pose
solves inverse kinematics, so that the cost is a function of the variables alone (variable projection, Golub &
Pereyra 1973, doi:10.1137/0710036). By the envelope theorem its gradient is the partial one. Its Gauss-Newton
matrix is that of all unknowns with each frame's pose eliminated by the Schur complement (Kaufman 1975,
doi:10.1007/BF01932995): with residuals r, Jacobians J of the variables and K of the pose,
``sum over frames of J'J - J'K inverse(K'K) K'J``. One step costs about as much as inverse kinematics.

Skin moves over bone. The amplitudes of these movements (`wrapjax.joints.skin`) are variables too.
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
from wrapjax.geometry.skeleton.bodies import body_poses
from wrapjax.joints.changed_skeleton import SkeletonChange
from wrapjax.joints.skin import SkinMovement

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
        Functions of the joint angles, with which skin moves.
    drift
        Functions of time by which skin drifts.
    starts
        Poses near the solutions.
    """

    goals: MarkerGoals
    precision: Float[Array | np.ndarray, "block frame"]
    features: Float[Array | np.ndarray, "block frame feature"]
    drift: Float[Array | np.ndarray, "block frame function"]
    starts: Float[Array | np.ndarray, "block frame coordinate"]


class _FrameTerms(NamedTuple):
    """Terms of one frame.

    Of the variables, parameters and movements with joint angles (``head``) have Jacobians J and C, with
    ``C'C = J'K inverse(K'K) K'J``. Movements of drifting markers along the axes of their bodies (``place``)
    have Jacobians of their own; a variable of the drift is such a movement times a function of time.
    """

    cost: Float[Array, ""]
    head_gradient: Float[Array, " head"]
    head: Float[Array, "row head"]
    head_followed: Float[Array, "coordinate head"]
    place_gradient: Float[Array, " place"]
    crossed: Float[Array, "place head"]
    places: Float[Array, "place place"]


class JointProblem(AbstractLeastSquares):
    """Least-squares problem of joint personalisation.

    Parameters
    ----------
    model
        Starting skeleton with markers.
    change
        Map from parameters to skeletons.
    skin
        Movements of skin; their amplitudes are variables after the parameters.
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
        return np.concatenate([self.limits[0] / self.sd, np.full(self.skin.count, -1e6)])

    @property
    def upper(self) -> Float[np.ndarray, " variable"]:
        """Upper bounds."""
        return np.concatenate([self.limits[1] / self.sd, np.full(self.skin.count, 1e6)])

    def parameters(
        self, variables: Float[Array | np.ndarray, " variable"]
    ) -> Float[Array | np.ndarray, " parameter"]:
        """Values of the parameters in their units."""
        return variables[: self.sd.shape[0]] * self.sd

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute the cost, half its gradient and its Gauss-Newton matrix."""
        count = variables.shape[0]
        places, functions = 3 * len(self.skin.drifting), self.skin.functions
        head = count - places * functions

        def add(total: tuple[Array, ...], block: Frames) -> tuple[tuple[Array, ...], None]:
            frames = jax.vmap(lambda frame: self._frame_terms(variables, frame))(block)
            drift = jnp.asarray(block.drift)
            # One product of tall matrices is far quicker than one a frame.
            tall, wide = (array.reshape(-1, head) for array in (frames.head, frames.head_followed))
            squares = (drift[:, :, None] * drift[:, None, :]).reshape(len(drift), functions**2)
            terms = (
                frames.cost.sum(),
                frames.head_gradient.sum(axis=0),
                tall.T @ tall - wide.T @ wide,
                drift.T @ frames.place_gradient,
                drift.T @ frames.crossed.reshape(len(drift), places * head),
                squares.T @ frames.places.reshape(len(drift), places**2),
            )
            return tuple(one + other for one, other in zip(total, terms, strict=True)), None

        shapes = [(), (head,), (head, head), (functions, places)]
        shapes += [(functions, places * head), (functions**2, places**2)]
        sums, _ = jax.lax.scan(add, tuple(jnp.zeros(shape) for shape in shapes), self.frames)
        cost, gradient, matrix, drift_gradient, crossed, squares = sums
        gradient = jnp.concatenate([gradient, drift_gradient.reshape(-1)])
        crossed = crossed.reshape(functions * places, head)
        squares = squares.reshape(functions, functions, places, places).transpose(0, 2, 1, 3)
        squares = squares.reshape(functions * places, functions * places)
        matrix = jnp.block([[matrix, crossed.T], [crossed, squares]])
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
        amplitudes = variables[self.sd.shape[0] :]
        locations = self.skin.moved(amplitudes, frame.features, frame.drift, changed.locations)
        return MarkerModel(changed.structure, changed.carriers, changed.skeleton, locations)

    def _fit(self, variables: Float[Array | np.ndarray, " variable"], frame: Frames) -> PoseFit:
        return fit_frame(self._skeleton(variables, frame), frame.goals, self.pose_bounds, frame.starts)

    def _frame_terms(self, variables: Float[Array, " variable"], frame: Frames) -> _FrameTerms:
        model = self._skeleton(variables, frame)
        fit = fit_frame(model, frame.goals, self.pose_bounds, frame.starts)
        pose = jnp.asarray(jax.lax.stop_gradient(fit.poses))
        root = jnp.sqrt(frame.goals.weights * frame.precision)[:, None]
        positions, rates, _ = model.motion(pose)
        by_mover = jnp.swapaxes(rates, 0, 1) * root[None]
        by_coordinate = model.by_coordinate(by_mover).reshape(pose.shape[0], -1)
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
        # Velocities of the markers with movements along the axes of their bodies.
        rotation = body_poses(model.structure, model.skeleton, pose).rotation[np.array(model.carriers)]
        rotation = rotation * root[..., None]
        head = self._head_jacobian(variables, frame, pose, rotation, root)
        drifting = np.array(self.skin.drifting, dtype=int)
        turned = rotation[drifting]
        by_place = jnp.einsum("cmk,mka->cma", free.reshape(len(free), -1, 3)[:, drifting], turned)
        # One solve: two that run at once may wait for each other in XLA's pool of threads.
        sides = jnp.concatenate([free @ head, by_place.reshape(len(free), 3 * drifting.size)], axis=1)
        solved = jsp.linalg.solve_triangular(factor, sides, lower=True)
        followed, place_followed = jnp.split(solved, [head.shape[-1]], axis=1)
        rows = head.reshape(len(rotation), 3, head.shape[-1])[drifting]
        crossed = jnp.einsum("mka,mkv->mav", turned, rows)
        crossed = crossed.reshape(3 * drifting.size, head.shape[-1])
        own = jnp.repeat(root[drifting, 0] ** 2, 3, total_repeat_length=3 * drifting.size)
        return _FrameTerms(
            cost=jnp.asarray(fit.cost * frame.precision),
            head_gradient=head.T @ residuals,
            head=head,
            head_followed=followed,
            place_gradient=self.skin.drift_sd
            * jnp.einsum("mka,mk->ma", turned, residuals.reshape(-1, 3)[drifting]).ravel(),
            crossed=self.skin.drift_sd * (crossed - place_followed.T @ followed),
            places=self.skin.drift_sd**2 * (jnp.diag(own) - place_followed.T @ place_followed),
        )

    def _head_jacobian(
        self,
        variables: Float[Array, " variable"],
        frame: Frames,
        pose: Float[Array, " coordinate"],
        rotation: Float[Array, "marker 3 3"],
        root: Float[Array, "marker 1"],
    ) -> Float[Array, "row head"]:
        """Differentiate weighted markers by parameters and movements with angles, at a fixed pose."""
        count = self.sd.shape[0]

        def positions(parameters: Float[Array, " parameter"]) -> Float[Array, "marker 3"]:
            return root * self._skeleton(jnp.concatenate([parameters, variables[count:]]), frame).positions(
                pose
            )

        by_parameter = jax.jacfwd(positions)(variables[:count])
        markers = np.array(self.skin.markers, dtype=int)
        columns = rotation[markers, :, np.array(self.skin.axes, dtype=int)]
        lengths = self.skin.sd * frame.features[np.array(self.skin.features, dtype=int)]
        own = (markers == np.arange(len(rotation))[:, None]) * 1.0
        by_movement = own[:, None, :] * (columns * lengths[:, None]).T[None]
        return jnp.concatenate([by_parameter, by_movement], axis=-1).reshape(-1, count + markers.size)


@eqx.filter_jit
def fit_poses(problem: JointProblem, variables: Float[Array | np.ndarray, " variable"]) -> PoseFit:
    """Solve the poses of all frames given the variables, ``block frame``."""
    return problem.fit(variables)


def in_blocks(array: Float[Array | np.ndarray, "frame ..."]) -> Float[np.ndarray, "block frame_in_block ..."]:
    """Cut frames into blocks of `FRAME_BLOCK`; the last frame is repeated to fill the last block."""
    count = len(array)
    rows = np.minimum(np.arange(count + -count % FRAME_BLOCK), count - 1)
    return np.asarray(array)[rows].reshape(len(rows) // FRAME_BLOCK, FRAME_BLOCK, *array.shape[1:])
