"""Parameters as a CSV table, curves over time as OpenSim tables."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.result import CalibrationResult
from wrapjax.calibration.uncertainty.intervals import LegSpread
from wrapjax.geometry.wrapping import NOMINAL
from wrapjax.io.storage import Storage
from wrapjax.model.parameters import QUANTITIES
from wrapjax.preprocessing.nmsm_osimx import OSIMX_QUANTITIES, OsimxMuscle, osimx_text
from wrapjax.report.moment_curves import MomentCurves

PARAMETER_COLUMNS = ("owner", "kind", "parameter", "value", "unit", "lower", "upper")
#: Where spreads were asked for.
SPREAD_COLUMNS = ("sd", "low_90", "high_90")
#: Said in an ``.osimx`` file of muscles whose paths changed.
CHANGED_PATHS = (
    "{method} changed muscle geometry as well, by coefficients of polynomials, which neither this file nor a "
    "model can carry: along the paths of the model named here these parameters do not give the calibrated "
    "moments. parameters.csv and paths.npz of the run have the coefficients."
)


def parameters_csv(result: CalibrationResult, spread: LegSpread | None = None) -> str:
    """Write every parameter of every muscle, SI units and all digits; bounds only where it was free.

    Of excitations that synergies made the weights follow; of cylinders that were free every parameter; of
    paths that were free, every coefficient (``PathSurrogate.term_names``), which has no bounds: the length is
    the sum of coefficients times terms, whose coordinates are scaled as settings.json says. Given the spread,
    standard deviation and 90 % interval follow where a parameter was free; coefficients have none.
    """
    freed = {parameter.name: parameter for parameter in result.freedom.parameters}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(PARAMETER_COLUMNS + (SPREAD_COLUMNS if spread is not None else ()))
    known = {} if spread is None else _spread_cells(spread)
    nothing: list[float | str] = [""] * (0 if spread is None else len(SPREAD_COLUMNS))
    for row, muscle in enumerate(result.muscles):
        for name, quantity in QUANTITIES.items():
            value = float(getattr(result.parameters, name)[row])
            bounds: tuple[float | str, float | str] = ("", "")
            if name in freed:
                bounds = (float(freed[name].lower[row]), float(freed[name].upper[row]))
            cells = known.get(f"{muscle}.{name}", nothing)
            writer.writerow((muscle, "muscle", name, value, quantity.unit, *bounds, *cells))
    for owner, name, value, bound in _synergy_weights(result):
        cells = known.get(f"{owner}.{name}", nothing)
        writer.writerow((owner, "synergy", name, value, "1", -bound, bound, *cells))
    for owner, name, *entries in wrap_parameters(result):
        writer.writerow((owner, "wrap", name, *entries, *known.get(f"{owner}.{name}", nothing)))
    if result.freedom.paths is not None and result.calibrated_paths is not None:
        paths = result.calibrated_paths
        names, used, coefficients = paths.term_names(), np.asarray(paths.used), np.asarray(paths.coefficients)
        for row in np.flatnonzero(result.freedom.paths.muscles).tolist():
            values = coefficients[row, used[row]].tolist()
            for term, value in zip(names[row], values, strict=True):
                writer.writerow((result.muscles[row], "term", term, value, "m", "", "", *nothing))
    return text.getvalue()


def _spread_cells(spread: LegSpread) -> dict[str, list[float]]:
    own = spread.parameters
    rows = zip(own.labels, own.deviation.tolist(), own.low.tolist(), own.high.tolist(), strict=True)
    return {label: cells for label, *cells in rows}


def band_table(result: CalibrationResult, spread: LegSpread, trial: int) -> Storage:
    """Give the band about one cycle's modelled moments that holds 90 % of the draws, in N m."""
    columns = tuple(f"{name}_moment_{end}_90" for end in ("low", "high") for name in result.coordinates)
    rows = np.concatenate([spread.low[trial], spread.high[trial]])
    name = f"90 % bands of modelled joint moments (N m) of {result.trials[trial]}"
    return Storage(name, columns, result.time[trial], rows.T)


