"""Which muscle forces would take the error away."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.gap.result import GapResult, MuscleShare
from wrapjax.report import markup
from wrapjax.report.cycles import mark_gait_cycle
from wrapjax.report.gap.errors import speed_label
from wrapjax.report.style import BLACK, GRAY, PAGE_WIDTH, Figure, in_style, panel_grid
from wrapjax.report.wording import counted

#: Where moment arms tell less of a muscle's part than this, its forces are not to be believed.
RESOLVED = 0.5
_WORDS = "resolution below 0.5"


def muscles_section(result: GapResult) -> list[str]:
    """Write the part of the report on muscles; nothing where it could not be told."""
    share = result.muscles
    if share is None or not share.muscles:
        return []
    most = np.abs(share.force).max(axis=(1, 2))
    seen = resolved(share)
    place = int(np.argmax(np.where(seen, most, -1.0)))
    first = (
        f"the largest change that can be told is {most[place]:.0f} N, of {share.muscles[place]}"
        if seen.any()
        else "none can be told"
    )
    return [
        markup.section(
            "Which muscles",
            markup.picture(
                muscle_figure(result, share),
                alternative=f"Map of the change of force by muscle and gait cycle; {first}.",
                caption="Change of muscle force in N that would take the explainable error away, mean over "
                "the cycles of each speed: blue, more force than the plain model gives; red, less. Muscles "
                "with like moment arms cannot be told apart by moments. Hatched, with names in gray: muscles "
                f"of whose part less than half can be told ({_WORDS}), not to be read. "
                f"{counted(int(seen.sum()), 'muscle')} of {len(seen)} can be told.",
            ),
        )
    ]


def resolved(share: MuscleShare) -> Bool[np.ndarray, " muscle"]:
    """Mark the muscles whose part moment arms can tell."""
    return share.resolution >= RESOLVED


@in_style
def muscle_figure(result: GapResult, share: MuscleShare) -> Figure:
    """Draw the change of force by muscle and phase, one panel a speed."""
    from matplotlib.patches import Rectangle

    order = _order(share)
    force, seen = share.force[order], resolved(share)[order]
    names = [share.muscles[row] for row in order]
    speeds = force.shape[1]
    columns = min(3, speeds)
    figure, panels = panel_grid(
        speeds, columns, width=PAGE_WIDTH, panel_height=0.19 * len(names) + 0.7, sharey=True
    )
    labels = _speeds(result, speeds)
    largest = _largest(force[seen]) or _largest(force) or 1.0
    edges = np.linspace(0.0, 100.0, force.shape[2] + 1)
    for number, panel in enumerate(panels):
        image = panel.pcolormesh(
            edges,
            np.arange(len(names) + 1),
            force[:, number],
            cmap="RdBu",
            vmin=-largest,
            vmax=largest,
            # As an image: thousands of cells would be megabytes of paths.
            rasterized=True,
        )
        for row in np.flatnonzero(~seen).tolist():
            panel.add_patch(
                Rectangle(
                    (0.0, row),
                    100.0,
                    1.0,
                    facecolor="#FFFFFFB0",
                    edgecolor=GRAY,
                    hatch="////",
                    linewidth=0.0,
                )
            )
        panel.set_title(labels[number], loc="left")
        panel.set_yticks(np.arange(len(names)) + 0.5, names, parse_math=False)
        if number % columns == 0:  # the others' names are not shown
            for name, clear in zip(panel.get_yticklabels(), seen.tolist(), strict=True):
                name.set_color(BLACK if clear else GRAY)
        panel.set_ylim(len(names), 0)
        panel.tick_params(axis="y", length=0)
        panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.colorbar(image, ax=panels, label="change of force (N)", aspect=30, pad=0.01, extend="both")
    return figure


def _order(share: MuscleShare) -> Int[np.ndarray, " muscle"]:
    """Put those that can be told first, the largest change first."""
    return np.lexsort((-np.abs(share.force).max(axis=(1, 2)), ~resolved(share)))


def _largest(force: Float[np.ndarray, "muscle speed phase"]) -> float:
    return float(np.abs(force).max(initial=0.0))


def _speeds(result: GapResult, count: int) -> list[str]:
    """Name the speeds that muscles were calibrated at; not at all if these are others."""
    calibrated = np.array([use == "calibration" for use in result.uses], dtype=bool)
    speeds = np.unique(result.speeds[calibrated]).tolist()  # NaNs count as one, the last
    return [speed_label(speed) for speed in speeds] if len(speeds) == count else [""] * count
