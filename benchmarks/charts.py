"""Figures of the benchmarks of growth and roofline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.growth import Growth
from benchmarks.roofline import Roof, Work

_PANEL = (3.6, 3.2)


def draw_growth(grown: Sequence[Growth], folder: Path) -> None:
    """Plot times over problem sizes on logarithmic axes, one panel per axis: ``growth.png`` and ``.svg``."""
    axes = list(dict.fromkeys(one.axis for one in grown))
    figure, panels = _figure(len(axes))
    for panel, axis in zip(panels, axes, strict=True):
        for one in grown:
            if one.axis == axis:
                label = f"{one.kernel.replace('_', ' ')}: {one.slope:.2f}"
                panel.loglog(one.sizes, 1e3 * np.array(one.seconds), "o-", markersize=4, label=label)
        sizes = next(one.sizes for one in grown if one.axis == axis)
        panel.set_xticks(sizes, [str(size) for size in sizes])
        panel.minorticks_off()
        panel.set_xlabel("modes of each path" if axis == "modes" else axis)
        panel.grid(alpha=0.3)
        panel.legend(title="kernel: slope", fontsize="x-small", title_fontsize="x-small")
    panels[0].set_ylabel("time (ms)")
    _save(figure, folder, "growth")


def draw_roofline(roof: Roof, works: Sequence[Work], folder: Path) -> None:
    """Plot the operation rates of the kernels below the machine's roofline: ``roofline.png`` and ``.svg``."""
    figure, (panel,) = _figure(1)
    intensities = [work.intensity for work in works]
    span = np.geomspace(0.3 * min(*intensities, roof.ridge), 3.0 * max(*intensities, roof.ridge), 100)
    panel.loglog(span, [1e-9 * roof.at(one) for one in span], "k-", linewidth=1)
    for work in works:
        panel.loglog(work.intensity, 1e-9 * work.rate, "o", markersize=5, label=work.name.replace("_", " "))
    panel.set_xlabel("floating-point operations a byte")
    panel.set_ylabel("GFLOP/s")
    panel.grid(alpha=0.3)
    panel.legend(fontsize="x-small")
    _save(figure, folder, "roofline")


def _figure(panels: int) -> tuple[Any, Any]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    size = (_PANEL[0] * max(panels, 1.4), _PANEL[1])
    figure, axes = pyplot.subplots(1, panels, figsize=size, layout="constrained", squeeze=False)
    return figure, axes[0]


def _save(figure: Any, folder: Path, name: str) -> None:
    from matplotlib import pyplot

    folder.mkdir(parents=True, exist_ok=True)
    for suffix in ("png", "svg"):
        figure.savefig(folder / f"{name}.{suffix}", dpi=150)
    pyplot.close(figure)