def osimx_of(result: CalibrationResult, model_file: str) -> str:
    """Write the muscles' parameters as the NMSM Pipeline takes them on.

    It has no place for geometry: cylinders that moved are in the model that it names, polynomials that
    changed are nowhere in it, and it says so.

    Parameters
    ----------
    result
        Of one leg.
    model_file
        The model that they belong to, from the folder that this is written to.
    """
    columns = {name: np.asarray(getattr(result.parameters, name)) for name in OSIMX_QUANTITIES}
    muscles = [
        OsimxMuscle(muscle, {name: float(column[row]) for name, column in columns.items()})
        for row, muscle in enumerate(result.muscles)
    ]
    remark = "" if result.freedom.paths is None else CHANGED_PATHS.format(method=result.method)
    return osimx_text(PurePosixPath(model_file).stem, model_file, muscles, remark)


def _synergy_weights(result: CalibrationResult) -> Iterator[tuple[str, str, float, float]]:
    """Give the weights of each excitation that synergies made: its name, the weight's, value and bound."""
    freed = result.freedom.synergies
    if freed is None:
        return
    weights = np.asarray(result.parameters.synergy_weights)
    for number, owner in enumerate(freed.names):
        row = weights[freed.places == number][0]
        for name, value in zip(freed.labels, row.tolist(), strict=True):
            yield owner, name, value, freed.bound


def wrap_parameters(
    result: CalibrationResult,
) -> Iterator[tuple[str, str, float, str, float, float]]:
    """Give each free cylinder's parameters: owner, name, value, unit and bounds, as in `WRAP_PARAMETERS`."""
    wraps = result.freedom.wraps
    if wraps is None:
        return
    values = NOMINAL + wraps.changes_of(np.asarray(result.parameters.path_changes))
    for wrap, owner in enumerate(wraps.names):
        for place, quantity in enumerate(wraps.quantities):
            lower, upper = (float(NOMINAL[place] + end[wrap, place]) for end in (wraps.lower, wraps.upper))
            yield owner, quantity, float(values[wrap, place]), wraps.units[place], lower, upper


def moment_labels(coordinates: Sequence[str]) -> tuple[str, ...]:
    """Name the columns of a table of moments: modelled, then measured."""
    labels = tuple(f"{coordinate}_moment" for coordinate in coordinates)
    return labels + tuple(f"{label}_measured" for label in labels)


def moment_table(cycles: MomentCurves, time: Float[np.ndarray, "trial frame"], trial: int) -> Storage:
    """Give one cycle's moments, modelled and measured, in N m over time in s."""
    moments = np.concatenate([cycles.modelled[trial], cycles.measured[trial]])
    name = f"joint moments (N m) of {cycles.trials[trial]}"
    return Storage(name, moment_labels(cycles.coordinates), time[trial], moments.T)


def curve_tables(result: CalibrationResult, trial: int) -> dict[str, Storage]:
    """Give one cycle's curves, by the name of the folder they go to.

    Parameters
    ----------
    result
        All cycles.
    trial
        Which one.

    Returns
    -------
    dict of Storage
        ``moments`` in N m (``<coordinate>_moment`` modelled, ``<coordinate>_moment_measured``),
        ``activations`` from 0 to 1, ``muscle_forces`` in the tendon in N.
    """
    activation = np.asarray(result.states.activation)[:, trial]
    force = np.asarray(result.states.fiber.tendon_force)[:, trial]

    def table(title: str, columns: Sequence[str], rows: Float[np.ndarray, "column frame"]) -> Storage:
        name = f"{title} of {result.trials[trial]}"
        return Storage(name, tuple(columns), result.time[trial], rows.T)

    return {
        "moments": moment_table(result, result.time, trial),
        "activations": table("muscle activations", result.muscles, activation),
        "muscle_forces": table("tendon forces (N)", result.muscles, force),
    }
