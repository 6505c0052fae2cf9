"""Joint moments by OpenSim's own tool for inverse dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.osim.loading import import_opensim, load_model
from wrapjax.osim.tools import read_table, running, string_array, write_table


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
