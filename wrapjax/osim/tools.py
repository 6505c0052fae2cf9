"""What OpenSim's tools have in common: they talk, they read and write files, and they fail in C++.

A generic model made as large as a person, by OpenSim's own scale tool.

Joint angles from markers by OpenSim's own tool for inverse kinematics.

Joint moments by OpenSim's own tool for inverse dynamics.
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


@contextmanager
def running(tool: str, file: Path | str) -> Iterator[Path]:
    """Run one of OpenSim's tools: yields a folder for its files, which is gone afterwards.

    Parameters
    ----------
    tool
        What runs, in words, for the message.
    file
        The file to name if it fails.

    Raises
    ------
    InputError
        If OpenSim gives up.
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
    """Drop what OpenSim prints past its logger, straight to the process's standard output."""
    sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def read_table(path: Path) -> tuple[tuple[str, ...], Float[np.ndarray, " frame"], np.ndarray]:
    """Read a table that a tool has written: labels, time in s, values (frame, column) in its own units."""
    table = import_opensim().TimeSeriesTable(str(path))
    return (
        tuple(table.getColumnLabels()),
        np.array(table.getIndependentColumn()),
        table.getMatrix().to_numpy(),
    )


def write_table(
    path: Path,
    names: Sequence[str],
    time: Float[np.ndarray, " frame"],
    values: Float[np.ndarray, "column frame"],
) -> None:
    """Write a table in SI units and radians for a tool to read."""
    opensim = import_opensim()
    table = opensim.TimeSeriesTable(time.tolist(), opensim.Matrix.createFromMat(values.T.copy()), list(names))
    table.addTableMetaDataString("inDegrees", "no")
    opensim.STOFileAdapter.write(table, str(path))


def string_array(names: Sequence[str]) -> Any:
    """Make an OpenSim array of strings."""
    array = import_opensim().ArrayStr()
    for name in names:
        array.append(name)
    return array


def scale_model(generic: Path | str, setup: Path | str, mass_kg: float, scaled: Path) -> None:
    """Run ``ScaleTool`` on a static trial.

    Parameters
    ----------
    generic
        Model to be scaled.
    setup
        The tool's own settings: pairs of markers, weights, and the file of the static trial, by a path
        from the settings' folder. Its model, mass and outputs are replaced.
    mass_kg
        Of the person.
    scaled
        Where to write the model.

    Raises
    ------
    InputError
        If the settings are no settings of the tool, or it gives up.
    """
    setup = check_is_file(setup)
    generic = check_is_file(generic)
    opensim = import_opensim()
    with running("scale tool", setup) as folder:
        tool = opensim.ScaleTool(str(setup.resolve()))
        scaler, placer = tool.getModelScaler(), tool.getMarkerPlacer()
        if not scaler.getMeasurementSet().getSize():
            message = "expected settings of OpenSim's scale tool with measurements, found none"
            raise InputError(Problem(str(setup), message))
        # The tool puts its folder before every name, absolute ones too.
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
        # What it returns says whether markers were placed, not whether it failed.
        tool.run()
        result = folder / ("placed.osim" if placer.getApply() else "scaled.osim")
        if not result.is_file():
            raise InputError(Problem(str(setup), "OpenSim's scale tool gave no model"))
        scaled.write_bytes(result.read_bytes())


def _marker_file(setup: Path, name: str) -> Path:
    path = setup.resolve().parent / name
    if not path.is_file():
        message = f"expected the file of a static trial, found no {path}"
        raise InputError(Problem(str(setup), message, "<marker_file>"))
    return path


#: Angles are solved to this; the tool's default of 1e-5 leaves noise in accelerations.
ACCURACY = 1e-8


@dataclass(frozen=True)
class Kinematics:
    """How a model moves so that its markers follow those recorded.

    Parameters
    ----------
    coordinates
        All of the model, in its order.
    time
        s.
    values
        rad or m. Coupled coordinates follow their couplers.
    markers
        Those that were followed.
    positions
        Where the model's markers then are, m.
    """

    coordinates: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    values: Float[np.ndarray, "coordinate frame"]
    markers: tuple[str, ...]
    positions: Float[np.ndarray, "marker frame 3"]


