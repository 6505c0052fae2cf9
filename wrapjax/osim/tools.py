"""OpenSim's tools for scaling, inverse kinematics and inverse dynamics as functions.

The tools read and write files, print to standard output and fail with C++ exceptions. Here their files are
temporary, their output is suppressed, and a failure is an `InputError`.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.osim.loading import check_is_file, failure_reason, import_opensim, load_model
from wrapjax.osim.model import elements

#: Accuracy of inverse kinematics. The tool's default of 1e-5 leaves noise in accelerations.
ACCURACY = 1e-8


def scale_model(generic: Path | str, setup: Path | str, mass_kg: float, scaled: Path) -> None:
    """Scale a generic model to a subject by OpenSim's ``ScaleTool`` and a static trial.

    Parameters
    ----------
    generic
        Model to scale (.osim).
    setup
        Settings of the tool: pairs of markers, weights, and the file of the static trial as a path relative
        to the settings' folder. Model, mass and outputs in the settings are replaced.
    mass_kg
        Mass of the subject, kg.
    scaled
        File of the scaled model to write.

    Raises
    ------
    InputError
        If a file is missing, the settings have no measurements, or the tool fails.
    """
    setup = check_is_file(setup)
    generic = check_is_file(generic)
    opensim = import_opensim()
    with _tool_folder("scale tool", setup) as folder:
        tool = opensim.ScaleTool(str(setup.resolve()))
        scaler, placer = tool.getModelScaler(), tool.getMarkerPlacer()
        if not scaler.getMeasurementSet().getSize():
            message = "expected settings of OpenSim's scale tool with measurements, found none"
            raise InputError(Problem(str(setup), message))
        # The tool puts this folder before every file name, also before absolute ones.
        tool.setPathToSubject("")
        tool.setSubjectMass(mass_kg)
        tool.getGenericModelMaker().setModelFileName(str(generic.resolve()))
        for part in (scaler, placer) if placer.getApply() else (scaler,):
            part.setMarkerFileName(str(_marker_file(setup, part.getMarkerFileName())))
        scaler.setOutputModelFileName(str(folder / "scaled.osim"))
        scaler.setOutputScaleFileName("")
        placer.setOutputModelFileName(str(folder / "placed.osim"))
        placer.setOutputMotionFileName("")
        placer.setOutputMarkerFileName("")
        # The tool returns whether markers were placed, not whether it failed.
        tool.run()
        result = folder / ("placed.osim" if placer.getApply() else "scaled.osim")
        if not result.is_file():
            raise InputError(Problem(str(setup), "OpenSim's scale tool wrote no model"))
        scaled.write_bytes(result.read_bytes())


def scale_masses(generic: Path | str, mass_kg: float, scaled: Path) -> float:
    """Scale masses and inertias of all bodies to a person's mass; geometry and muscles stay as they are.

    Parameters
    ----------
    generic
        Model to scale (.osim).
    mass_kg
        Mass of the person, kg.
    scaled
        File of the scaled model to write.

    Returns
    -------
    float
        Factor by which masses and inertias were multiplied.

    Raises
    ------
    InputError
        If the model cannot be loaded or has no mass.
    """
    model, _ = load_model(generic)
    bodies = list(elements(model.updBodySet()))
    total = sum(body.getMass() for body in bodies)
    if not total > 0.0:
        raise InputError(Problem(str(generic), "expected bodies with a mass, found none"))
    factor = mass_kg / total
    for body in bodies:
        inertia = body.get_inertia()
        scaled_inertia = type(inertia)(inertia)
        for place in range(6):
            scaled_inertia.set(place, factor * inertia.get(place))
        body.setMass(factor * body.getMass())
        body.set_inertia(scaled_inertia)
    model.printToXML(str(scaled))
    return float(factor)


@dataclass(frozen=True)
class Kinematics:
    """Result of inverse kinematics: the motion of a model that fits recorded markers.

    Parameters
    ----------
    coordinates
        Names of all coordinates of the model, in its order.
    time
        Time of the frames, s.
    values
        Coordinate values, rad or m. Coupled coordinates follow their couplers.
    markers
        Names of the fitted markers.
    positions
        Positions of the model's markers in ground, m.
    """

    coordinates: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    values: Float[np.ndarray, "coordinate frame"]
    markers: tuple[str, ...]
    positions: Float[np.ndarray, "marker frame 3"]


def marker_names(model_file: Path | str) -> tuple[str, ...]:
    """Find the names of a model's markers."""
    model, _ = load_model(model_file)
    return tuple(marker.getName() for marker in elements(model.getMarkerSet()))


