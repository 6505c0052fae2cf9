"""Noise of recorded markers from the residuals of joint personalisation, and its correlation in time."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from wrapjax.geometry.skeleton.bodies import body_poses, stations
from wrapjax.joints.estimation import JointProblem, fit_poses
from wrapjax.joints.problem import INITIAL_NOISE
from wrapjax.joints.skin import angle_features

#: Lowest standard deviation that is estimated, m: cameras are hardly better.
MIN_NOISE = 0.0002


def estimate_noise(
    problem: JointProblem,
    variables: Float[np.ndarray, " variable"],
    matrix: Float[np.ndarray, "variable variable"],
    counts: Sequence[int],
) -> tuple[float, float]:
    """Estimate the noise of a marker's coordinate, m, and the number of independent frames.

    Parameters
    ----------
    problem, variables
        Problem and its solution.
    matrix
        Gauss-Newton matrix at the solution. A variable takes a degree of freedom as far as markers, and not
        its prior, determine it (MacKay 1992, doi:10.1162/neco.1992.4.3.415).
    counts
        Number of frames of each trial.
    """
    residuals = _residuals(problem, variables, sum(counts))
    visible = np.isfinite(residuals).all(axis=-1).sum(axis=1)
    freedoms = np.maximum(3 * visible - len(problem.model.structure.coordinates), 1)
    determined = float(np.sum(1.0 - np.diagonal(np.linalg.inv(matrix))))
    left = max(float(freedoms.sum()) - determined, 1.0)
    noise = float(np.sqrt(np.nansum(residuals**2) / left))
    independent = sum(_independent_frames(part) for part in np.split(residuals, np.cumsum(counts)[:-1]))
    return max(noise, MIN_NOISE), independent


def _residuals(
    problem: JointProblem, variables: Float[np.ndarray, " variable"], count: int
) -> Float[np.ndarray, "frame marker 3"]:
    """Differences of the model's markers from those measured, m; NaN where a marker was not visible."""
    poses, goals, weights, features, drift = (
        np.concatenate(np.asarray(array))[:count]
        for array in (
            fit_poses(problem, variables).poses,
            problem.frames.goals.measured,
            problem.frames.goals.weights,
            problem.frames.features,
            problem.frames.drift,
        )
    )
    model = problem.change.apply(problem.model, problem.parameters(variables))
    amplitudes = variables[len(problem.sd) :]
    moved = jax.vmap(lambda feature, time: problem.skin.moved(amplitudes, feature, time, model.locations))
    locations = np.asarray(moved(features, drift))
    skeleton = jax.tree.map(np.asarray, model.skeleton)
    positions = stations(body_poses(model.structure, skeleton, poses), np.array(model.carriers), locations)
    return np.where(weights[..., None] > 0.0, positions - goals, np.nan)


def _independent_frames(residuals: Float[np.ndarray, "frame marker 3"]) -> float:
    """Divide the number of frames by the correlation time of residuals, up to its first zero.

    The result is the mean over markers: one that is wrong throughout says nothing of the others.
    """
    filled = np.nan_to_num(residuals)
    count = len(filled)
    spectrum = np.abs(np.fft.rfft(filled, 2 * count, axis=0)) ** 2
    correlation = np.fft.irfft(spectrum.sum(axis=2), axis=0)[:count]
    correlation = correlation[:, correlation[0] > 0.0]
    if not correlation.size:
        return float(count)
    correlation = correlation / correlation[0]
    positive = np.cumprod(correlation > 0.0, axis=0)
    times = 2.0 * (correlation * positive).sum(axis=0) - 1.0
    return float(np.mean(count / np.maximum(times, 1.0)))


def next_round(
    first: JointProblem,
    last: JointProblem,
    variables: Float[np.ndarray, " variable"],
    noise: float,
    independent: float,
) -> JointProblem:
    """Weight frames by noise and independence, and take poses of the last round.

    Angles about the starting model's axes explain the movement of skin less well than about better axes.
    """
    precision = np.asarray(first.frames.precision)
    used = precision > 0.0
    factor = INITIAL_NOISE**2 / noise**2 * min(1.0, independent / used.sum())
    poses = np.asarray(fit_poses(last, variables).poses)
    frames = first.frames._replace(
        precision=precision * factor, starts=poses, features=angle_features(poses, poses[used])
    )
    return JointProblem(
        first.model, first.change, first.skin, frames, first.pose_bounds, first.sd, first.limits
    )
