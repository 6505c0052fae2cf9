"""Figures that compare methods: joint moments and moment arms over the gait cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.comparison.samples import ComparedLeg, CycleGroup, all_cycles, group_by_speed
from wrapjax.report.calibration.run_summary import USES
from wrapjax.report.cycle_panels import draw_spread, label_gait_cycles, moment_grid
from wrapjax.report.formatting import counted
from wrapjax.report.style import (
    BLACK,
    GROUP_COLORS,
    PAGE_WIDTH,
    Axes,
    Figure,
    draw_zero_line,
    head_column,
    in_style,
    legend_above,
    panel_grid,
)
from wrapjax.subject.subject import name_without_side

#: Number of moment arms that are drawn, those that changed most.
MOST_PANELS = 12
# Largest number of speeds that are drawn separately; with more columns, panels are too small to read.
_MOST_SPEEDS = 2

#: Function that reads the curves of one leg, one per cycle; empty if the leg has no such curves.
Curves = Callable[[CalibrationResult], Float[np.ndarray, "trial frame"]]


def drawn_together(legs: Sequence[ComparedLeg], unit: str) -> list[tuple[str, list[ComparedLeg]]]:
    """Group legs for figures: all in one figure if the leg is the unit of analysis, else one figure each.

    Returns
    -------
    list
        Label and legs of each figure.
    """
    if unit == "leg":
        return [(f"all {counted(len(legs), 'leg')}", list(legs))]
    return [(leg.label, [leg]) for leg in legs]


@in_style
def compared_moments_figure(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> Figure:
    """Draw each method's joint moments and the measured moments.

    Parameters
    ----------
    legs
        One leg, whose cycles are averaged, or several, whose averages are averaged.
    methods
        Methods to draw, one color each.
    """
    groups = _groups(legs)
    names = _coordinates(legs)
    figure, panels, columns = moment_grid(len(names), len(groups), panel_height=1.9)
    for number, panel in enumerate(panels):
        row, column = divmod(number, len(groups))
        name, group = names[row], groups[column]
        draw_zero_line(panel)
        draw_spread(
            panel, _curves(legs, methods[0], group, _moment_reader(name, "measured")), BLACK, "measured"
        )
        for method, color in zip(methods, method_colors(methods), strict=True):
            _draw_mean(panel, _curves(legs, method, group, _moment_reader(name, "modelled")), color, method)
        panel.set_title(name, loc="left", parse_math=False)
        if len(groups) > 1 and row == 0:
            head_column(panel, group.label)
    label_gait_cycles(panels, columns, y="moment (N m)")
    legend_above(figure, panels[0])
    return figure


@in_style
def compared_moment_arms_figure(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> Figure:
    """Draw the moment arms that changed most, nominal and by each method that changes paths."""
    pairs = most_moved(legs, methods)
    kind = all_cycles(legs)
    columns = min(4, len(pairs))
    figure, panels = panel_grid(
        len(pairs), columns, width=PAGE_WIDTH * columns / 4, panel_height=1.7, sharex=True
    )
    colors = dict(zip(methods, method_colors(methods), strict=True))
    for panel, (muscle, coordinate) in zip(panels, pairs, strict=True):
        draw_zero_line(panel)
        before = _moment_arm_reader(muscle, coordinate, before=True)
        _draw_mean(panel, _curves(legs, methods[0], kind, before), BLACK, "nominal", linestyle="--")
        for method in methods_that_move(legs, methods):
            curves = _curves(legs, method, kind, _moment_arm_reader(muscle, coordinate, before=False))
            draw_spread(panel, curves, colors[method], method)
        panel.set_title(f"{muscle}\n{coordinate}", loc="left", parse_math=False)
    label_gait_cycles(panels, columns, y="moment arm (mm)", step=50)
    legend_above(figure, panels[0])
    return figure


def method_colors(methods: Sequence[str]) -> list[str]:
    """Choose the color of each method, the same in all figures."""
    return [GROUP_COLORS[number % len(GROUP_COLORS)] for number in range(len(methods))]


def methods_that_move(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> list[str]:
    """List the methods that changed the path of any muscle."""
    return [method for method in methods if any(np.any(_arm_changes(leg.results[method])) for leg in legs)]


def most_moved(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> list[tuple[str, str]]:
    """List muscle and coordinate of the moment arms that any method changed most, largest change first.

    Changes are mean absolute changes, averaged over the legs that have the muscle.
    """
    changes: dict[tuple[str, str], list[float]] = {}
    for leg in legs:
        largest = np.max([_arm_changes(result) for result in leg.results.values()], axis=0)
        for muscle, row in zip(leg.recorded.muscles, largest, strict=True):
            for coordinate, change in zip(leg.recorded.coordinates, row.tolist(), strict=True):
                pair = (name_without_side(muscle), name_without_side(coordinate))
                changes.setdefault(pair, []).append(change)
    means = {pair: float(np.mean(values)) for pair, values in changes.items()}
    order = sorted((pair for pair in means if means[pair] > 0.0), key=lambda pair: -means[pair])
    return order[:MOST_PANELS]


def _arm_changes(result: CalibrationResult) -> Float[np.ndarray, "muscle coordinate"]:
    before, after = result.initial_states.path.moment_arm, result.states.path.moment_arm
    return np.abs(np.asarray(after) - np.asarray(before)).mean(axis=(1, 3))


def _groups(legs: Sequence[ComparedLeg]) -> list[CycleGroup]:
    """Group cycles by use and, if there are few speeds, by speed; groups without cycles are omitted."""
    groups = []
    for use in USES:
        kinds = group_by_speed(legs, use)
        kinds = kinds[:-1] if 1 < len(kinds) <= _MOST_SPEEDS + 1 else kinds[-1:]
        for kind in kinds:
            label = use if len(kinds) == 1 else f"{use}, {kind.label}"
            if kind.count:
                groups.append(CycleGroup(f"{label} ({counted(kind.count, 'cycle')})", kind.keep))
    return groups


def _coordinates(legs: Sequence[ComparedLeg]) -> list[str]:
    names = [name_without_side(name) for leg in legs for name in leg.recorded.coordinates]
    return list(dict.fromkeys(names))


def _curves(
    legs: Sequence[ComparedLeg], method: str, kind: CycleGroup, read: Curves
) -> Float[np.ndarray, "unit frame"]:
    """Collect curves of one leg's cycles, or of several legs' averages; legs without curves are omitted."""
    collected = []
    for leg, keep in zip(legs, kind.keep, strict=True):
        curves = read(leg.results[method])
        if len(curves) and keep.any():
            curves = curves[keep]
            collected.append(curves if len(legs) == 1 else curves.mean(axis=0, keepdims=True))
    return np.concatenate(collected) if collected else np.full((1, 2), np.nan)


def _moment_reader(name: str, which: str) -> Curves:
    """Make a function that reads the ``which`` (measured or modelled) moments about a coordinate, N m."""

    def read(result: CalibrationResult) -> Float[np.ndarray, "trial frame"]:
        names = [name_without_side(coordinate) for coordinate in result.coordinates]
        moments = getattr(result, which)
        return moments[:, names.index(name)] if name in names else moments[:0, 0]

    return read


def _moment_arm_reader(muscle: str, coordinate: str, *, before: bool) -> Curves:
    """Make a function that reads a moment arm before or after calibration, mm."""

    def read(result: CalibrationResult) -> Float[np.ndarray, "trial frame"]:
        muscles = [name_without_side(name) for name in result.muscles]
        coordinates = [name_without_side(name) for name in result.coordinates]
        states = result.initial_states if before else result.states
        arms = 1e3 * np.asarray(states.path.moment_arm)
        if muscle not in muscles or coordinate not in coordinates:
            return arms[0, :0, 0]
        return arms[muscles.index(muscle), :, coordinates.index(coordinate)]

    return read


def _draw_mean(
    panel: Axes, curves: Float[np.ndarray, "unit frame"], color: str, label: str, linestyle: str = "-"
) -> None:
    mean = curves.mean(axis=0)
    percent = np.linspace(0.0, 100.0, len(mean))
    panel.plot(percent, mean, color=color, label=label, linestyle=linestyle, zorder=3)
