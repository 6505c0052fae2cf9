"""The spread of parameters in numbers: the content of ``uncertainty.json``."""

from __future__ import annotations

from typing import Any

from wrapjax.calibrate import CalibrationResult, LegSpread

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
