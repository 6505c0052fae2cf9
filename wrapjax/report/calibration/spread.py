"""Uncertainty of parameters and moments: the content of ``uncertainty.json`` and its report section."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.uncertainty.intervals import LegSpread
from wrapjax.report import markup
from wrapjax.report.cycle_panels import groups_by_speed_and_use, label_gait_cycles
from wrapjax.report.formatting import counted, decimals
from wrapjax.report.style import (
    BLACK,
    BLUE,
    LIGHT_GRAY,
    PAGE_WIDTH,
    Figure,
    draw_zero_line,
    head_column,
    in_style,
    label_bounds,
    label_rows,
    legend_above,
    new_figure,
    panel_grid,
)

_MID_BLUE = "#9CC7E4"


def kinds_of(result: CalibrationResult, spread: LegSpread) -> dict[str, list[str]]:
    """List the muscles and the wraps that have free parameters with bounds; empty kinds are omitted."""
    wraps = () if result.freedom.wraps is None else result.freedom.wraps.names
    kinds = {"muscle": list(result.muscles), "wrapping surface": list(wraps)}
    owners = {label.rsplit(".", 1)[0] for label in spread.parameters.labels}
    free = {kind: [name for name in names if name in owners] for kind, names in kinds.items()}
    return {kind: names for kind, names in free.items() if names}


@in_style
def interval_figure(result: CalibrationResult, spread: LegSpread, owners: list[str]) -> Figure:
    """Draw each parameter's 90 % interval between its bounds.

    One column a parameter, one row a muscle or wrapping surface (``owners``).
    """
    parameters = spread.parameters
    bounds = _bounds(result)
    places = {label: place for place, label in enumerate(parameters.labels)}
    names = list(
        dict.fromkeys(label.rsplit(".", 1)[1] for label in bounds if label.rsplit(".", 1)[0] in owners)
    )
    rows = np.arange(len(owners))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(owners) + 1.9)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for panel, name in zip(panels, names, strict=True):
        label_bounds(panel, name)
        own_rows = np.array([row for row in rows if f"{owners[row]}.{name}" in places])
        at = [places[f"{owners[row]}.{name}"] for row in own_rows]
        lower, upper = np.array([bounds[parameters.labels[place]] for place in at]).T
        width = np.where(upper > lower, upper - lower, 1.0)
        value, low, high = (
            (part[at] - lower) / width for part in (parameters.value, parameters.low, parameters.high)
        )
        half = 1.645 * parameters.prior_deviation[at] / width  # 90 % of a normal distribution
        identified = parameters.identified[at]
        panel.hlines(
            own_rows,
            (value - half).clip(0.0),
            (value + half).clip(None, 1.0),
            color=LIGHT_GRAY,
            linewidth=6.0,
            zorder=0,
            label="prior (without moments)",
        )
        for chosen, color, face, text in (
            (identified, BLUE, BLUE, "identified by the moments"),
            (~identified, _MID_BLUE, "white", "not identified"),
        ):
            panel.hlines(own_rows[chosen], low[chosen], high[chosen], color=color, linewidth=1.6, zorder=1)
            panel.plot(
                value[chosen],
                own_rows[chosen],
                "o",
                markerfacecolor=face,
                markeredgecolor=BLUE,
                markersize=3.6,
                label=text,
                zorder=2,
            )
    label_rows(panels, owners)
    legend_above(figure, panels[0])
    return figure


@in_style
def band_figure(result: CalibrationResult, spread: LegSpread) -> Figure:
    """Draw measured and modelled moments with the 90 % band of the draws, averaged over groups of cycles."""
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
        draw_zero_line(panel)
        panel.fill_between(percent, low, high, color=BLUE, alpha=0.3, linewidth=0, label="90 % of draws")
        panel.plot(percent, measured, color=BLACK, label="measured")
        panel.plot(percent, modelled, color=BLUE, label="modelled")
        panel.set_title(result.coordinates[row], loc="left", parse_math=False)
        if groups[column].label and row == 0:
            head_column(panel, f"{groups[column].label} ({groups[column].count})")
    label_gait_cycles(panels, len(groups), y="moment (N m)")
    legend_above(figure, panels[0])
    return figure


def _bounds(result: CalibrationResult) -> dict[str, tuple[float, float]]:
    """Collect the bounds of muscle and wrap parameters by label, SI units; path modes have no bounds."""
    found = {
        f"{muscle}.{parameter.name}": (float(parameter.lower[row]), float(parameter.upper[row]))
        for row, muscle in enumerate(result.muscles)
        for parameter in result.freedom.parameters
    }
    wraps = result.freedom.wraps
    if wraps is not None:
        found |= {
            f"{owner}.{quantity}": (
                float(wraps.nominal[place] + wraps.lower[row, place]),
                float(wraps.nominal[place] + wraps.upper[row, place]),
            )
            for row, owner in enumerate(wraps.names)
            for place, quantity in enumerate(wraps.quantities)
            if wraps.free[row, place]
        }
    return found


#: Version of the layout of ``uncertainty.json``.
SCHEMA = 1


def describe_spread(spread: LegSpread) -> dict[str, Any]:
    """Describe how the uncertainty was computed, for ``summary.json``."""
    return {
        "way": spread.way,
        "draws": len(spread.draws),
        "converged_draws": spread.converged,
        "independent_samples": spread.independent_samples,
        "parameters": len(spread.parameters.labels),
        "identified": int(spread.parameters.identified.sum()),
    }


def describe_uncertainty(result: CalibrationResult, spread: LegSpread) -> dict[str, Any]:
    """Describe the uncertainty of every free parameter and of the moments by coordinate.

    Returns
    -------
    dict
        Content of ``uncertainty.json``. Parameters by label in SI units (a path mode is dimensionless):
        ``value``, ``sd``, ``low_90`` and ``high_90``, ``sd_without_moments`` (from priors, penalties and
        bounds alone), ``identified`` and ``at_bound``. For each coordinate, the standard deviation of the
        noise and the mean half width of the band, N m; the bands themselves are in ``moment_bands/``.
    """
    own = spread.parameters
    at_bounds = set(result.at_bounds)
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
        "not_identified": [
            label for label, identified in zip(own.labels, own.identified, strict=True) if not identified
        ],
        "by_parameter": {
            label: {
                "value": float(own.value[row]),
                "unit": own.units[row],
                "sd": float(own.deviation[row]),
                "low_90": float(own.low[row]),
                "high_90": float(own.high[row]),
                "sd_without_moments": float(own.prior_deviation[row]),
                "identified": bool(own.identified[row]),
                "at_bound": label in at_bounds,
            }
            for row, label in enumerate(own.labels)
        },
    }


_WAYS = {
    "laplace": "from a normal distribution about the solution, within the bounds (Laplace approximation)",
    "bootstrap": "by parametric bootstrap, that is calibration to moments simulated by the model with noise "
    "like the residuals",
}


def spread_section(result: CalibrationResult, spread: LegSpread) -> str:
    """Write the report section on uncertainty."""
    pictures = [
        markup.picture(
            interval_figure(result, spread, owners),
            alternative=f"90 % intervals of the parameters of {counted(len(owners), kind)} between bounds.",
            caption=f"Parameters of each {kind} between their bounds: calibrated value (dot; ring if the "
            "moments hardly reduce its uncertainty) and the interval that contains 90 % of the draws (bar). "
            "Gray: interval without the moments, ± 1.645 standard deviations given priors, penalties and "
            "bounds.",
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
        markup.paragraph(_identification_finding(spread)),
        markup.paragraph(_assumptions(spread)),
        *pictures,
        _not_identified_table(spread),
        markup.picture(
            band_figure(result, spread),
            alternative="Measured and modelled joint moments over the gait cycle with 90 % bands.",
            caption="Joint moments in N m over the gait cycle, means over cycles: measured (black), "
            "modelled (blue), and the band that contains 90 % of the draws' moments. The band is the "
            "uncertainty of the model's prediction and does not include measurement noise.",
        ),
        markup.table(
            ("coordinate", "noise of moments", "half width of the band"),
            rows,
            caption="Standard deviation of measured about modelled moments, and half width of the band, "
            "averaged over cycles and phases, in N m.",
        ),
    )


def _identification_finding(spread: LegSpread) -> str:
    identified, total = int(spread.parameters.identified.sum()), len(spread.parameters.labels)
    method = f"{counted(len(spread.draws), 'draw')} {_WAYS[spread.way]}"
    if spread.way == "bootstrap":
        failed = len(spread.draws) - spread.converged
        method += f"; {failed} of them did not converge" if failed else "; all of them converged"
    return (
        f"The moments reduce the uncertainty of {identified} of {counted(total, 'free parameter')} by more "
        "than a fifth. The uncertainty of the others is that given by priors, penalties and bounds. Method: "
        f"{method}."
    )


def _assumptions(spread: LegSpread) -> str:
    return (
        f"The residuals contain as much information as {spread.independent_samples:.0f} independent samples: "
        "frames of a cycle are correlated, and an error that recurs in every cycle of a speed counts once. "
        "Priors and penalties are those of the calibration, with a standard deviation of one allowable "
        "error. A parameter on a bound has a one-sided interval. Errors of the model form are included only "
        "to the extent that they appear in the residuals."
    )


def _not_identified_table(spread: LegSpread) -> str:
    parameters = spread.parameters
    rows: dict[str, list[str]] = {}
    for label, identified in zip(parameters.labels, parameters.identified, strict=True):
        owner, name = label.rsplit(".", 1)
        owners = rows.setdefault("path modes" if name.startswith("path_changes_") else name, [])
        if not identified and owner not in owners:
            owners.append(owner)
    cells = [(kind, str(len(owners)), ", ".join(owners)) for kind, owners in rows.items() if owners]
    if not cells:
        return markup.paragraph("The moments reduce the uncertainty of every parameter.")
    return markup.table(
        ("parameter", "number", "muscles or wrapping surfaces"),
        cells,
        caption="Parameters that the moments do not identify: their interval is about as wide with the "
        "moments as without.",
    )
