"""Figures of uncertainty: intervals of parameters, bands of moments.

How far parameters and moments may be from what was found, in the report.

The spread of parameters in numbers: the content of ``uncertainty.json``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wrapjax.calibration.result import CalibrationResult
from wrapjax.calibration.uncertainty.intervals import LegSpread
from wrapjax.geometry.wrapping import NOMINAL
from wrapjax.report import markup
from wrapjax.report.moment_curves import groups_by_speed_and_use, mark_gait_cycle
from wrapjax.report.style import (
    BLACK,
    BLUE,
    LIGHT_GRAY,
    PAGE_WIDTH,
    Figure,
    counted,
    decimals,
    in_style,
    new_figure,
    panel_grid,
)

_PALE = "#9CC7E4"


def kinds_of(result: CalibrationResult, spread: LegSpread) -> dict[str, list[str]]:
    """Give the owners of parameters with bounds, by kind: muscles, cylinders."""
    wraps = () if result.freedom.wraps is None else result.freedom.wraps.names
    kinds = {"muscle": list(result.muscles), "cylinder": list(wraps)}
    owners = {label.rsplit(".", 1)[0] for label in spread.parameters.labels}
    named = {kind: [name for name in names if name in owners] for kind, names in kinds.items()}
    return {kind: names for kind, names in named.items() if names}


@in_style
def interval_figure(result: CalibrationResult, spread: LegSpread, owners: list[str]) -> Figure:
    """Draw each parameter's 90 % interval between its bounds: one column a parameter, one row an owner."""
    own = spread.parameters
    bounds = _bounds(result)
    places = {label: place for place, label in enumerate(own.labels)}
    names = list(
        dict.fromkeys(label.rsplit(".", 1)[1] for label in bounds if label.rsplit(".", 1)[0] in owners)
    )
    rows = np.arange(len(owners))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(owners) + 1.9)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for panel, name in zip(panels, names, strict=True):
        panel.set_title(name.replace("_", "\n", 1).replace("_", " "))
        panel.set_xlim(-0.06, 1.06)
        panel.set_xticks([0.0, 1.0], ["lower", "upper"])
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        for label, side in zip(panel.get_xticklabels(), ("left", "right"), strict=True):
            label.set_horizontalalignment(side)
        here = np.array([row for row in rows if f"{owners[row]}.{name}" in places])
        at = [places[f"{owners[row]}.{name}"] for row in here]
        lower, upper = np.array([bounds[own.labels[place]] for place in at]).T
        width = np.where(upper > lower, upper - lower, 1.0)
        value, low, high = ((part[at] - lower) / width for part in (own.value, own.low, own.high))
        half = 1.645 * own.prior_deviation[at] / width  # as wide as 90 % of a normal distribution
        told = own.identified[at]
        panel.hlines(
            here,
            (value - half).clip(0.0),
            (value + half).clip(None, 1.0),
            color=LIGHT_GRAY,
            linewidth=6.0,
            zorder=0,
            label="without moments",
        )
        for chosen, color, face, text in (
            (told, BLUE, BLUE, "moments narrow it"),
            (~told, _PALE, "white", "they hardly do"),
        ):
            panel.hlines(here[chosen], low[chosen], high[chosen], color=color, linewidth=1.6, zorder=1)
            panel.plot(
                value[chosen],
                here[chosen],
                "o",
                markerfacecolor=face,
                markeredgecolor=BLUE,
                markersize=3.6,
                label=text,
                zorder=2,
            )
    panels[0].set_yticks(rows, owners, parse_math=False)
    panels[0].set_ylim(len(owners) - 0.4, -0.6)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


