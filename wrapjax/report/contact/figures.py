"""Figures of contact forces over the gait cycle."""

from __future__ import annotations

from wrapjax.contact.gait_phase import evenly
from wrapjax.contact.result import ContactResult, peaks, stretches
from wrapjax.report.cycles import draw_spread, mark_gait_cycle
from wrapjax.report.style import BLUE, LIGHT_GRAY, PAGE_WIDTH, VERMILION, Figure, in_style, panel_grid

#: Of the first run and of the second.
RUN_COLORS = (BLUE, VERMILION)
_AXES = (("x", "forward"), ("y", "up"), ("z", "to the right"))


@in_style
def magnitude_figure(result: ContactResult) -> Figure:
    """Draw how large the force on each joint and compartment is, one color a run, with all peaks."""
    parts, columns = result.parts, min(3, len(result.parts))
    figure, panels = panel_grid(
        len(parts), columns, width=PAGE_WIDTH, panel_height=2.6, sharex=True, sharey=True
    )
    lowest = 0.0
    for number, (panel, part) in enumerate(zip(panels, parts, strict=True)):
        for run, color in zip(result.runs, RUN_COLORS, strict=False):
            curves = result.curves(run, part) / result.bodyweight
            lowest = min(lowest, float(curves.min()))
            draw_spread(panel, curves, color, run.label)
            for stretch in stretches(part).values():
                found = peaks(curves, result.phase, stretch)
                place = evenly(curves.shape[1])[found.frame]
                panel.plot(place, found.force, "o", color=color, markersize=3, zorder=3)
        title = f"{part} ({result.joints[part]})" if part in result.joints else part
        panel.set_title(title, loc="left", parse_math=False)
        if number + columns >= len(parts):
            panel.set_xlabel("recorded cycle (%)")
        mark_gait_cycle(panel, step=20)
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
    panels[0].set_ylim(bottom=1.1 * lowest)
    panels[0].set_ylabel("force (bodyweights)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


@in_style
def component_figure(result: ContactResult) -> Figure:
    """Draw the force on the proximal bone along its axes, one row a joint."""
    joints = list(result.joints)
    figure, panels = panel_grid(
        3 * len(joints), 3, width=PAGE_WIDTH, panel_height=1.6, sharex=True, sharey="row"
    )
    for number, panel in enumerate(panels):
        row, axis = divmod(number, 3)
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        for run, color in zip(result.runs, RUN_COLORS, strict=False):
            draw_spread(panel, run.force[:, row, axis] / result.bodyweight, color, run.label)
        panel.set_title(f"{joints[row]}: {_AXES[axis][0]}, {_AXES[axis][1]}", loc="left", parse_math=False)
        if axis == 0:
            panel.set_ylabel("bodyweights")
        if row == len(joints) - 1:
            panel.set_xlabel("recorded cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure
