"""Figures that compare calibrated with true parameters and moment arms of a virtual subject."""

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
    legend_above,
    panel_grid,
)

# Factor from SI units to the units that are displayed, and their names.
_DISPLAY = {"s": (1e3, "ms"), "m": (1e3, "mm"), "1": (1.0, "")}


def draw_recovery(
    initial: ModelParameters, calibrated: ModelParameters, truth: TrueParameters, file: Path
) -> None:
    """Write a figure of initial and calibrated against true values, one panel a parameter, one dot a muscle.

    Parameters
    ----------
    initial, calibrated
        Parameters before and after calibration.
    truth
        True parameters of the virtual subject.
    file
        Picture file, written completely or not at all.
    """
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
    figure.suptitle(
        "Virtual subject: estimated against true parameters, one dot a muscle (data from the same model form)"
    )
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
    """Write a figure of moment arms over the gait cycle, one panel each.

    Parameters
    ----------
    file
        Picture file, written completely or not at all.
    arms
        Muscle and coordinate of each moment arm, for the titles.
    true, before, after
        Moment arms with the true, the nominal and the calibrated cylinders, m.
    deviation
        Posterior standard deviation of each moment arm given the moments, m: half the width of the band.
    """
    figure = _wrap_recovery_figure(arms, 1e3 * true, 1e3 * before, 1e3 * after, 1e3 * deviation)
    write_atomically(file, lambda temporary: figure.savefig(temporary, dpi=130))


@in_style
def _wrap_recovery_figure(arms, true, before, after, deviation) -> Figure:
    figure, panels = panel_grid(len(arms), _COLUMNS, width=PAGE_WIDTH, panel_height=2.0, sharex=True)
    percent = np.linspace(0.0, 100.0, true.shape[1])
    for panel, name, actual, nominal, calibrated, half in zip(
        panels, arms, true, before, after, deviation, strict=True
    ):
        panel.fill_between(
            percent,
            calibrated - half,
            calibrated + half,
            color=BLUE,
            alpha=BAND_ALPHA,
            linewidth=0.0,
            label="posterior uncertainty given the moments (± 1 SD)",
        )
        panel.plot(percent, nominal, "--", color=GRAY, label="nominal cylinder")
        panel.plot(percent, calibrated, color=BLUE, label="calibrated by PGA")
        panel.plot(percent, actual, color=BLACK, label="true")
        panel.set_title(name, parse_math=False)
    figure.supxlabel(
        "gait cycle (%), mean of all cycles; virtual subject, data from the same model form", fontsize=8.5
    )
    figure.supylabel("moment arm (mm)", fontsize=8.5)
    legend_above(figure, panels[0])
    return figure
