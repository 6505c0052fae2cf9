"""How figures look, and their way into a page. matplotlib is imported only when something is drawn.

Numbers and lists in words, the same way all over the report.
"""

from __future__ import annotations

import functools
import io
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

#: A `matplotlib.figure.Figure`; the name stands for it where matplotlib is not imported.
Figure = Any
Axes = Any

# Okabe & Ito's palette (2008, jfly.uni-koeln.de/color), told apart with any kind of color vision.
BLACK = "#000000"
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
GRAY = "#8A8A8A"
LIGHT_GRAY = "#E4E4E4"
#: For lines of different groups, in this order.
GROUP_COLORS = (BLUE, VERMILION, GREEN, PURPLE)
BAND_ALPHA = 0.2
#: Inches; fills the page at 96 pixels an inch.
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
    # Equal results give equal files.
    "svg.hashsalt": "wrapjax",
}


@contextmanager
def drawing_style() -> Iterator[None]:
    """Draw in the project's style whatever the user's own matplotlib settings are."""
    import matplotlib.style

    with matplotlib.style.context(_SETTINGS, after_reset=True):
        yield


def in_style(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Make a drawing function use the project's style."""

    @functools.wraps(draw)
    def drawn(*args: Any, **kwargs: Any) -> Figure:
        with drawing_style():
            return draw(*args, **kwargs)

    return drawn


def new_figure(width: float, height: float) -> Figure:
    """Make a figure (inches) that belongs to no window and no global state."""
    from matplotlib.figure import Figure as MatplotlibFigure

    return MatplotlibFigure(figsize=(width, height), layout="constrained")


def panel_grid(count: int, columns: int, *, width: float, panel_height: float, **sharing: Any):
    """Make panels row by row.

    Returns
    -------
    figure, panels
        As many axes as asked for; places left over in the last row stay empty.
    """
    rows = -(-count // columns)
    figure = new_figure(width, rows * panel_height + 0.5)
    axes = figure.subplots(rows, columns, squeeze=False, **sharing)
    panels = list(axes.flat)
    for spare in panels[count:]:
        spare.remove()
    # Shared axes label their last row only: label panels that have nothing below them, too, and let
    # the labels use the empty place there.
    for panel in panels[max(0, count - columns) : (rows - 1) * columns]:
        panel.tick_params(labelbottom=True)
        panel.xaxis.set_in_layout(False)
    return figure, panels[:count]


def to_svg(figure: Figure) -> str:
    """Draw a figure as SVG text, coordinates to a hundredth of a point."""
    buffer = io.StringIO()
    with drawing_style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _PATH.sub(lambda path: _in_short(path[0]), buffer.getvalue())


def _in_short(path: str) -> str:
    """Write a path's points in fewer letters: reports hold many thousands."""
    rounded = _DECIMALS.sub(r"\1", path)
    # From one point to the next a path of straight lines goes on by itself; curves would take its place.
    return rounded if _CURVED.search(rounded, 4) else rounded.replace(" \nL ", " ")


def counted(number: int, thing: str) -> str:
    """Count things: ``1 start``, ``2 starts``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def decimals(value: float | None) -> str:
    """Write two decimals; a dash where there is no number."""
    return "\N{EN DASH}" if value is None or not math.isfinite(value) else f"{value:.2f}"


def plain(name: str) -> str:
    """Take a name of the package for words: ``moment_arm_sign`` reads ``moment arm sign``."""
    return name.replace("_", " ")
