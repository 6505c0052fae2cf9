"""Two figures of a score: shares of correct answers, and confusion between families of effects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.publish.scores import PublishedScore
from validation.blind.publish.table import label
from validation.blind.score.intervals import Figure

#: Width in inches and dots per inch: 1,800 pixels, legible at 900.
WIDTH, DOTS = 9.0, 200
#: Colors and markers of the lines, the published answerer first; more lines would not be legible.
COLORS = ("#0b4f8a", "#c4561b", "#4f8a3d", "#8a6d9e")
MARKS = ("o", "s", "^", "D")
_TEXT = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "figure.facecolor": "white"}


def draw_curves(scores: Sequence[PublishedScore], file: Path) -> None:
    """Plot how often the cause is ranked first, and correctly named, over d* and EMG noise, with intervals.

    At most as many answerers are drawn as there are colors; the table has all of them.
    """
    plt = _pyplot()
    scores = scores[: len(COLORS)]
    rows = (
        ("true cause ranked first", "magnitude", "noise"),
        ("true cause named", "magnitude_named", "noise_named"),
    )
    with plt.rc_context(_TEXT):
        figure, axes = plt.subplots(
            2, 2, figsize=(WIDTH, 5.6), width_ratios=(2.2, 1), sharey=True, layout="constrained"
        )
        for line, (title, *keys) in zip(axes, rows, strict=True):
            for axis, key in zip(line, keys, strict=True):
                _draw_panel(axis, scores, key)
            line[0].set_ylabel(f"{title} (%)")
        for axis, words in zip(
            axes[-1],
            ("detectability d* (standard deviations)", "EMG noise (cases with d* > 2)"),
            strict=True,
        ):
            axis.set_xlabel(words)
        known = axes[0, 0].get_legend_handles_labels()
        figure.legend(*known, loc="outside upper center", ncols=4, frameon=False)
        _save(figure, file)


def _draw_panel(axis: Any, scores: Sequence[PublishedScore], key: str) -> None:
    names = list(scores[0].curves[key])
    apart = min(0.13, 0.8 / len(scores))
    for number, one in enumerate(scores):
        curve = one.curves[key]
        known = [(place, curve[name]) for place, name in enumerate(names) if _drawable(curve.get(name))]
        if not known:
            continue
        at = np.array([place for place, _ in known]) + apart * (number - (len(scores) - 1) / 2)
        value, lower, upper = (
            100 * np.array([getattr(figure, end) for _, figure in known])
            for end in ("value", "lower", "upper")
        )
        axis.errorbar(
            at,
            value,
            # Bounds by a bootstrap need not contain the value.
            yerr=np.maximum([value - lower, upper - value], 0.0),
            color=COLORS[number],
            marker=MARKS[number],
            markersize=6 if number == 0 else 4,
            linewidth=1.8 if number == 0 else 0.8,
            elinewidth=1.4 if number == 0 else 0.7,
            label=one.title,
        )
    ticks = [f"{label(name)}\nn {scores[0].curves[key][name].n}" for name in names]
    axis.set_xticks(range(len(names)), ticks, fontsize=8)
    axis.set_ylim(-3, 103)
    axis.grid(axis="y", color="0.9")
    axis.set_axisbelow(True)


def _drawable(figure: Figure | None) -> bool:
    return figure is not None and None not in (figure.value, figure.lower, figure.upper)


def draw_confusion(one: PublishedScore, file: Path) -> None:
    """Plot which families were named for each family of causes: counts, shaded by their share of the row."""
    plt = _pyplot()
    last = ("none", "outside")
    rows = sorted(one.confusion, key=lambda name: (name in last, name))
    answered = {column for row in one.confusion.values() for column in row}
    # Families in the order of the rows, so that correct answers are on the diagonal; then answers without a
    # name.
    columns = [name for name in rows if name in answered]
    columns += sorted(answered - set(rows), key=lambda name: (name.startswith("("), name))
    counts = np.array([[one.confusion[row].get(column, 0) for column in columns] for row in rows], float)
    share = counts / counts.sum(axis=1, keepdims=True)
    with plt.rc_context({**_TEXT, "axes.spines.left": False, "axes.spines.bottom": False}):
        figure, axis = plt.subplots(figsize=(WIDTH, 1.9 + 0.42 * len(rows)), layout="constrained")
        image = axis.imshow(100 * share, cmap="Blues", vmin=0, vmax=100, aspect="auto")
        for (row, column), count in np.ndenumerate(counts):
            if count:
                color = "white" if share[row, column] > 0.55 else "black"
                axis.text(column, row, f"{count:.0f}", ha="center", va="center", color=color)
        right = {"none": "(none)", "outside": "(unknown)"}
        for place, name in enumerate(rows):
            if (correct := right.get(name, name)) in columns:
                column = columns.index(correct)
                axis.add_patch(
                    plt.Rectangle((column - 0.5, place - 0.5), 1, 1, fill=False, edgecolor=COLORS[0], lw=1.2)
                )
        axis.set_xticks(range(len(columns)), [_words(name) for name in columns], rotation=35, ha="right")
        totals = counts.sum(axis=1).astype(int)
        labels = {"none": "no effect", "outside": "outside the catalogue"}
        causes = [f"{_words(labels.get(r, r))} ({n})" for r, n in zip(rows, totals, strict=True)]
        axis.set_yticks(range(len(rows)), causes)
        axis.tick_params(length=0)
        axis.set_xlabel("named family of effects, or outcome without a name (in brackets)")
        axis.set_ylabel("family of the true cause (number of cases; first cause of pairs)")
        figure.colorbar(image, label="share of the row (%)", pad=0.01)
        _save(figure, file)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def _save(figure: Any, file: Path) -> None:
    figure.savefig(file, dpi=DOTS, facecolor="white", metadata={"Software": None})
    _pyplot().close(figure)
