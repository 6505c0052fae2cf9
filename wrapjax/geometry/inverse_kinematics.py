"""Inverse kinematics: the poses of a skeleton whose markers are nearest to measured ones.

In each frame the weighted mean of squared marker distances plus squared differences of coordinates from their
goals is minimised within the bounds of clamped coordinates. This is the cost of OpenSim's inverse kinematics,
``sum_m w_m |x_m - y_m|^2 / sum_m w_m + sum_c v_c (q_c - g_c)^2``, where invisible markers have no weight. The
method is a damped Gauss-Newton method (Levenberg-Marquardt), with second derivatives of the rotations so that
it converges quadratically whatever the distances; coordinates at an active bound are held.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy as jsp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.marker_model import MarkerModel

#: A frame is solved when no coordinate changes by more than this, rad or m.
TOLERANCE = 1e-7
#: Largest number of steps of a frame.
MAX_STEPS = 60
#: Number of successive frames that are solved at once, each from the last pose of those before.
BLOCK = 32
#: Lowest and initial damping, relative to the diagonal of the Gauss-Newton matrix.
MIN_DAMPING, INITIAL_DAMPING = 1e-9, 1e-4


class MarkerGoals(NamedTuple):
    """What poses should meet: measured markers and goals of coordinates.

    Parameters
    ----------
    measured
        Measured positions, m; any number where the weight is zero.
    weights
        Weights of the markers divided by the frame's sum; zero where a marker is not visible.
    values, value_weights
        Goals of the coordinates (rad or m), and their weights (zero without a goal).
    """

    measured: Float[Array | np.ndarray, "frame marker 3"]
    weights: Float[Array | np.ndarray, "frame marker"]
    values: Float[Array | np.ndarray, "frame coordinate"]
    value_weights: Float[Array | np.ndarray, "frame coordinate"]


class Bounds(NamedTuple):
    """Lowest and highest values of the coordinates, rad or m; infinite where they are not clamped."""

    lower: Float[Array | np.ndarray, " coordinate"]
    upper: Float[Array | np.ndarray, " coordinate"]


class PoseFit(NamedTuple):
    """Solution of inverse kinematics.

    Parameters
    ----------
    poses
        Values of the coordinates, rad or m.
    cost
        Cost of each frame, m^2.
    matrix
        Gauss-Newton matrix of each frame, goals of coordinates included.
    steps
        Number of steps that each frame took.
    converged
        Whether each frame met `TOLERANCE`.
    """

    poses: Float[Array | np.ndarray, "frame coordinate"]
    cost: Float[Array | np.ndarray, " frame"]
    matrix: Float[Array | np.ndarray, "frame coordinate coordinate"]
    steps: Float[Array | np.ndarray, " frame"]
    converged: Bool[Array | np.ndarray, " frame"]


class Expansion(NamedTuple):
    """Cost of one frame and its expansion: ``cost + 2 gradient's + s'(gauss_newton + remainder) s``."""

    cost: Float[Array, ""]
    gradient: Float[Array, " coordinate"]
    gauss_newton: Float[Array, "coordinate coordinate"]
    remainder: Float[Array, "coordinate coordinate"]


class _Search(NamedTuple):
    """State of the search in one frame."""

    pose: Float[Array, " coordinate"]
    expansion: Expansion
    damping: Float[Array, ""]
    #: Whether the next step uses the remainder; not after a step that failed.
    exact: Array
    steps: Array
    change: Float[Array, ""]


def expand(model: MarkerModel, goal: MarkerGoals, pose: Float[Array, " coordinate"]) -> Expansion:
    """Compute the cost of one frame and its derivatives by the coordinates.

    The remainder is the sum of residuals times their second derivatives. A rotation with angular velocity w
    turns the velocity v of a marker by a joint further from ground into w x v. Curvature of the functions on
    a joint's axes is left out.

    Parameters
    ----------
    model
        Skeleton with markers.
    goal
        Goals of this frame, without the axis ``frame``.
    pose
        Values of the coordinates.
    """
    positions, rates, angular = model.motion(pose)
    residuals = positions - goal.measured
    off = pose - goal.values
    weighted = goal.weights[:, None] * residuals
    gradient = jnp.einsum("mck,mk->c", rates, weighted)
    turning = jnp.sum(jnp.cross(rates, weighted[:, None, :]), axis=0)
    carried = (angular @ turning.T) * model.carried
    remainder = carried + carried.T - jnp.diag(jnp.diagonal(carried))
    root = jnp.sqrt(goal.weights)[:, None, None] * rates
    flat = jnp.swapaxes(root, 0, 1).reshape(root.shape[1], -1)

    def square(matrix: Float[Array, "mover mover"]) -> Float[Array, "coordinate coordinate"]:
        return model.by_coordinate(model.by_coordinate(matrix).T)

    return Expansion(
        cost=jnp.sum(weighted * residuals) + jnp.sum(goal.value_weights * off**2),
        gradient=model.by_coordinate(gradient) + goal.value_weights * off,
        gauss_newton=square(flat @ flat.T) + jnp.diag(goal.value_weights),
        remainder=square(remainder),
    )


def fit_frame(
    model: MarkerModel,
    goal: MarkerGoals,
    bounds: Bounds,
    start: Float[Array | np.ndarray, " coordinate"],
) -> PoseFit:
    """Solve one frame from a starting pose; arguments and result are without the axis ``frame``."""
    lower, upper = jnp.asarray(bounds.lower), jnp.asarray(bounds.upper)

    def unfinished(search: _Search) -> Array:
        return (search.steps < MAX_STEPS) & (search.change > TOLERANCE)

    def advance(search: _Search) -> _Search:
        pose, here = search.pose, search.expansion
        held = ((pose <= lower) & (here.gradient > 0.0)) | ((pose >= upper) & (here.gradient < 0.0))
        free = 1.0 - held
        diagonal = jnp.diagonal(here.gauss_newton)
        damped = search.damping * (diagonal + 1e-3 * diagonal.max()) + 1e-300
        matrix = here.gauss_newton + search.exact * here.remainder
        matrix = matrix * free[:, None] * free[None, :] + jnp.diag(jnp.where(held, 1.0, damped))
        step = -jsp.linalg.cho_solve((jnp.linalg.cholesky(matrix), True), here.gradient * free)
        possible = jnp.isfinite(step).all()
        trial = jnp.clip(pose + jnp.where(possible, step, 0.0), lower, upper)
        there = expand(model, goal, trial)
        # Near the solution costs are equal to rounding; steps are short there, and are taken.
        better = possible & (there.cost <= here.cost * (1.0 + 1e-14))
        lowered = jnp.maximum(0.1 * search.damping, MIN_DAMPING)
        return _Search(
            pose=jnp.where(better, trial, pose),
            expansion=Expansion(*(jnp.where(better, new, old) for new, old in zip(there, here, strict=True))),
            damping=jnp.where(
                better & jnp.isfinite(here.cost),
                lowered,
                jnp.where(search.exact > 0.0, 1.0, 10.0) * search.damping,
            ),
            exact=jnp.where(better, 1.0, 0.0),
            steps=search.steps + 1,
            change=jnp.where(possible & jnp.isfinite(here.cost), jnp.abs(trial - pose).max(), jnp.inf),
        )

    # The first step leads nowhere and only evaluates the start, so that the expansion is compiled once.
    count = start.shape[0]
    first = _Search(
        pose=jnp.clip(start, lower, upper),
        expansion=Expansion(
            jnp.asarray(jnp.inf), jnp.zeros(count), jnp.eye(count), jnp.zeros((count, count))
        ),
        damping=jnp.asarray(INITIAL_DAMPING),
        exact=jnp.asarray(1.0),
        steps=jnp.asarray(0),
        change=jnp.asarray(jnp.inf),
    )
    last = jax.lax.while_loop(unfinished, advance, first)
    return PoseFit(
        last.pose,
        last.expansion.cost,
        last.expansion.gauss_newton,
        last.steps * 1.0,
        last.change <= TOLERANCE,
    )


@eqx.filter_jit
def fit_block(
    model: MarkerModel,
    goals: MarkerGoals,
    bounds: Bounds,
    starts: Float[Array | np.ndarray, "frame coordinate"],
) -> PoseFit:
    """Solve several frames at once, each from its own starting pose."""
    return jax.vmap(lambda goal, start: fit_frame(model, goal, bounds, start))(goals, starts)


def fit_starts(
    model: MarkerModel, goal: MarkerGoals, bounds: Bounds, starts: Float[np.ndarray, "start coordinate"]
) -> PoseFit:
    """Solve one frame from at most `BLOCK` starting poses; the axis ``frame`` of the result is ``start``."""
    count = len(starts)
    # The block's size is that of other blocks, so that one compiled program serves for both.
    goals = MarkerGoals(*(np.repeat(np.asarray(array)[None], BLOCK, axis=0) for array in goal))
    filled = np.concatenate([starts, starts[-1:].repeat(BLOCK - count, axis=0)])
    fit = fit_block(model, goals, bounds, filled)
    return PoseFit(*(array[:count] for array in fit))


def fit_successive(
    model: MarkerModel, goals: MarkerGoals, bounds: Bounds, start: Float[np.ndarray, " coordinate"]
) -> PoseFit:
    """Solve frames in order of time, blocks of them at once, each block from the last pose of the one before.

    Parameters
    ----------
    model
        Skeleton with markers.
    goals
        Goals.
    bounds
        Bounds of the coordinates.
    start
        Pose near that of the first frame.
    """
    count = len(goals.weights)
    # The last frame is repeated until the blocks are full.
    rows = np.minimum(np.arange(count + -count % BLOCK), count - 1).reshape(-1, BLOCK)
    fits, pose = [], np.asarray(start)
    for block in rows:
        fit = fit_block(
            model, MarkerGoals(*(array[block] for array in goals)), bounds, pose[None].repeat(BLOCK, axis=0)
        )
        fits.append(fit)
        pose = np.asarray(fit.poses[-1])
    return PoseFit(*(np.concatenate(parts)[:count] for parts in zip(*fits, strict=True)))


def fit_first(
    model: MarkerModel,
    goal: MarkerGoals,
    bounds: Bounds,
    ranges: Bounds,
    rest: Float[np.ndarray, " coordinate"],
) -> tuple[Float[np.ndarray, " coordinate"], float]:
    """Find the pose of a frame without a pose near it.

    The body is turned to several directions, and fitted in three steps: by the joint with ground alone, with
    all other coordinates within their ranges, and within the bounds. So joints take no whole turns.

    Parameters
    ----------
    model
        Skeleton with markers.
    goal
        Goals of the frame, without the axis ``frame``.
    bounds
        Bounds of the coordinates.
    ranges
        Ranges of the coordinates, clamped or not.
    rest
        Default values of the coordinates.

    Returns
    -------
    pose, cost
        Pose of the lowest cost, and this cost, m^2.
    """
    lower, upper = np.maximum(bounds.lower, ranges.lower), np.minimum(bounds.upper, ranges.upper)
    rest = np.clip(rest, lower, upper)
    ground = _ground_coordinates(model)
    held = Bounds(np.where(ground, bounds.lower, rest), np.where(ground, bounds.upper, rest))
    within = Bounds(np.where(ground, bounds.lower, lower), np.where(ground, bounds.upper, upper))
    placed = fit_starts(model, goal, held, starting_poses(model, bounds, rest))
    searched = fit_starts(model, goal, within, np.asarray(placed.poses))
    # Of poses that fit equally well, such as after a whole turn, the one nearest to rest.
    cost = np.asarray(searched.cost)
    equal = cost <= cost.min() * (1.0 + 1e-6) + 1e-12
    far = np.where(equal, np.linalg.norm(np.asarray(searched.poses) - rest, axis=1), np.inf)
    last = fit_starts(model, goal, bounds, np.asarray(searched.poses)[[int(np.argmin(far))]])
    return np.asarray(last.poses)[0], float(last.cost[0])


def starting_poses(
    model: MarkerModel, bounds: Bounds, rest: Float[np.ndarray, " coordinate"]
) -> Float[np.ndarray, "start coordinate"]:
    """Choose poses to start the first frame from: at rest, turned to several directions.

    Parameters
    ----------
    model
        Skeleton with markers.
    bounds
        Bounds of the coordinates.
    rest
        Default values of the coordinates.

    Returns
    -------
    Array
        The 24 rotations by right angles, if three coordinates of a joint of ground rotate, else one pose.
    """
    turning = _turning_coordinates(model)
    if len(turning) < 3:
        return np.asarray(rest)[None]
    quarter = 0.5 * np.pi
    # With any order of axes, the second angle lies between -90 and 90 degrees.
    angles = np.array(
        [(a * quarter, 0.0, c * quarter) for a in range(4) for c in range(4)]
        + [(a * quarter, b * quarter, 0.0) for a in range(4) for b in (-1, 1)]
    )
    angles = np.where(angles > np.pi, angles - 2.0 * np.pi, angles)
    starts = np.repeat(np.asarray(rest)[None], len(angles), axis=0)
    starts[:, list(turning[:3])] = angles
    return np.clip(starts, bounds.lower, bounds.upper)


def _ground_coordinates(model: MarkerModel) -> Bool[np.ndarray, " coordinate"]:
    """Whether each coordinate moves a body against ground."""
    structure = model.structure
    moved = {column for joint, column in structure.movers if structure.parents[joint] == 0}
    return np.array([column in moved for column in range(len(structure.coordinates))], dtype=bool)


def _turning_coordinates(model: MarkerModel) -> list[int]:
    """Columns of the coordinates that rotate the first body against ground, in the joint's order."""
    structure = model.structure
    columns: dict[int, None] = {}
    for joint, parent in enumerate(structure.parents):
        for slot in range(structure.rotations if parent == 0 else 0):
            coordinate = structure.moved_by[joint][slot]
            column = structure.root_coordinate(coordinate) if coordinate >= 0 else -1
            if column >= 0:
                columns[column] = None
    return list(columns)
