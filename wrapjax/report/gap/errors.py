"""How far the error shrinks: which fitted effects an outcome speaks of, and what they leave."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.evaluate import moment_errors, pooled_mae
from wrapjax.gap.result import Alternative, Estimate, GapResult
from wrapjax.gap.where.budget import Budget

#: Where shrinkage is told, as fields of `Alternative`.
HELD_OUT = ("held_out_cycles", "held_out_speed")


def leading(result: GapResult) -> tuple[Alternative, ...]:
    """Give the fitted effects that the outcome speaks of: what it names, all of a tie, else the best one."""
    if result.outcome == "tie":
        members = {id for tie in result.ties for id in tie}
        tied = tuple(one for one in result.alternatives if len(one.ids) == 1 and one.ids[0] in members)
        if tied:
            return tied
    named = tuple(one for one in result.alternatives if set(one.ids) == set(result.named))
    return named[:1] or result.alternatives[:1]


def best(result: GapResult) -> Alternative | None:
    """Give the first of them: its moments are those of the model after."""
    return next(iter(leading(result)), None)


def shrinkage(result: GapResult, which: str) -> list[Estimate]:
    """Give the share of the explainable error that each of them removes, those that can be told.

    Parameters
    ----------
    result
        With its alternatives.
    which
        One of `HELD_OUT`.
    """
    return [own for one in leading(result) if (own := getattr(one, which)).known]


def why_no_shrinkage(result: GapResult, which: str) -> str:
    """Say why it cannot be told of any of them; empty where it can of one."""
    if shrinkage(result, which):
        return ""
    first = best(result)
    return "no effect was fitted" if first is None else getattr(first, which).reason


def mean_absolute_errors(result: GapResult) -> dict[str, dict[str, float]]:
    """Give mean absolute errors of cycles that no fit has seen, N m, by coordinate and (``mean``) over them.

    Returns
    -------
    dict
        ``before``: of the plain model; ``after``: with the best explanation; ``floor``: what noise alone
        would leave. NaN where it cannot be told.
    """
    after = best(result)
    return {
        "before": _pooled(result, result.plain),
        "after": _unknown(result) if after is None else _pooled(result, after.predicted),
        "floor": _unknown(result) if result.budget is None else _floor(result, result.budget),
    }


def at_speed(speeds: Float[np.ndarray, " cycle"], speed: float) -> Bool[np.ndarray, " cycle"]:
    """Mark the cycles walked at a speed, m/s; NaN stands for those whose speed is not given."""
    return np.isnan(speeds) if math.isnan(speed) else speeds == speed


def speed_label(speed: float) -> str:
    """Say a speed in words."""
    return "speed not given" if math.isnan(speed) else f"{speed:g} m/s"


def _pooled(result: GapResult, predicted: Float[np.ndarray, "cycle coordinate frame"]) -> dict[str, float]:
    errors = [moment_errors(*pair) for pair in zip(result.measured, predicted, strict=True)]
    return pooled_mae(errors, result.coordinates) or _unknown(result)


def _unknown(result: GapResult) -> dict[str, float]:
    return dict.fromkeys((*result.coordinates, "mean"), math.nan)


def _floor(result: GapResult, budget: Budget) -> dict[str, float]:
    """Give the mean absolute value of noise with these mean squares.

    Noise is taken for normal, whose mean absolute value is sqrt(2 / pi) of its deviation. Each bin has its
    own, as noise comes and goes over the gait cycle; where its estimate fell below zero there is none.
    """
    deviation = np.sqrt(np.maximum(budget.noise, 0.0))
    floor = np.sqrt(2.0 / np.pi) * deviation.mean(axis=(0, 2))
    return dict(zip(result.coordinates, floor.tolist(), strict=True)) | {"mean": float(floor.mean())}
