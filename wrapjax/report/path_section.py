"""How calibration changed the muscle paths: figure, table and words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibrate import CalibrationResult
from wrapjax.report import markup
from wrapjax.report.cycles import draw_spread, mark_gait_cycle
from wrapjax.report.moved_paths import MovedPath
from wrapjax.report.path_views import path_views
from wrapjax.report.style import BLUE, GRAY, LIGHT_GRAY, PAGE_WIDTH, Figure, in_style, panel_grid
from wrapjax.report.wording import counted

#: As many moment arms are drawn, those that changed most.
MOST_PANELS = 12

Arms = Float[np.ndarray, "muscle trial coordinate frame"]


def path_section(result: CalibrationResult, moves: Sequence[MovedPath] = ()) -> str:
    """Write the part of the report on paths; empty where they were held.

    Parameters
    ----------
    result
        What came of the calibration.
    moves
        From `moved_paths`: what is shown in space.
    """
    moving = result.freedom.moving_paths
    if moving is None:
        return ""
    free = np.flatnonzero(moving)
    if not largest_changes(result):
        return markup.section(
            "Muscle paths",
            markup.paragraph(f"The paths of {counted(len(free), 'muscle')} were free, but none changed."),
        )
    length, arm, spanned = _changes(result)
    muscle, coordinate = largest_changes(result)[0]
    order = free[np.argsort(-length[free].mean(axis=(1, 2)))]
    return markup.section(
        "Muscle paths",
        markup.paragraph(
            f"The paths of {len(free)} of {counted(len(result.muscles), 'muscle')} were free to change. "
            f"Their lengths changed by {length[free].mean():.1f} mm on average, their moment arms by "
            f"{arm[free].mean(axis=(1, 3))[spanned[free]].mean():.1f} mm. {_origin(result)}"
        ),
        markup.picture(
            moment_arm_figure(result),
            alternative="Moment arms over the gait cycle before and after calibration; that of "
            f"{result.muscles[muscle]} about {result.coordinates[coordinate]} changed most.",
            caption="Moment arms in mm over the gait cycle, all cycles: nominal (gray) and calibrated "
            "(blue), mean and one standard deviation to either side. Those that changed most on average, in "
            "this order. Scales differ.",
        ),
        path_views(moves),
        markup.table(
            ("muscle", "length: mean", "length: largest", "arms: mean", "arms: largest", "largest about"),
            [_row(result, muscle) for muscle in order.tolist()],
            caption="Changes in mm over all frames of all cycles (absolute values), moment arms about the "
            "coordinates that the muscle spans.",
        ),
    )


def _origin(result: CalibrationResult) -> str:
    if result.freedom.wraps is not None:
        return (
            "They follow the cylinders that the muscles wrap round, each of which may move, turn and grow "
            "within its bounds (kind 'wrap' in parameters.csv)."
        )
    return (
        "These are polynomials, not anatomy: no bone and no surface bounds them, only penalties on the "
        "change and the hard limits (see Solver)."
    )


def _row(result: CalibrationResult, muscle: int) -> tuple[str, ...]:
    length, arm, spanned = (change[muscle] for change in _changes(result))
    return (
        result.muscles[muscle],
        f"{length.mean():.1f}",
        f"{length.max():.1f}",
        f"{arm[:, spanned].mean():.1f}",
        f"{arm.max():.1f}",
        result.coordinates[int(arm.max(axis=(0, 2)).argmax())],
    )


@in_style
def moment_arm_figure(result: CalibrationResult) -> Figure:
    """Draw the moment arms that changed most, nominal and calibrated."""
    before, after = _arms(result)
    pairs = largest_changes(result)
    figure, panels = panel_grid(len(pairs), 4, width=PAGE_WIDTH, panel_height=1.6, sharex=True)
    for number, (panel, (muscle, coordinate)) in enumerate(zip(panels, pairs, strict=True)):
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        draw_spread(panel, 1e3 * before[muscle, :, coordinate], GRAY, "nominal")
        draw_spread(panel, 1e3 * after[muscle, :, coordinate], BLUE, "calibrated")
        title = f"{result.muscles[muscle]}\n{result.coordinates[coordinate]}"
        panel.set_title(title, loc="left", parse_math=False)
        if number % 4 == 0:
            panel.set_ylabel("moment arm (mm)")
        if number >= len(pairs) - 4:
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=50)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


def largest_changes(result: CalibrationResult) -> list[tuple[int, int]]:
    """Find muscle and coordinate of the moment arms that changed most on average, largest first."""
    mean = _changes(result)[1].mean(axis=(1, 3))
    order = np.argsort(-mean, axis=None)[:MOST_PANELS]
    places = [divmod(int(place), mean.shape[1]) for place in order]
    return [place for place in places if mean[place] > 0.0]


def _arms(result: CalibrationResult) -> tuple[Arms, Arms]:
    return np.asarray(result.initial_states.path.moment_arm), np.asarray(result.states.path.moment_arm)


def _changes(
    result: CalibrationResult,
) -> tuple[Float[np.ndarray, "muscle trial frame"], Arms, Bool[np.ndarray, "muscle coordinate"]]:
    """Changes of lengths and moment arms in mm, and which coordinates a muscle spans."""
    before, after = _arms(result)
    length = np.asarray(result.states.path.length - result.initial_states.path.length)
    return 1e3 * np.abs(length), 1e3 * np.abs(after - before), (before != 0.0).any(axis=(1, 3))
