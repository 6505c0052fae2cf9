"""How far parameters and moments may be from what was found, in the report."""

from __future__ import annotations

from wrapjax.calibrate import CalibrationResult, LegSpread
from wrapjax.report import markup
from wrapjax.report.spread_figures import band_figure, interval_figure, kinds_of
from wrapjax.report.wording import counted, decimals

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