def marker_names(model_file: Path | str) -> tuple[str, ...]:
    """Name the markers of a model."""
    model, _ = load_model(model_file)
    return tuple(marker.getName() for marker in elements(model.getMarkerSet()))


def solve_inverse_kinematics(
    model_file: Path | str,
    marker_file: Path | str,
    weights: Mapping[str, float],
    start: float,
    end: float,
) -> Kinematics:
    """Run ``InverseKinematicsTool`` on a file of markers.

    Parameters
    ----------
    model_file
        OpenSim model (.osim), scaled to the person, with markers.
    marker_file
        ``.trc`` in ground's frame.
    weights
        Of each marker to follow, above zero; all must be in the file and in the model.
    start, end
        s.

    Raises
    ------
    InputError
        If the model cannot be loaded, or the tool gives up.
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    tool = opensim.InverseKinematicsTool()
    with running("inverse kinematics", marker_file) as folder:
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
        tool.set_accuracy(ACCURACY)
        tool.set_report_errors(False)
        tool.set_report_marker_locations(True)
        tool.setResultsDir(str(folder))
        tool.setOutputMotionFileName(str(folder / "motion.sto"))
        tool.run()
        labels, time, degrees = read_table(folder / "motion.sto")
        located = next(folder.glob("*model_marker_locations.sto"))
        places, _, positions = read_table(located)
    motions = {entry.getName(): entry.getMotionType() for entry in elements(model.getCoordinateSet())}
    missing = [name for name in motions if name not in labels]
    if missing:
        message = f"OpenSim's inverse kinematics gave no {', '.join(missing)}"
        raise InputError(Problem(str(marker_file), message))
    # The tool writes rotations in degrees, other coordinates as they are.
    turning = opensim.Coordinate.Rotational
    factor = np.array([np.pi / 180.0 if kind == turning else 1.0 for kind in motions.values()])
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
    """Run ``InverseDynamicsTool`` on a motion, muscles left out.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    coordinates
        Whose values are given. The tool leaves others at the model's defaults; coupled coordinates have
        to be among those given, or they do not follow.
    time
        s.
    values
        rad or m.
    external_loads
        OpenSim's file of what acts on which body; it names the file of forces beside it.
    lowpass_hz
        Cut-off of the tool's own filter of coordinates; None for motions that have been filtered.

    Returns
    -------
    dict
        Moment about each coordinate (N m; along a translation, force in N) at ``time``, positive where it
        drives the coordinate up. Keys are OpenSim's labels: ``hip_flexion_l_moment``, ``pelvis_tx_force``.

    Raises
    ------
    InputError
        If the model cannot be loaded, or the tool gives up.
    """
    opensim = import_opensim()
    model, _ = load_model(model_file)
    tool = opensim.InverseDynamicsTool()
    with running("inverse dynamics", external_loads) as folder:
        motion = folder / "motion.sto"
        write_table(motion, coordinates, time, values)
        tool.setModel(model)
        tool.setCoordinatesFileName(str(motion))
        tool.setLowpassCutoffFrequency(-1.0 if lowpass_hz is None else lowpass_hz)
        tool.setExternalLoadsFileName(str(Path(external_loads).resolve()))
        tool.setExcludedForces(string_array(["Muscles"]))
        tool.setStartTime(float(time[0]))
        tool.setEndTime(float(time[-1]))
        tool.setResultsDir(str(folder))
        tool.setOutputGenForceFileName("moments.sto")
        tool.run()
        labels, at, table = read_table(folder / "moments.sto")
    # The tool decides where to put its own frames; they are the motion's but for rounding.
    return {label: np.interp(time, at, column) for label, column in zip(labels, table.T, strict=True)}
