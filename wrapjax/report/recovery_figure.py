"""Calibrated against true parameters of a virtual subject."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wrapjax.files import write_whole
from wrapjax.model import QUANTITIES, ModelParameters
from wrapjax.virtual import VirtualTruth
from wrapjax.virtual.truth import parameter_names

# What a reader would rather see than SI units.
_DISPLAY = {"s": (1e3, "ms"), "m": (1e3, "mm"), "1": (1.0, "")}


def draw_recovery(
    initial: ModelParameters, calibrated: ModelParameters, truth: VirtualTruth, file: Path
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
    write_whole(file, lambda temporary: figure.savefig(temporary, dpi=110))
