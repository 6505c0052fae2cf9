"""Tables of a calibration: parameters as CSV and ``.osimx``, curves over time as OpenSim storage."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.uncertainty.intervals import LegSpread
from wrapjax.io.storage import Storage
from wrapjax.model.parameters import QUANTITIES
from wrapjax.preprocessing.nmsm.files import OSIMX_QUANTITIES, OsimxMuscle, format_osimx
from wrapjax.report.cycle_panels import MomentCurves
from wrapjax.subject.trials import GAIT

PARAMETER_COLUMNS = ("owner", "kind", "parameter", "value", "unit", "lower", "upper")
#: Further columns if uncertainty was requested.
SPREAD_COLUMNS = ("sd", "low_90", "high_90")
#: Remark in an ``.osimx`` file of muscles whose paths changed.
CHANGED_PATHS = (
    "{method} changed muscle geometry as well, by coefficients of polynomials, which neither this file nor a "
    "model can represent: with the paths of the model named here, these parameters do not give the "
    "calibrated moments. The coefficients are in parameters.csv and paths.npz of the run."
)


def parameters_csv(result: CalibrationResult, spread: LegSpread | None = None) -> str:
    """Write every parameter of every muscle in SI units with all digits, with bounds if it was free.

    Then follow the weights of excitations made from synergies, the parameters of freed wraps, and the
    coefficients of freed paths (``PathSurrogate.term_names``), which have no bounds: the path length is the
    sum of coefficients times terms, whose coordinates are scaled as stated in settings.json. Given the
    uncertainty, free parameters also have a standard deviation and a 90 % interval; coefficients have none.
    """
    freed = {parameter.name: parameter for parameter in result.freedom.parameters}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(PARAMETER_COLUMNS + (SPREAD_COLUMNS if spread is not None else ()))
    spread_cells = {} if spread is None else _spread_cells(spread)
    empty: list[float | str] = [""] * (0 if spread is None else len(SPREAD_COLUMNS))
    for row, muscle in enumerate(result.muscles):
        for name, quantity in QUANTITIES.items():
            value = float(getattr(result.parameters, name)[row])
            bounds: tuple[float | str, float | str] = ("", "")
            if name in freed:
                bounds = (float(freed[name].lower[row]), float(freed[name].upper[row]))
            cells = spread_cells.get(f"{muscle}.{name}", empty)
            writer.writerow((muscle, "muscle", name, value, quantity.unit, *bounds, *cells))
    for owner, name, value, bound in _synergy_weights(result):
        cells = spread_cells.get(f"{owner}.{name}", empty)
        writer.writerow((owner, "synergy", name, value, "1", -bound, bound, *cells))
    for owner, name, *entries in wrap_parameters(result):
        writer.writerow((owner, "wrap", name, *entries, *spread_cells.get(f"{owner}.{name}", empty)))
    if result.freedom.paths is not None and result.calibrated_paths is not None:
        paths = result.calibrated_paths
        names, used, coefficients = paths.term_names(), np.asarray(paths.used), np.asarray(paths.coefficients)
        for row in np.flatnonzero(result.freedom.paths.muscles).tolist():
            values = coefficients[row, used[row]].tolist()
            for term, value in zip(names[row], values, strict=True):
                writer.writerow((result.muscles[row], "term", term, value, "m", "", "", *empty))
    return text.getvalue()


def _spread_cells(spread: LegSpread) -> dict[str, list[float]]:
    own = spread.parameters
    rows = zip(own.labels, own.deviation.tolist(), own.low.tolist(), own.high.tolist(), strict=True)
    return {label: cells for label, *cells in rows}


def band_table(result: CalibrationResult, spread: LegSpread, trial: int) -> Storage:
    """Tabulate the band about one cycle's modelled moments that contains 90 % of the draws, in N m."""
    columns = tuple(f"{name}_moment_{end}_90" for end in ("low", "high") for name in result.coordinates)
    rows = np.concatenate([spread.low[trial], spread.high[trial]])
    name = f"90 % bands of modelled joint moments (N m) of {result.trials[trial]}"
    return Storage(name, columns, result.time[trial], rows.T)


def osimx_of(result: CalibrationResult, model_file: str) -> str:
    """Write the muscle parameters as an ``.osimx`` file of the NMSM Pipeline.

    The format has no elements for geometry. Calibrated wraps are in the model that the file names;
    changed polynomials cannot be represented, which a remark in the file states.

    Parameters
    ----------
    result
        Result of one leg.
    model_file
        Model to which the parameters apply, relative to the folder of the written file.
    """
    columns = {name: np.asarray(getattr(result.parameters, name)) for name in OSIMX_QUANTITIES}
    muscles = [
        OsimxMuscle(muscle, {name: float(column[row]) for name, column in columns.items()})
        for row, muscle in enumerate(result.muscles)
    ]
    remark = "" if result.freedom.paths is None else CHANGED_PATHS.format(method=result.method)
    return format_osimx(PurePosixPath(model_file).stem, model_file, muscles, remark)


def _synergy_weights(result: CalibrationResult) -> Iterator[tuple[str, str, float, float]]:
    """Iterate over synergy weights: name of the excitation, name of the weight, value and bound."""
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
    """Iterate over free parameters of wraps: wrap, parameter name, value, unit and bounds."""
    wraps = result.freedom.wraps
    if wraps is None:
        return
    values = wraps.values_of(np.asarray(result.parameters.path_changes))
    for wrap, owner in enumerate(wraps.names):
        for place, quantity in enumerate(wraps.quantities):
            if not wraps.free[wrap, place]:
                continue
            lower, upper = (
                float(wraps.nominal[place] + end[wrap, place]) for end in (wraps.lower, wraps.upper)
            )
            yield owner, quantity, float(values[wrap, place]), wraps.units[place], lower, upper


def moment_labels(coordinates: Sequence[str]) -> tuple[str, ...]:
    """Make the column names of a table of moments: modelled, then measured."""
    labels = tuple(f"{coordinate}_moment" for coordinate in coordinates)
    return labels + tuple(f"{label}_measured" for label in labels)


def moment_table(cycles: MomentCurves, time: Float[np.ndarray, "trial frame"], trial: int) -> Storage:
    """Tabulate one cycle's moments, modelled and measured, in N m over time in s.

    Of a window of another task, the frames in which a moment was measured, and the measured coordinates.
    """
    moments = np.concatenate([cycles.modelled[trial], cycles.measured[trial]])
    name = f"joint moments (N m) of {cycles.trials[trial]}"
    labels = np.array(moment_labels(cycles.coordinates))
    if cycles.tasks[trial] == GAIT:
        return Storage(name, tuple(labels.tolist()), time[trial], moments.T)
    frames = np.isfinite(cycles.measured[trial]).any(axis=0)
    rows = np.isfinite(moments[:, frames]).all(axis=1)
    return Storage(name, tuple(labels[rows].tolist()), time[trial][frames], moments[rows][:, frames].T)


def curve_tables(result: CalibrationResult, trial: int) -> dict[str, Storage]:
    """Tabulate one cycle's curves, by the name of the folder to which they are written.

    Parameters
    ----------
    result
        Result of the calibration.
    trial
        Index of the cycle.

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