def solve_inverse_kinematics(
    model_file: Path | str,
    marker_file: Path | str,
    weights: Mapping[str, float],
    start: float,
    end: float,
    accuracy: float = ACCURACY,
) -> Kinematics:
    """Compute joint angles from recorded markers by OpenSim's ``InverseKinematicsTool``.

    Parameters
    ----------
    model_file
        OpenSim model (.osim), scaled to the subject, with markers.
    marker_file
        Recorded markers (.trc) in ground's frame.
    weights
        Weight, above zero, of each marker to fit; all of them must be in the file and in the model.
    start, end
        Time range, s.
    accuracy
        Accuracy of the tool's optimiser.

    Raises
    ------
    InputError
        If the model cannot be loaded, or the tool fails.
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    tool = opensim.InverseKinematicsTool()
    with _tool_folder("inverse kinematics", marker_file) as folder:
        tasks = tool.upd_IKTaskSet()
        for name, weight in weights.items():
            task = opensim.IKMarkerTask()
            task.setName(name)
            task.setApply(True)
            task.setWeight(weight)
            tasks.cloneAndAppend(task)
        tool.setModel(model)
        tool.setMarkerDataFileName(str(Path(marker_file).resolve()))
        tool.setStartTime(start)
        tool.setEndTime(end)
        tool.set_accuracy(accuracy)
        tool.set_report_errors(False)
        tool.set_report_marker_locations(True)
        tool.setResultsDir(str(folder))
        tool.setOutputMotionFileName(str(folder / "motion.sto"))
        tool.run()
        labels, time, degrees = _read_table(folder / "motion.sto")
        located = next(folder.glob("*model_marker_locations.sto"))
        places, _, positions = _read_table(located)
    motions = {entry.getName(): entry.getMotionType() for entry in elements(model.getCoordinateSet())}
    missing = [name for name in motions if name not in labels]
    if missing:
        message = f"OpenSim's inverse kinematics wrote no {', '.join(missing)}"
        raise InputError(Problem(str(marker_file), message))
    # The tool writes rotational coordinates in degrees, and others in SI units.
    rotational = opensim.Coordinate.Rotational
    factor = np.array([np.pi / 180.0 if kind == rotational else 1.0 for kind in motions.values()])
    columns = [labels.index(name) for name in motions]
    order = [[places.index(f"{name}_t{axis}") for axis in "xyz"] for name in weights]
    return Kinematics(
        coordinates=tuple(motions),
        time=time,
        values=factor[:, None] * degrees[:, columns].T,
        markers=tuple(weights),
        positions=np.moveaxis(positions[:, order], 0, 1),
    )


def solve_inverse_dynamics(
    model_file: Path | str,
    coordinates: Sequence[str],
    time: Float[np.ndarray, " frame"],
    values: Float[np.ndarray, "coordinate frame"],
    external_loads: Path | str,
    lowpass_hz: float | None = None,
) -> dict[str, Float[np.ndarray, " frame"]]:
    """Compute joint moments of a motion, without muscles, by OpenSim's ``InverseDynamicsTool``.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    coordinates
        Names of the coordinates in ``values``. Others stay at the model's defaults. Coupled coordinates must
        be given, because the tool does not make them follow.
    time
        Time of the frames, s.
    values
        Coordinate values, rad or m.
    external_loads
        OpenSim's file of external loads, which names a file of forces in the same folder.
    lowpass_hz
        Cut-off frequency of the tool's filter of coordinates, Hz; None for motions that are already filtered.

    Returns
    -------
    dict
        Joint moment about each coordinate (N m; for a translation a force, N) at ``time``, positive if it
        increases the coordinate. Keys are OpenSim's labels, such as ``hip_flexion_l_moment`` and
        ``pelvis_tx_force``.

    Raises
    ------
    InputError
        If the model cannot be loaded, or the tool fails.
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    tool = opensim.InverseDynamicsTool()
    with _tool_folder("inverse dynamics", external_loads) as folder:
        motion = folder / "motion.sto"
        _write_table(motion, coordinates, time, values)
        tool.setModel(model)
        tool.setCoordinatesFileName(str(motion))
        tool.setLowpassCutoffFrequency(-1.0 if lowpass_hz is None else lowpass_hz)
        tool.setExternalLoadsFileName(str(Path(external_loads).resolve()))
        tool.setExcludedForces(_string_array(["Muscles"]))
        tool.setStartTime(float(time[0]))
        tool.setEndTime(float(time[-1]))
        tool.setResultsDir(str(folder))
        tool.setOutputGenForceFileName("moments.sto")
        tool.run()
        labels, at, table = _read_table(folder / "moments.sto")
    # The tool's frames equal those of the motion except for rounding.
    return {label: np.interp(time, at, column) for label, column in zip(labels, table.T, strict=True)}


@contextmanager
def _tool_folder(tool: str, file: Path | str) -> Iterator[Path]:
    """Yield a temporary folder for the files of one of OpenSim's tools, and convert the tool's failure.

    Parameters
    ----------
    tool
        Name of the tool for the message.
    file
        File to name in the message.

    Raises
    ------
    InputError
        If the tool fails.
    """
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        try:
            with _silent():
                yield Path(folder)
        except RuntimeError as error:
            message = f"OpenSim's {tool} stopped ({failure_reason(error)})"
            raise InputError(Problem(str(file), message)) from error


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress what OpenSim prints directly to the standard output of the process, not by its logger."""
    sys.stdout.flush()
    original = os.dup(1)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        yield
    finally:
        os.dup2(original, 1)
        os.close(original)
        os.close(null)


def _read_table(path: Path) -> tuple[tuple[str, ...], Float[np.ndarray, " frame"], np.ndarray]:
    """Read a table that a tool has written: labels, time (s), and values ``frame column`` in their units."""
    table = import_opensim().TimeSeriesTable(str(path))
    return (
        tuple(table.getColumnLabels()),
        np.array(table.getIndependentColumn()),
        table.getMatrix().to_numpy(),
    )


def _write_table(
    path: Path,
    names: Sequence[str],
    time: Float[np.ndarray, " frame"],
    values: Float[np.ndarray, "column frame"],
) -> None:
    """Write a table in SI units and radians as input of a tool."""
    opensim = import_opensim()
    table = opensim.TimeSeriesTable(time.tolist(), opensim.Matrix.createFromMat(values.T.copy()), list(names))
    table.addTableMetaDataString("inDegrees", "no")
    opensim.STOFileAdapter.write(table, str(path))


def _string_array(names: Sequence[str]) -> Any:
    """Create an OpenSim array of strings."""
    array = import_opensim().ArrayStr()
    for name in names:
        array.append(name)
    return array


def _marker_file(setup: Path, name: str) -> Path:
    path = setup.resolve().parent / name
    if not path.is_file():
        message = f"expected the file of a static trial, found no {path}"
        raise InputError(Problem(str(setup), message, "<marker_file>"))
    return path
