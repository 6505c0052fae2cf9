"""Groups of gait cycles, their mean and standard deviation, and panels that show curves over the cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.report.formatting import counted
from wrapjax.report.style import BAND_ALPHA, PAGE_WIDTH, Axes, Figure, panel_grid


@runtime_checkable
class MomentCurves(Protocol):
    """Joint moments (N m) of gait cycles: a `CalibrationResult` or curves that were read from a folder."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        ...

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the cycles."""
        ...

    @property
    def uses(self) -> tuple[str, ...]:
        """``calibration`` or ``validation`` for each cycle."""
        ...

    @property
    def tasks(self) -> tuple[str, ...]:
        """Task of each cycle."""
        ...

    @property
    def recordings(self) -> tuple[str, ...]:
        """Name of the recording of each cycle."""
        ...

    @property
    def time(self) -> Float[np.ndarray, "trial frame"]:
        """Time in the recording, s."""
        ...

    @property
    def speeds(self) -> Float[np.ndarray, " trial"]:
        """Walking speed of each cycle, m/s; NaN where unknown."""
        ...

    @property
    def measured(self) -> Float[np.ndarray, "trial coordinate frame"]:
        """Moments by inverse dynamics, N m; NaN where none was measured."""
        ...

    @property
    def modelled(self) -> Float[np.ndarray, "trial coordinate frame"]:
        """Moments predicted by the model from EMG, N m."""
        ...


@dataclass(frozen=True)
class TrialCurves:
    """Measured and modelled joint moments of some trials: the simplest `MomentCurves`."""

    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    tasks: tuple[str, ...]
    recordings: tuple[str, ...]
    time: Float[np.ndarray, "trial frame"]
    speeds: Float[np.ndarray, " trial"]
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]

    @staticmethod
    def of(curves: MomentCurves, chosen: Bool[np.ndarray, " trial"]) -> TrialCurves:
        """Select the chosen trials."""

        def pick(names: tuple[str, ...]) -> tuple[str, ...]:
            return tuple(name for name, keep in zip(names, chosen, strict=True) if keep)

        return TrialCurves(
            curves.coordinates,
            pick(curves.trials),
            pick(curves.uses),
            pick(curves.tasks),
            pick(curves.recordings),
            curves.time[chosen],
            curves.speeds[chosen],
            curves.measured[chosen],
            curves.modelled[chosen],
        )


@dataclass(frozen=True)
class CycleGroup:
    """Cycles that are averaged in one line.

    Parameters
    ----------
    label
        Property that the cycles share; empty if the group holds all cycles.
    keep
        Whether each cycle belongs to the group.
    """

    label: str
    keep: Bool[np.ndarray, " trial"]

    @property
    def count(self) -> str:
        """Number of cycles with its noun."""
        return counted(int(self.keep.sum()), "cycle")


def groups_by_speed(speeds: Float[np.ndarray, " trial"], *, most: int) -> list[CycleGroup]:
    """Group the cycles by walking speed; one group of all if there are more than ``most`` speeds."""
    different = np.unique(speeds)  # NaNs count as one value, the last
    if not 2 <= len(different) <= most:
        return [CycleGroup("", np.ones(len(speeds), dtype=bool))]
    return [
        CycleGroup("speed not given", np.isnan(speeds))
        if np.isnan(speed)
        else CycleGroup(f"{speed:g} m/s", speeds == speed)
        for speed in different
    ]


def groups_by_speed_and_use(result: MomentCurves, *, most_speeds: int) -> list[CycleGroup]:
    """Group the cycles by speed and, within a speed, by use; groups without cycles are omitted."""
    groups = []
    for speed in groups_by_speed(result.speeds, most=most_speeds):
        for use in ("calibration", "validation"):
            keep = speed.keep & np.array([entry == use for entry in result.uses])
            if keep.any():
                groups.append(CycleGroup(f"{speed.label}, {use}".lstrip(", "), keep))
    return groups


@dataclass(frozen=True)
class Spread:
    """Mean over cycles and mean plus or minus one standard deviation, which is zero for a single cycle."""

    mean: Float[np.ndarray, " frame"]
    low: Float[np.ndarray, " frame"]
    high: Float[np.ndarray, " frame"]


def spread(curves: Float[np.ndarray, "trial frame"]) -> Spread:
    """Compute mean and sample standard deviation over cycles at each point of the gait cycle."""
    mean = curves.mean(axis=0)
    deviation = curves.std(axis=0, ddof=1) if len(curves) > 1 else np.zeros_like(mean)
    return Spread(mean, mean - deviation, mean + deviation)


def mark_gait_cycle(panel: Axes, step: int) -> None:
    """Make a panel's horizontal axis the gait cycle from 0 to 100 % with ticks every ``step`` %.

    The outer tick labels are aligned inwards, because those of neighboring panels would overlap.
    """
    panel.set_xlim(0, 100)
    panel.set_xticks(range(0, 101, step))
    ticks = panel.xaxis.get_major_ticks()
    ticks[0].label1.set_horizontalalignment("left")
    ticks[-1].label1.set_horizontalalignment("right")


def label_gait_cycles(
    panels: Sequence[Axes], columns: int, *, y: str = "", x: str = "gait cycle (%)", step: int = 20
) -> None:
    """Make the horizontal axis of all panels of a grid the gait cycle.

    Parameters
    ----------
    panels, columns
        Panels row by row, and number of columns.
    y, x
        Axis labels of the first panel of each row and of the last panel of each column.
    step
        Distance of ticks, %.
    """
    for number, panel in enumerate(panels):
        if y and number % columns == 0:
            panel.set_ylabel(y)
        if number >= len(panels) - columns:
            panel.set_xlabel(x)
        mark_gait_cycle(panel, step)


def moment_grid(coordinates: int, groups: int, *, panel_height: float) -> tuple[Figure, list[Axes], int]:
    """Make panels for moments: one row a coordinate and one column a group of cycles.

    Where there is one group, up to three coordinates are side by side.

    Returns
    -------
    figure, panels, columns
        Panels in the order of coordinates and, within a coordinate, of groups.
    """
    single = groups == 1
    columns = min(3, coordinates) if single else groups
    figure, panels = panel_grid(
        coordinates * groups,
        columns,
        width=PAGE_WIDTH if columns > 1 else PAGE_WIDTH / 2,
        panel_height=panel_height,
        sharex=True,
        sharey=False if single else "row",
    )
    return figure, panels, columns


def draw_spread(panel: Axes, curves: Float[np.ndarray, "trial frame"], color: str, label: str) -> None:
    """Draw the mean over cycles and a band of plus and minus one standard deviation."""
    shape = spread(curves)
    percent = np.linspace(0.0, 100.0, len(shape.mean))
    if len(curves) > 1:
        panel.fill_between(percent, shape.low, shape.high, color=color, alpha=BAND_ALPHA, linewidth=0)
    panel.plot(percent, shape.mean, color=color, label=label)
