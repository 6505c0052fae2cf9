"""Errors of joint moments by coordinate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from wrapjax.subject.trials import Trials


@dataclass(frozen=True)
class MomentErrors:
    """Errors of the joint moments of one trial by coordinate, N m; NaN about coordinates not measured."""

    mean_absolute: Float[np.ndarray, " coordinate"]
    root_mean_square: Float[np.ndarray, " coordinate"]
    #: Number of frames with a measured moment.
    frames: Int[np.ndarray, " coordinate"]


def moment_errors(
    measured: Float[np.ndarray, "coordinate frame"], modelled: Float[np.ndarray, "coordinate frame"]
) -> MomentErrors:
    """Compute the errors of modelled moments (N m) over the measured frames of one trial."""
    error = modelled - measured
    known = np.isfinite(measured)
    frames = known.sum(axis=-1)
    if known.all():
        return MomentErrors(np.abs(error).mean(axis=-1), np.sqrt((error**2).mean(axis=-1)), frames)
    kept, count = np.where(known, error, 0.0), np.where(frames > 0, frames, np.nan)
    return MomentErrors(np.abs(kept).sum(axis=-1) / count, np.sqrt((kept**2).sum(axis=-1) / count), frames)


def pooled_mae(errors: Sequence[MomentErrors], coordinates: Sequence[str]) -> dict[str, float] | None:
    """Average the mean absolute errors of cycles, by coordinate and (``mean``) over coordinates.

    The mean is over all frames with a measured moment. A coordinate about which none was measured is left
    out. None if there is no trial or no measured moment.
    """
    return _pooled([(one.mean_absolute, one.frames) for one in errors], coordinates)


def pooled_rmse(errors: Sequence[MomentErrors], coordinates: Sequence[str]) -> dict[str, float] | None:
    """Pool root mean square errors (N m) over the frames of all trials, by coordinate.

    ``mean`` is their average over coordinates. See `pooled_mae` about moments that were not measured.
    """
    return _pooled(
        [(one.root_mean_square**2, one.frames) for one in errors], coordinates, lambda mean: np.sqrt(mean)
    )


def _pooled(
    errors: Sequence[tuple[np.ndarray, np.ndarray]],
    coordinates: Sequence[str],
    finish: Callable[[np.ndarray], np.ndarray] = lambda mean: mean,
) -> dict[str, float] | None:
    if not errors:
        return None
    values, frames = (np.array(part) for part in zip(*errors, strict=True))
    count = frames.sum(axis=0)
    if (frames == frames[0, 0]).all():
        mean = finish(np.mean(values, axis=0))
    else:
        total = np.where(frames > 0, values * frames, 0.0).sum(axis=0)
        mean = finish(total / np.where(count > 0, count, np.nan))
    if not count.any():
        return None
    by_name = {name: float(mean[row]) for row, name in enumerate(coordinates) if count[row]}
    return by_name | {"mean": float(mean[count > 0].mean())}


@dataclass(frozen=True)
class TaskErrors:
    """Errors of the moments about one coordinate in all trials of one task.

    Parameters
    ----------
    task, coordinate
        Task, and name of the coordinate.
    mae, rmse
        Mean absolute and root mean square error, N m.
    r2
        Share of the variance of the measured moment about its mean that the model explains; negative where
        the mean explains more. NaN where the measured moment is constant.
    seconds
        Time for which the moment was measured, s.
    """

    task: str
    coordinate: str
    mae: float
    rmse: float
    r2: float
    seconds: float


@dataclass(frozen=True)
class LeftOutTask:
    """Errors about one coordinate in one task, of the model calibrated without it and with all.

    Parameters
    ----------
    without
        Errors of the model that was calibrated on the other tasks.
    with_all
        Errors of the model that was calibrated on all tasks.
    converged
        Whether the calibration without the task converged.
    """

    without: TaskErrors
    with_all: TaskErrors
    converged: bool


def errors_by_task(
    trials: Trials, modelled: Float[np.ndarray, "trial coordinate frame"]
) -> tuple[TaskErrors, ...]:
    """Compute the errors of modelled moments (N m) for every task and every coordinate measured in it."""
    step = np.diff(trials.time[:, :2], axis=1)[:, :1]
    rows = []
    for task in dict.fromkeys(trials.tasks):
        own = np.array([entry == task for entry in trials.tasks])
        for place, coordinate in enumerate(trials.moment_coordinates):
            measured = trials.moments[own, place]
            known = np.isfinite(measured)
            if not known.any():
                continue
            error = modelled[own, place][known] - measured[known]
            spread = float(np.square(measured[known] - measured[known].mean()).sum())
            rows.append(
                TaskErrors(
                    task,
                    coordinate,
                    float(np.abs(error).mean()),
                    float(np.sqrt(np.square(error).mean())),
                    1.0 - float(np.square(error).sum()) / spread if spread > 0.0 else float("nan"),
                    float((known * step[own]).sum()),
                )
            )
    return tuple(rows)
