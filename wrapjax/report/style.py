"""Style, panels, legends and SVG text of figures.

Matplotlib is imported only when a figure is drawn, because importing it takes longer than most commands.
"""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

#: A `matplotlib.figure.Figure` and `matplotlib.axes.Axes`, which are not imported here.
Figure = Any
Axes = Any

# Okabe and Ito's palette (2008, jfly.uni-koeln.de/color), distinguishable with any kind of color vision.
BLACK = "#000000"
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
GRAY = "#8A8A8A"
LIGHT_GRAY = "#E4E4E4"
#: Background of a range within which values are expected.
PALE_BLUE = "#F1F6FA"
#: Colors of groups of lines, in this order.
GROUP_COLORS = (BLUE, VERMILION, GREEN, PURPLE)
BAND_ALPHA = 0.2
#: Style of dots in rows, which are not clipped where they lie on an axis.
DOT: dict[str, Any] = {"markersize": 4.2, "zorder": 3, "clip_on": False}
#: Width of a figure in inches that fills the page at 96 pixels per inch.
PAGE_WIDTH = 11.0

_PATH = re.compile(r' d="[^"]*"')
_DECIMALS = re.compile(r"(\.\d\d)\d+")
_CURVED = re.compile(r"[CQz]")
_SETTINGS = {
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "hatch.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "figure.facecolor": "white",
    "svg.fonttype": "path",
    # A fixed salt makes equal results give equal files.
    "svg.hashsalt": "wrapjax",
}


@contextmanager
def drawing_style() -> Iterator[None]:
    """Apply the project's matplotlib settings in place of the user's own within a context."""
    import matplotlib.style

    with matplotlib.style.context(_SETTINGS, after_reset=True):
        yield


def in_style(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Make a drawing function apply the project's matplotlib settings (decorator)."""

    @functools.wraps(draw)
    def drawn(*args: Any, **kwargs: Any) -> Figure:
        with drawing_style():
            return draw(*args, **kwargs)

    return drawn


def new_figure(width: float, height: float) -> Figure:
    """Make a figure (width and height in inches) without a window and outside pyplot's global state."""
    from matplotlib.figure import Figure as MatplotlibFigure

    return MatplotlibFigure(figsize=(width, height), layout="constrained")


def panel_grid(count: int, columns: int, *, width: float, panel_height: float, **sharing: Any):
    """Make a figure with a grid of panels, filled row by row.

    Parameters
    ----------
    count, columns
        Number of panels and of columns.
    width, panel_height
        Width of the figure and height of one panel, inches.
    sharing
        Options of `matplotlib.figure.Figure.subplots`, such as ``sharex``.

    Returns
    -------
    figure, panels
        The figure and ``count`` axes; unused places in the last row stay empty.
    """
    rows = -(-count // columns)
    figure = new_figure(width, rows * panel_height + 0.5)
    axes = figure.subplots(rows, columns, squeeze=False, **sharing)
    panels = list(axes.flat)
    for spare in panels[count:]:
        spare.remove()
    # Shared axes label their last row only. Panels above an unused place need labels too, which may
    # extend into that place.
    for panel in panels[max(0, count - columns) : (rows - 1) * columns]:
        panel.tick_params(labelbottom=True)
        panel.xaxis.set_in_layout(False)
    return figure, panels[:count]


def to_svg(figure: Figure) -> str:
    """Write a figure as SVG text with coordinates rounded to a hundredth of a point."""
    buffer = io.StringIO()
    with drawing_style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _PATH.sub(lambda path: _shortened(path[0]), buffer.getvalue())


def _shortened(path: str) -> str:
    """Write an SVG path with fewer characters, because reports contain many thousands of points."""
    rounded = _DECIMALS.sub(r"\1", path)
    # After a point, SVG implies a straight line to the next. In a path with curves the letter is needed.
    return rounded if _CURVED.search(rounded, 4) else rounded.replace(" \nL ", " ")


def legend_above(figure: Figure, *panels: Axes, columns: int | None = None) -> None:
    """Put one legend above all panels, with each label of the given panels once, in one row by default."""
    entries: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries[label] = handle
    figure.legend(
        entries.values(), entries.keys(), loc="outside upper left", ncols=columns or max(1, len(entries))
    )


def label_rows(panels: Iterable[Axes], names: Sequence[str]) -> None:
    """Label rows 0, 1, ... of panels that share their vertical axis, from top to bottom, without ticks."""
    first, *others = panels
    first.set_yticks(range(len(names)), names, parse_math=False)
    first.set_ylim(len(names) - 0.4, -0.6)
    for panel in (first, *others):
        panel.tick_params(axis="y", length=0)


def label_bounds(panel: Axes, parameter: str, labels: Sequence[str] = ("lower", "upper")) -> None:
    """Make a panel's horizontal axis range from the lower bound (0) to the upper bound (1) of a parameter."""
    panel.set_title(parameter.replace("_", "\n", 1).replace("_", " "))
    panel.set_xlim(-0.06, 1.06)
    panel.set_xticks([0.0, 1.0], labels)
    panel.spines["left"].set_visible(False)
    # Labels are aligned inwards, because those of neighboring panels would overlap.
    for label, side in zip(panel.get_xticklabels(), ("left", "right"), strict=True):
        label.set_horizontalalignment(side)


def head_column(panel: Axes, heading: str) -> None:
    """Write a heading above the title of the top panel of a column."""
    panel.annotate(
        heading,
        (0.0, 1.0),
        xytext=(0, 18),
        xycoords="axes fraction",
        textcoords="offset points",
        fontweight="bold",
    )


def draw_zero_line(panel: Axes) -> None:
    """Draw a thin horizontal line at zero behind all curves."""
    panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
