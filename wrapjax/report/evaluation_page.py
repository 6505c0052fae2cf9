"""Predicted cycles, and their errors in numbers: the content of ``evaluation.json``.

The page of an evaluation.

The folder of an evaluation. All that its page shows is in other files, so that it can be drawn again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.metrics import pooled_mae
from wrapjax.io.files import write_json, write_text
from wrapjax.io.json_and_arrays import load_json
from wrapjax.io.storage import read_storage, write_storage
from wrapjax.report import markup
from wrapjax.report.curves import moments_section
from wrapjax.report.run_summary import USES, by_trial, by_use, errors_of, pooled_rmse
from wrapjax.report.run_tables import moment_labels, moment_table
from wrapjax.report.style import counted, decimals
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

#: Version of the layout of ``evaluation.json``.
SCHEMA = 1


@dataclass(frozen=True)
class PredictedCycles:
    """Measured and modelled joint moments of gait cycles (`wrapjax.report.moment_curves.MomentCurves`).

    Parameters
    ----------
    coordinates, trials, uses
        Names along the axes, and what each cycle is for.
    speeds
        m/s, NaN where unknown.
    time
        s.
    measured, modelled
        N m.
    """

    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " trial"]
    time: Float[np.ndarray, "trial frame"]
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]


def predicted_cycles(
    trials: Trials, modelled: Float[np.ndarray, "trial coordinate frame"]
) -> PredictedCycles:
    """Put a subject's cycles beside what was predicted of them (N m)."""
    return PredictedCycles(
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        uses=trials.uses,
        speeds=trials.speeds,
        time=trials.time,
        measured=trials.moments,
        modelled=modelled,
    )


def describe_evaluation(
    run_summary: dict[str, Any],
    subject: Subject,
    modelled: Float[np.ndarray, "trial coordinate frame"],
    notes: Sequence[str],
) -> dict[str, Any]:
    """Describe an evaluation as plain numbers and words.

    Returns
    -------
    dict
        ``mae_Nm``, ``rmse_Nm`` and ``trials`` as in ``summary.json`` (N m, all frames of the cycles), the
        run's own errors beside them, speeds, and notes.
    """
    cycles = predicted_cycles(subject.trials, modelled)
    errors = errors_of(cycles.measured, cycles.modelled)
    speeds = dict(zip(cycles.trials, cycles.speeds.tolist(), strict=True))
    return {
        "schema": SCHEMA,
        "subject": subject.name,
        "coordinates": cycles.coordinates,
        "run": {
            "subject": run_summary["subject"],
            "method": run_summary["method"],
            "mae_Nm": run_summary["mae_Nm"],
            "rmse_Nm": run_summary["rmse_Nm"],
        },
        "mae_Nm": by_use(pooled_mae, errors, cycles),
        "rmse_Nm": by_use(pooled_rmse, errors, cycles),
        "trials": {name: own | {"speed_m_s": speeds[name]} for name, own in by_trial(errors, cycles).items()},
        "notes": list(notes),
    }


def render_evaluation(content: dict[str, Any], cycles: PredictedCycles) -> str:
    """Write the page of an evaluation, with nothing outside it.

    Parameters
    ----------
    content
        From `describe_evaluation`.
    cycles
        Curves of the same cycles.
    """
    run = content["run"]
    title = f"{content['subject']}: predicted by the {run['method']} calibration of {run['subject']}"
    counts = [f"{counted(cycles.uses.count(use), f'{use} cycle')}" for use in USES if use in cycles.uses]
    under = f"{counted(len(cycles.coordinates), 'coordinate')}, {' and '.join(counts)}; nothing was fitted."
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict(content),
            _errors(content, cycles),
            moments_section(cycles, content),
            _trials(content, cycles),
            markup.section("Notes", markup.bullets([*content["notes"], _FILES])),
        ],
    )


_FILES = (
    "Errors are in evaluation.json, curves of every cycle in moments/. 'Calibration' and 'validation' are "
    "what the settings of the evaluated subject call its cycles; the run may have seen neither."
)


def _verdict(content: dict[str, Any]) -> str:
    lines = []
    for use in USES:
        own, before = content["mae_Nm"][use], content["run"]["mae_Nm"][use]
        if own is not None:
            beside = "" if before is None else f" (the run's own: {decimals(before['mean'])} N m)"
            lines.append(
                f"On {use} cycles predicted and measured joint moments differ by {decimals(own['mean'])} N m "
                f"on average{beside}."
            )
    return markup.box("\n".join(map(markup.paragraph, lines)), "verdict")


def _errors(content: dict[str, Any], cycles: PredictedCycles) -> str:
    columns: dict[str, dict[str, float]] = {}
    for use in USES:
        if content["mae_Nm"][use] is not None:
            columns |= {f"{use}: MAE": content["mae_Nm"][use], f"{use}: RMSE": content["rmse_Nm"][use]}
        if content["run"]["mae_Nm"][use] is not None:
            columns[f"run's {use}: MAE"] = content["run"]["mae_Nm"][use]
    peak = np.abs(cycles.measured).max(axis=(0, 2))
    largest = dict(zip(cycles.coordinates, peak.tolist(), strict=True))
    rows = [
        (name, decimals(largest.get(name)), *(decimals(column.get(name)) for column in columns.values()))
        for name in (*cycles.coordinates, "mean")
    ]
    caption = (
        "Errors of joint moments in N m over all frames of the cycles: mean absolute (MAE) and root mean "
        "square (RMSE). 'Run's' are those that the calibration itself ended with, on its own cycles."
    )
    return markup.section(
        "Moment errors",
        markup.table(("coordinate", "largest measured", *columns), rows, caption=caption, total=True),
    )


def _trials(content: dict[str, Any], cycles: PredictedCycles) -> str:
    rows = [
        (name, own["use"], *(decimals(own["mae_Nm"][one]) for one in (*cycles.coordinates, "mean")))
        for name, own in content["trials"].items()
    ]
    header = ("cycle", "use", *cycles.coordinates, "mean")
    return markup.section(
        "Cycle by cycle", markup.table(header, rows, caption="Mean absolute errors in N m, cycle by cycle.")
    )


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
