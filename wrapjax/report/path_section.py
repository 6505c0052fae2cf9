"""How calibration changed the muscle paths: figure, table and words."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.calibrate import CalibrationResult
from wrapjax.report import markup
from wrapjax.report.figures import PAGE_WIDTH, draw_spread, mark_gait_cycle
from wrapjax.report.style import BLUE, GRAY, LIGHT_GRAY, Figure, in_style, panel_grid, to_svg

#: As many moment arms are drawn, those that changed most.
MOST_PANELS = 12

Arms = Float[np.ndarray, "muscle trial coordinate frame"]


def path_section(result: CalibrationResult) -> str:
    """Write the part of the report on paths; empty where they were held."""
    if result.freedom.paths is None:
        return ""
    before, after = _arms(result)
    change = 1e3 * np.abs(after - before)
    length = 1e3 * np.abs(np.asarray(result.states.path.length - result.initial_states.path.length))
    spanned = (before != 0.0).any(axis=(1, 3))
    moved = np.flatnonzero(result.freedom.paths.muscles)
    order = moved[np.argsort(-length[moved].max(axis=(1, 2)))]
    rows = [
        (
            result.muscles[muscle],
            f"{length[muscle].mean():.1f}",
            f"{length[muscle].max():.1f}",
            f"{change[muscle][:, spanned[muscle]].mean():.1f}",
            f"{change[muscle].max():.1f}",
            result.coordinates[int(change[muscle].max(axis=(0, 2)).argmax())],
        )
        for muscle in order
    ]
    drawn = _largest(result)
    muscle, coordinate = drawn[0]
    return markup.section(
        "Muscle paths",
        markup.paragraph(
            f"The paths of {len(moved)} of {len(result.muscles)} muscles were free to change. On "
            "average lengths "
            f"moved by {length[moved].mean():.1f} mm and moment arms by "
            f"{change[moved].mean(axis=(1, 3))[spanned[moved]].mean():.1f} mm. These are polynomials, not "
            "anatomy: no bone and no surface bounds them, only the restraints named in settings.json."
        ),
        markup.picture(
            to_svg(moment_arm_figure(result)),
            alternative=f"Moment arms over the gait cycle before and after calibration; that of "
            f"{result.muscles[muscle]} about {result.coordinates[coordinate]} changed most.",
            caption="Moment arms in mm over the gait cycle, all cycles: nominal (gray) and calibrated "
            "(blue), mean "
            "and one standard deviation to either side. The "
            f"{len(drawn)} that changed most. Scales differ.",
        ),
        markup.table(
            ("muscle", "length: mean", "length: most", "arms: mean", "arms: most", "most about"),
            rows,
            caption="Changes in mm over all frames of all cycles (absolute values); arms about the "
            "coordinates "
            "that the muscle spans.",
        ),
    )


@in_style
def moment_arm_figure(result: CalibrationResult) -> Figure:
    """Draw the moment arms that changed most, nominal and calibrated."""
    before, after = _arms(result)
    pairs = _largest(result)
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


def _arms(result: CalibrationResult) -> tuple[Arms, Arms]:
    return np.asarray(result.initial_states.path.moment_arm), np.asarray(result.states.path.moment_arm)


def _largest(result: CalibrationResult) -> list[tuple[int, int]]:
    before, after = _arms(result)
    change = np.abs(after - before).mean(axis=(1, 3))
    order = np.argsort(-change, axis=None)[:MOST_PANELS]
    return [
        (int(place) // change.shape[1], int(place) % change.shape[1]) for place in order if change.flat[place]
    ]
