"""Calibrated against true parameters of a virtual subject.

Moment arms round true, nominal and found cylinders of a virtual subject.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.datasets.virtual_person.true_parameters import TrueParameters, parameter_names
from wrapjax.io.files import write_atomically
from wrapjax.model.parameters import QUANTITIES, ModelParameters
from wrapjax.report.style import (
    BAND_ALPHA,
    BLACK,
    BLUE,
    GRAY,
    PAGE_WIDTH,
    Figure,
    in_style,
    panel_grid,
)

# What a reader would rather see than SI units.
_DISPLAY = {"s": (1e3, "ms"), "m": (1e3, "mm"), "1": (1.0, "")}


def draw_recovery(
    initial: ModelParameters, calibrated: ModelParameters, truth: TrueParameters, file: Path
) -> None:
    """Draw one panel a parameter: true values across, start and calibrated values up, one dot a muscle."""
    from matplotlib.figure import Figure

    names = parameter_names()
    figure = Figure(figsize=(11, 7), layout="constrained")
    for panel, name in zip(figure.subplots(2, 3).flat, names, strict=True):
        factor, unit = _DISPLAY[QUANTITIES[name].unit]
        true, before, after = (
            factor * np.asarray(getattr(source, name)) for source in (truth, initial, calibrated)
        )
        limits = [min(true.min(), after.min()), max(true.max(), after.max())]
        panel.plot(limits, limits, color="0.6", linewidth=1, zorder=0)
        panel.plot(true, before, "o", color="0.75", markersize=4, label="start")
        panel.plot(true, after, "o", color="#0072B2", markersize=5, label="calibrated")
        suffix = f" ({unit})" if unit else ""
        panel.set_title(name.replace("_", " ") + suffix, fontsize=10)
        panel.set_xlabel("true")
        panel.set_ylabel("model")
        panel.spines[["top", "right"]].set_visible(False)
    figure.axes[0].legend(frameon=False)
    figure.suptitle("Virtual subject: parameters against the hidden truth, one dot a muscle (same-form data)")
    write_atomically(file, lambda temporary: figure.savefig(temporary, dpi=110))


_COLUMNS = 4


def draw_wrap_recovery(
    file: Path,
    *,
    arms: Sequence[str],
    true: Float[np.ndarray, "arm frame"],
    before: Float[np.ndarray, "arm frame"],
    after: Float[np.ndarray, "arm frame"],
    deviation: Float[np.ndarray, " arm"],
) -> None:
    """Draw moment arms (m) over the gait cycle, one panel each, and write the picture.

    Parameters
    ----------
    file
        Where to; written whole or not at all.
    arms
        Muscle and coordinate, for the titles.
    true, before, after
        Round the true cylinders, the model's and those that were found.
    deviation
        What the moments leave open of an arm (m): half the width of the band about what was found.
    """
    figure = _wrap_recovery_figure(arms, 1e3 * true, 1e3 * before, 1e3 * after, 1e3 * deviation)
    write_atomically(file, lambda temporary: figure.savefig(temporary, dpi=130))


@in_style
def _wrap_recovery_figure(arms, true, before, after, deviation) -> Figure:
    figure, panels = panel_grid(len(arms), _COLUMNS, width=PAGE_WIDTH, panel_height=2.0, sharex=True)
    percent = np.linspace(0.0, 100.0, true.shape[1])
    for panel, name, own, nominal, found, half in zip(
        panels, arms, true, before, after, deviation, strict=True
    ):
        panel.fill_between(
            percent,
            found - half,
            found + half,
            color=BLUE,
            alpha=BAND_ALPHA,
            linewidth=0.0,
            label="left open by the moments (± 1 SD)",
        )
        panel.plot(percent, nominal, "--", color=GRAY, label="nominal cylinder")
        panel.plot(percent, found, color=BLUE, label="found by PGA")
        panel.plot(percent, own, color=BLACK, label="true")
        panel.set_title(name, parse_math=False)
    figure.supxlabel("gait cycle (%), mean of all cycles; same-form data of a virtual subject", fontsize=8.5)
    figure.supylabel("moment arm (mm)", fontsize=8.5)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure
