"""Joint angles from markers by OpenSim's own tool for inverse kinematics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.model import elements
from wrapjax.osim.tools import read_table, running

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