@in_style
def band_figure(result: CalibrationResult, spread: LegSpread) -> Figure:
    """Draw measured and modelled moments with the band of the draws, means over cycles of a kind."""
    groups = groups_by_speed_and_use(result, most_speeds=2)
    count = len(result.coordinates) * len(groups)
    figure, panels = panel_grid(
        count,
        len(groups),
        width=PAGE_WIDTH if len(groups) > 1 else PAGE_WIDTH / 2,
        panel_height=1.6,
        sharex=True,
        sharey="row",
    )
    percent = np.linspace(0.0, 100.0, result.measured.shape[-1])
    for number, panel in enumerate(panels):
        row, column = divmod(number, len(groups))
        keep = groups[column].keep
        measured, modelled, low, high = (
            part[keep, row].mean(axis=0)
            for part in (result.measured, result.modelled, spread.low, spread.high)
        )
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        panel.fill_between(percent, low, high, color=BLUE, alpha=0.3, linewidth=0, label="90 % of draws")
        panel.plot(percent, measured, color=BLACK, label="measured")
        panel.plot(percent, modelled, color=BLUE, label="modelled")
        panel.set_title(result.coordinates[row], loc="left", parse_math=False)
        if groups[column].label and row == 0:
            panel.annotate(
                f"{groups[column].label} ({groups[column].count})",
                (0.0, 1.0),
                xytext=(0, 18),
                xycoords="axes fraction",
                textcoords="offset points",
                fontweight="bold",
            )
        if column == 0:
            panel.set_ylabel("moment (N m)")
        if number >= count - len(groups):
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def _bounds(result: CalibrationResult) -> dict[str, tuple[float, float]]:
    """Give the bounds of muscles' and cylinders' parameters, SI units; modes of paths have none."""
    found = {
        f"{muscle}.{parameter.name}": (float(parameter.lower[row]), float(parameter.upper[row]))
        for row, muscle in enumerate(result.muscles)
        for parameter in result.freedom.parameters
    }
    wraps = result.freedom.wraps
    if wraps is not None:
        found |= {
            f"{owner}.{quantity}": (
                float(NOMINAL[place] + wraps.lower[row, place]),
                float(NOMINAL[place] + wraps.upper[row, place]),
            )
            for row, owner in enumerate(wraps.names)
            for place, quantity in enumerate(wraps.quantities)
        }
    return found


#: Version of the layout of ``uncertainty.json``.
SCHEMA = 1


def describe_spread(spread: LegSpread) -> dict[str, Any]:
    """Say in short how the spread was found: what ``summary.json`` has of it."""
    return {
        "way": spread.way,
        "draws": len(spread.draws),
        "converged_draws": spread.converged,
        "independent_samples": spread.independent_samples,
        "parameters": len(spread.parameters.labels),
        "identified": int(spread.parameters.identified.sum()),
    }


def spread_content(result: CalibrationResult, spread: LegSpread) -> dict[str, Any]:
    """Give every free parameter's spread, and that of the moments by coordinate.

    Returns
    -------
    dict
        Parameters by label (a mode of a path has no unit: it is an amount) in SI units: ``value``, ``sd``,
        ``low_90`` and ``high_90``, ``sd_without_moments`` (by priors, penalties and bounds), ``identified``
        and ``at_bound``. Of each coordinate the noise's standard deviation and the mean half width of the
        band, N m; the bands themselves are in ``moment_bands/``.
    """
    own = spread.parameters
    stuck = set(result.at_bounds)
    return {
        "schema": SCHEMA,
        **describe_spread(spread),
        "information": spread.information,
        "moments": {
            coordinate: {
                "noise_sd_Nm": float(noise),
                "band_half_width_Nm": float((high - low).mean() / 2.0),
            }
            for coordinate, noise, low, high in zip(
                result.coordinates,
                spread.noise,
                spread.low.swapaxes(0, 1),
                spread.high.swapaxes(0, 1),
                strict=True,
            )
        },
        "not_identified": [label for label, told in zip(own.labels, own.identified, strict=True) if not told],
        "by_parameter": {
            label: {
                "value": float(own.value[row]),
                "unit": own.units[row],
                "sd": float(own.deviation[row]),
                "low_90": float(own.low[row]),
                "high_90": float(own.high[row]),
                "sd_without_moments": float(own.prior_deviation[row]),
                "identified": bool(own.identified[row]),
                "at_bound": label in stuck,
            }
            for row, label in enumerate(own.labels)
        },
    }


