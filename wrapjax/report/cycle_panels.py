"""Groups of gait cycles that are drawn together, their mean and spread, and how a panel shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.report.style import BAND_ALPHA, Axes


@runtime_checkable
class MomentCurves(Protocol):
    """Joint moments (N m) of gait cycles: a `CalibrationResult`, or what was read back from a folder."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names along the axis of coordinates."""
        ...

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the cycles."""
        ...

    @property
    def uses(self) -> tuple[str, ...]:
        """``calibration`` or ``validation``, one a cycle."""
        ...

    @property
    def speeds(self) -> Float[np.ndarray, " trial"]:
        """In m/s, NaN where unknown."""
        ...

    @property
    def measured(self) -> Float[np.ndarray, "trial coordinate frame"]:
        """By inverse dynamics."""
        ...

    @property
    def modelled(self) -> Float[np.ndarray, "trial coordinate frame"]:
        """From EMG."""
        ...


@dataclass(frozen=True)
class CycleGroup:
    """Cycles that one line stands for.

    Parameters
    ----------
    label
        What they have in common; empty if they are all there are.
    keep
        Which cycles.
    """

    label: str
    keep: Bool[np.ndarray, " trial"]

    @property
    def count(self) -> str:
        """Number of cycles in words."""
        number = int(self.keep.sum())
        return f"{number} cycle{'' if number == 1 else 's'}"


def groups_by_speed(speeds: Float[np.ndarray, " trial"], *, most: int) -> list[CycleGroup]:
    """Group the cycles by walking speed; all in one group where there are more than ``most`` speeds."""
    different = np.unique(speeds)  # NaNs count as one, the last
    if not 2 <= len(different) <= most:
        return [CycleGroup("", np.ones(len(speeds), dtype=bool))]
    return [
        CycleGroup("speed not given", np.isnan(speeds))
        if np.isnan(speed)
        else CycleGroup(f"{speed:g} m/s", speeds == speed)
        for speed in different
    ]


def groups_by_speed_and_use(result: MomentCurves, *, most_speeds: int) -> list[CycleGroup]:
    """Group the cycles by speed and, within a speed, by use; groups without cycles are left out."""
    groups = []
    for speed in groups_by_speed(result.speeds, most=most_speeds):
        for use in ("calibration", "validation"):
            keep = speed.keep & np.array([entry == use for entry in result.uses])
            if keep.any():
                groups.append(CycleGroup(f"{speed.label}, {use}".lstrip(", "), keep))
    return groups


@dataclass(frozen=True)
class Spread:
    """Mean over cycles and one standard deviation to either side; both are the mean of a single cycle."""

    mean: Float[np.ndarray, " frame"]
    low: Float[np.ndarray, " frame"]
    high: Float[np.ndarray, " frame"]


def spread(curves: Float[np.ndarray, "trial frame"]) -> Spread:
    """Summarize a curve over cycles, point by point of the gait cycle."""
    mean = curves.mean(axis=0)
    deviation = curves.std(axis=0, ddof=1) if len(curves) > 1 else np.zeros_like(mean)
    return Spread(mean, mean - deviation, mean + deviation)


def mark_gait_cycle(panel: Axes, step: int) -> None:
    """Mark 0 to 100 %; the outer labels stay inside, or those of neighbors meet."""
    panel.set_xlim(0, 100)
    panel.set_xticks(range(0, 101, step))
    ticks = panel.xaxis.get_major_ticks()
    ticks[0].label1.set_horizontalalignment("left")
    ticks[-1].label1.set_horizontalalignment("right")


def draw_spread(panel: Axes, curves: Float[np.ndarray, "trial frame"], color: str, label: str) -> None:
    """Draw the mean over cycles and a band of one standard deviation."""
    shape = spread(curves)
    percent = np.linspace(0.0, 100.0, len(shape.mean))
    if len(curves) > 1:
        panel.fill_between(percent, shape.low, shape.high, color=color, alpha=BAND_ALPHA, linewidth=0)
    panel.plot(percent, shape.mean, color=color, label=label)
