"""Figures of methods beside one another: joint moments and moment arms over the gait cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.result import CalibrationResult
from wrapjax.comparison.samples import ComparedLeg, CycleGroup, all_cycles, group_by_speed
from wrapjax.report.moment_curves import draw_spread, mark_gait_cycle
from wrapjax.report.run_summary import USES
from wrapjax.report.style import (
    BLACK,
    GROUP_COLORS,
    LIGHT_GRAY,
    PAGE_WIDTH,
    Axes,
    Figure,
    counted,
    in_style,
    panel_grid,
)
from wrapjax.subject.subject import name_without_side

#: As many moment arms are drawn, those that changed most.
MOST_PANELS = 12
# More groups of cycles than these side by side cannot be read.
_MOST_SPEEDS = 2

#: Curves of one leg, one a cycle.
Curves = Callable[[CalibrationResult], Float[np.ndarray, "trial frame"]]


def drawn_together(legs: Sequence[ComparedLeg], unit: str) -> list[tuple[str, list[ComparedLeg]]]:
    """Say which legs one figure shows, each with a label: all where the leg is the unit, else one each."""
    if unit == "leg":
        return [(f"all {counted(len(legs), 'leg')}", list(legs))]
    return [(leg.label, [leg]) for leg in legs]


@in_style
def compared_moments_figure(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> Figure:
    """Draw each method's joint moments over the measured ones.

    Parameters
    ----------
    legs
        One, whose cycles are drawn, or several, each by its average.
    methods
        One color each.
    """
    groups = _groups(legs)
    names = _coordinates(legs)
    wrapped = len(groups) == 1
    columns = min(3, len(names)) if wrapped else len(groups)
    count = len(names) * len(groups)
    figure, panels = panel_grid(
        count,
        columns,
        width=PAGE_WIDTH if columns > 1 else PAGE_WIDTH / 2,
        panel_height=1.9,
        sharex=True,
        sharey=False if wrapped else "row",
    )
    for number, panel in enumerate(panels):
        row, column = divmod(number, len(groups))
        name, group = names[row], groups[column]
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        draw_spread(
            panel, _curves(legs, methods[0], group, _of_coordinate(name, "measured")), BLACK, "measured"
        )
        for method, color in zip(methods, method_colors(methods), strict=True):
            _draw_mean(panel, _curves(legs, method, group, _of_coordinate(name, "modelled")), color, method)
        panel.set_title(name, loc="left", parse_math=False)
        if not wrapped and row == 0:
            panel.annotate(
                group.label,
                (0.0, 1.0),
                xytext=(0, 18),
                xycoords="axes fraction",
                textcoords="offset points",
                fontweight="bold",
            )
        if number % columns == 0:
            panel.set_ylabel("moment (N m)")
        if number >= count - columns:
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    labels = panels[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside upper left", ncols=len(labels[1]))
    return figure


@in_style
def compared_moment_arms_figure(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> Figure:
    """Draw the moment arms that any method changed most, nominal and by each method that changes paths."""
    pairs = most_moved(legs, methods)
    kind = all_cycles(legs)
    columns = min(4, len(pairs))
    figure, panels = panel_grid(
        len(pairs), columns, width=PAGE_WIDTH * columns / 4, panel_height=1.7, sharex=True
    )
    colors = dict(zip(methods, method_colors(methods), strict=True))
    for number, (panel, (muscle, coordinate)) in enumerate(zip(panels, pairs, strict=True)):
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        before = _of_arm(muscle, coordinate, before=True)
        _draw_mean(panel, _curves(legs, methods[0], kind, before), BLACK, "nominal", linestyle="--")
        for method in methods_that_move(legs, methods):
            curves = _curves(legs, method, kind, _of_arm(muscle, coordinate, before=False))
            draw_spread(panel, curves, colors[method], method)
        panel.set_title(f"{muscle}\n{coordinate}", loc="left", parse_math=False)
        if number % columns == 0:
            panel.set_ylabel("moment arm (mm)")
        if number >= len(pairs) - columns:
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=50)
    labels = panels[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside upper left", ncols=len(labels[1]))
    return figure


def method_colors(methods: Sequence[str]) -> list[str]:
    """Give each method its color, the same in all figures."""
    return [GROUP_COLORS[number % len(GROUP_COLORS)] for number in range(len(methods))]


def methods_that_move(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> list[str]:
    """Name the methods that changed the path of any muscle."""
    return [method for method in methods if any(np.any(_arm_changes(leg.results[method])) for leg in legs)]


def most_moved(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> list[tuple[str, str]]:
    """Name muscle and coordinate of the moment arms that any method changed most, largest change first.

    Changes are mean absolute ones, averaged over the legs that have the muscle.
    """
    changes: dict[tuple[str, str], list[float]] = {}
    for leg in legs:
        own = np.max([_arm_changes(result) for result in leg.results.values()], axis=0)
        for muscle, row in zip(leg.recorded.muscles, own, strict=True):
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
    """Sort cycles by speed, if there are few, and by use; groups without cycles are left out."""
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
    """Read curves off one leg's cycles, or off several legs' averages; legs without any are left out."""
    found = []
    for leg, keep in zip(legs, kind.keep, strict=True):
        own = read(leg.results[method])
        own = own[_of(keep, len(own))]
        if len(own):
            found.append(own if len(legs) == 1 else own.mean(axis=0, keepdims=True))
    return np.concatenate(found) if found else np.full((1, 2), np.nan)


def _of(keep: Bool[np.ndarray, " trial"], count: int) -> Bool[np.ndarray, " kept"]:
    """Mark what to keep of the curves of a leg; none where it has no such curves."""
    return keep if count else np.zeros(0, dtype=bool)


def _of_coordinate(name: str, which: str) -> Curves:
    def read(result: CalibrationResult) -> Float[np.ndarray, "trial frame"]:
        names = [name_without_side(own) for own in result.coordinates]
        moments = getattr(result, which)
        return moments[:, names.index(name)] if name in names else moments[:0, 0]

    return read


def _of_arm(muscle: str, coordinate: str, *, before: bool) -> Curves:
    """Read a moment arm in mm."""

    def read(result: CalibrationResult) -> Float[np.ndarray, "trial frame"]:
        muscles = [name_without_side(own) for own in result.muscles]
        coordinates = [name_without_side(own) for own in result.coordinates]
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
