"""Which effects this recording can tell apart, and what to record to tell the others."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.gap.result import Advice, GapResult
from wrapjax.report import markup
from wrapjax.report.gap.words import listed
from wrapjax.report.style import Figure, in_style, new_figure
from wrapjax.report.wording import counted, plain

#: Squared standard deviations of an effect that another cannot imitate: below (three standard deviations),
#: it can stand in for it.
BORDER = 9.0
# More rows than these cannot be read.
_MOST_EFFECTS = 14
_LEAST, _MOST = 0.1, 810.0


def ties_section(result: GapResult) -> list[str]:
    """Write the part of the report on ties; nothing where there is neither a map nor advice."""
    ids, likeness = _shown(result)
    parts = []
    if len(ids) > 1:
        alike = alike_pairs(ids, likeness)
        pairs = "; ".join(f"{plain(one)} and {plain(other)}" for one, other in alike) or "none"
        parts.append(
            markup.picture(
                ties_figure(ids, likeness),
                alternative="Map of how much of each effect another cannot imitate. Not told apart: "
                f"{pairs}.",
                caption="How much of the effect in a row the effect in a column cannot imitate, in squared "
                "standard deviations (logarithmic scale). Red and bold, below 9 (three standard "
                "deviations): it can stand in for it. Two effects that are red both ways cannot be told "
                f"apart by this recording. Not told apart here: {pairs}.",
            )
        )
    if result.advice:
        parts.append(markup.paragraph("What to record to tell them apart:"))
        parts.append(markup.bullets(map(_advice, result.advice)))
    return [markup.section("What can be told apart", *parts)] if parts else []


def alike_pairs(ids: tuple[str, ...], likeness: Float[np.ndarray, "effect effect"]) -> list[tuple[str, str]]:
    """Name the pairs of effects that can imitate each other."""
    return [
        (ids[row], ids[column])
        for row in range(len(ids))
        for column in range(row + 1, len(ids))
        if likeness[row, column] < BORDER and likeness[column, row] < BORDER
    ]


@in_style
def ties_figure(ids: tuple[str, ...], likeness: Float[np.ndarray, "effect effect"]) -> Figure:
    """Draw how much of each effect (row) each other one (column) cannot imitate."""
    from matplotlib.colors import LogNorm

    count = len(ids)
    names = [plain(id) for id in ids]
    figure = new_figure(0.5 * count + 4.2, 0.36 * count + 2.4)
    panel = figure.subplots()
    values = np.where(np.eye(count, dtype=bool), np.nan, np.clip(likeness, _LEAST, _MOST))
    # The palette's middle is the border, so its two colors are the two answers.
    norm = LogNorm(BORDER**2 / _MOST, _MOST)
    panel.set_facecolor("#EDEDED")
    image = panel.pcolormesh(values, cmap="RdBu", norm=norm, edgecolor="white", linewidth=0.6)
    for row, column in np.argwhere(np.isfinite(values)).tolist():
        away = abs(np.log(values[row, column] / BORDER)) / np.log(_MOST / BORDER)
        panel.text(
            column + 0.5,
            row + 0.5,
            f"{likeness[row, column]:.2g}"
            if likeness[row, column] < 9.95
            else f"{likeness[row, column]:.0f}",
            ha="center",
            va="center",
            fontsize=7.5,
            fontweight="bold" if likeness[row, column] < BORDER else "normal",
            color="white" if away > 0.7 else "black",
        )
    at = np.arange(count) + 0.5
    panel.set_yticks(at, names, parse_math=False)
    panel.set_xticks(at, names, rotation=40, ha="right", rotation_mode="anchor", parse_math=False)
    panel.set_ylim(count, 0)
    panel.tick_params(length=0)
    panel.spines[["left", "bottom"]].set_visible(False)
    panel.set_ylabel("how much of this effect")
    panel.set_xlabel("this one cannot imitate")
    bar = figure.colorbar(image, label="not imitated\n(squared standard deviations)", aspect=14)
    bar.set_ticks([0.1, 1.0, BORDER, 100.0], labels=["0.1", "1", "9: border", "100"])
    bar.minorticks_off()
    bar.ax.axhline(BORDER, color="black", linewidth=1.0)
    return figure


def _shown(result: GapResult) -> tuple[tuple[str, ...], Float[np.ndarray, "shown shown"]]:
    """Keep the most probable effects of the map."""
    ids, likeness = result.likeness
    probability = {effect.id: effect.probability for effect in result.effects}
    order = sorted(range(len(ids)), key=lambda row: -probability.get(ids[row], 0.0))[:_MOST_EFFECTS]
    return tuple(ids[row] for row in order), likeness[np.ix_(order, order)]


def _advice(advice: Advice) -> str:
    cycles = "" if advice.cycles is None else f", {counted(advice.cycles, 'cycle')} for odds of 20 to 1"
    experiment = advice.experiment[:1].upper() + advice.experiment[1:]
    return f"{experiment} ({advice.minutes} min{cycles}): tells apart {listed(advice.splits)}."
