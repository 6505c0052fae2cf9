"""Moment arms round true, nominal and found cylinders of a virtual subject."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.files import write_whole
from wrapjax.report.figures import PAGE_WIDTH
from wrapjax.report.style import BLACK, BLUE, GRAY, Figure, in_style, panel_grid


def draw_wrap_recovery(
    file: Path,
    *,
    arm: str,
    trials: Sequence[str],
    true: Float[np.ndarray, "trial frame"],
    before: Float[np.ndarray, "trial frame"],
    after: Float[np.ndarray, "trial frame"],
) -> None:
    """Draw one moment arm (m) over the gait cycle, one panel a trial, and write the picture.

    Parameters
    ----------
    file
        Where to; written whole or not at all.
    arm
        Muscle and coordinate, for the title.
    trials
        Names.
    true, before, after
        Round the true cylinders, the model's and those that were found.
    """
    figure = _wrap_recovery_figure(arm, trials, 1e3 * true, 1e3 * before, 1e3 * after)
    write_whole(file, lambda temporary: figure.savefig(temporary, dpi=130))


@in_style
def _wrap_recovery_figure(arm, trials, true, before, after) -> Figure:
    figure, panels = panel_grid(len(trials), 4, width=PAGE_WIDTH, panel_height=1.7, sharex=True, sharey=True)
    percent = np.linspace(0.0, 100.0, true.shape[1])
    for panel, name, *curves in zip(panels, trials, true, before, after, strict=True):
        styles = ((BLACK, "-", "true"), (GRAY, "--", "nominal cylinder"), (BLUE, "-", "found by PGA"))
        for values, (color, line, label) in zip(curves, styles, strict=True):
            panel.plot(percent, values, line, color=color, label=label)
        panel.set_title(name, parse_math=False)
    figure.supxlabel("gait cycle (%), same-form data of a virtual subject", fontsize=8.5)
    figure.supylabel(f"{arm}, moment arm (mm)", fontsize=8.5, parse_math=False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure
