"""What joints bear."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrapjax.api.datasets.labelled import MOMENT, USE, Column, labelled
from wrapjax.contact.compartments import COMPARTMENTS
from wrapjax.contact.result import ContactResult

if TYPE_CHECKING:
    from xarray import Dataset


def contact_dataset(result: ContactResult) -> Dataset:
    """Label what joints bear, by run, and which moments no muscle explains.

    Returns
    -------
    Dataset
        Forces in N, of the distal bone on the proximal one, along the proximal one's axes.
    """
    columns: dict[str, Column] = {
        "contact_force": (
            ("run", "trial", "joint", "axis", "frame"),
            "N",
            f"{result.kind.replace('_', ' ')} on the proximal bone, along its axes",
            np.stack([run.force for run in result.runs]),
        ),
        "contact_force_magnitude": (
            ("run", "trial", "joint", "frame"),
            "N",
            f"size of the {result.kind.replace('_', ' ')}",
            np.stack([run.magnitude for run in result.runs]),
        ),
        "unexplained_moment": (
            ("run", *MOMENT),
            "N m",
            "measured joint moment less those of all muscles",
            np.stack([run.undriven.residual for run in result.runs]),
        ),
    }
    if result.condyle_distance is not None:
        columns["knee_compartment_force"] = (
            ("run", "trial", "compartment", "frame"),
            "N",
            "what presses either side of the knee together",
            np.stack([run.compartments for run in result.runs if run.compartments is not None]),
        )
    labels = {
        "run": [run.label for run in result.runs],
        "trial": result.trials,
        "joint": list(result.joints),
        "compartment": COMPARTMENTS,
        "axis": ("x", "y", "z"),
        "coordinate": result.coordinates,
        "frame": np.arange(result.time.shape[1]),
    }
    of_cycles: dict[str, Column] = {
        "use": (("trial",), "", USE, list(result.uses)),
        "time": (("trial", "frame"), "s", "time in the recording", result.time),
        "gait_phase": (
            ("trial", "frame"),
            "%",
            "of the gait cycle, from the foot's strike, beyond 100 after the next one",
            result.phase,
        ),
    }
    attributes = {"kind": result.kind, "reason": result.reason, "bodyweight_N": f"{result.bodyweight:.6g}"}
    return labelled(columns, labels, of_cycles, attributes)
