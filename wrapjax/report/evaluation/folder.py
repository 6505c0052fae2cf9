"""The folder of an evaluation. All that its page shows is in other files, so that it can be drawn again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.files import write_json, write_text
from wrapjax.report.evaluation.content import PredictedCycles, predicted_cycles
from wrapjax.report.evaluation.page import render_evaluation
from wrapjax.report.tables import moment_labels, moment_table
from wrapjax.stored import load_json
from wrapjax.subject import Trials, read_storage, write_storage


def write_evaluation(
    content: dict[str, Any],
    trials: Trials,
    modelled: Float[np.ndarray, "trial coordinate frame"],
    folder: Path,
) -> None:
    """Write ``evaluation.json``, ``moments/<trial>.sto`` and ``report.html``."""
    cycles = predicted_cycles(trials, modelled)
    write_json(folder / "evaluation.json", content)
    for number, own in enumerate(content["trials"].values()):
        write_storage(folder / "moments" / f"{own['file']}.sto", moment_table(cycles, cycles.time, number))
    write_text(folder / "report.html", render_evaluation(content, cycles))


def redraw_evaluation(folder: Path) -> None:
    """Write ``report.html`` again from the other files.

    Raises
    ------
    InputError
        If one of them is missing or damaged.
    """
    file = folder / "evaluation.json"
    try:
        content = load_json(file)
        cycles = _read_cycles(content, folder / "moments")
        page = render_evaluation(content, cycles)
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            Problem(str(file), f"is damaged ({error})", hint="make it anew with 'wrapjax evaluate'")
        ) from error
    write_text(folder / "report.html", page)


def _read_cycles(content: dict[str, Any], folder: Path) -> PredictedCycles:
    coordinates = tuple(content["coordinates"])
    labels = moment_labels(coordinates)
    time, moments = [], []
    for own in content["trials"].values():
        table = read_storage(folder / f"{own['file']}.sto")
        time.append(table.time)
        moments.append(table.values[:, [table.columns.index(label) for label in labels]].T)
    both = np.stack(moments)
    return PredictedCycles(
        coordinates=coordinates,
        trials=tuple(content["trials"]),
        uses=tuple(own["use"] for own in content["trials"].values()),
        speeds=np.array(
            [math.nan if own["speed_m_s"] is None else own["speed_m_s"] for own in content["trials"].values()]
        ),
        time=np.stack(time),
        measured=both[:, len(coordinates) :],
        modelled=both[:, : len(coordinates)],
    )