_WAYS = {
    "laplace": "of a normal distribution about the solution, within the bounds",
    "bootstrap": "calibrations of moments made up by the model with noise like the residuals'",
}


def spread_section(result: CalibrationResult, spread: LegSpread) -> str:
    """Write the part of the report on uncertainty."""
    pictures = [
        markup.picture(
            interval_figure(result, spread, owners),
            alternative=f"90 % intervals of the parameters of {counted(len(owners), kind)} between bounds.",
            caption=f"Parameters of each {kind} between their bounds: as calibrated (dot; ring where moments "
            "hardly narrow it) with the interval that holds 90 % of the draws (bar). Gray: how wide it "
            "is without moments, 1.645 standard deviations to either side by priors, penalties and bounds.",
        )
        for kind, owners in kinds_of(result, spread).items()
    ]
    widths = (spread.high - spread.low).mean(axis=(0, 2)) / 2.0
    rows = [
        (name, decimals(float(noise)), decimals(float(width)))
        for name, noise, width in zip(result.coordinates, spread.noise, widths, strict=True)
    ]
    return markup.section(
        "Uncertainty",
        markup.paragraph(_finding(spread)),
        markup.paragraph(_assumptions(spread)),
        *pictures,
        _open_table(spread),
        markup.picture(
            band_figure(result, spread),
            alternative="Measured and modelled joint moments over the gait cycle with 90 % bands.",
            caption="Joint moments in N m over the gait cycle, means over cycles: measured (black), modelled "
            "(blue), and the band that holds 90 % of the draws' moments. The band is the model's: a "
            "measurement has noise besides.",
        ),
        markup.table(
            ("coordinate", "noise of moments", "half width of the band"),
            rows,
            caption="N m: standard deviation of measured about modelled moments, and the band's half width, "
            "averages over cycles and phases.",
        ),
    )


def _finding(spread: LegSpread) -> str:
    told, total = int(spread.parameters.identified.sum()), len(spread.parameters.labels)
    made = f"{counted(len(spread.draws), 'draw')}: {_WAYS[spread.way]}"
    if spread.way == "bootstrap":
        failed = len(spread.draws) - spread.converged
        made += f"; {failed} of them did not converge" if failed else ", all of which converged"
    return (
        f"Moments make {told} of {counted(total, 'free parameter')} surer by more than a fifth. The others "
        f"are as open as priors, penalties and bounds leave them. By {made}."
    )


def _assumptions(spread: LegSpread) -> str:
    return (
        f"Residuals tell as much as {spread.independent_samples:.0f} independent samples would: frames of a "
        "cycle are alike, and what is repeated in every cycle of one speed counts once. Priors and penalties "
        "are calibration's own: people differ from them by one allowable error. A parameter on a bound has "
        "a one-sided interval. What the model itself gets wrong is in here only as far as residuals show it."
    )


def _open_table(spread: LegSpread) -> str:
    own = spread.parameters
    rows: dict[str, list[str]] = {}
    for label, told in zip(own.labels, own.identified, strict=True):
        owner, name = label.rsplit(".", 1)
        owners = rows.setdefault("path modes" if name.startswith("path_changes_") else name, [])
        if not told and owner not in owners:
            owners.append(owner)
    cells = [(kind, str(len(owners)), ", ".join(owners)) for kind, owners in rows.items() if owners]
    if not cells:
        return markup.paragraph("Moments tell something of every parameter.")
    return markup.table(
        ("parameter", "number", "of"),
        cells,
        caption="Not determined: about as wide with the moments as without.",
    )
