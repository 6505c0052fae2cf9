"""Evaluation of a calibration on other cycles: the content of ``evaluation.json``, the page and the folder.

Everything that the page shows is in the other files of the folder, so that it can be redrawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.metrics import pooled_mae, pooled_rmse
from wrapjax.io.files import write_json, write_text
from wrapjax.io.json_and_arrays import load_json
from wrapjax.io.storage import read_storage, write_storage
from wrapjax.report import markup
from wrapjax.report.calibration.run_summary import USES, by_trial, by_use, describe_tasks, errors_of
from wrapjax.report.calibration.run_tables import moment_labels, moment_table
from wrapjax.report.calibration.task_curves import moment_sections
from wrapjax.report.cycle_panels import TrialCurves
from wrapjax.report.formatting import counted, decimals
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import FRAMES, GAIT, Trials

#: Version of the layout of ``evaluation.json``.
SCHEMA = 1


def predicted_cycles(trials: Trials, modelled: Float[np.ndarray, "trial coordinate frame"]) -> TrialCurves:
    """Combine a subject's cycles with their predicted moments (N m)."""
    return TrialCurves(
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        uses=trials.uses,
        tasks=trials.tasks,
        recordings=trials.recordings,
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
    """Describe an evaluation as plain numbers and strings.

    Returns
    -------
    dict
        Content of ``evaluation.json``: ``mae_Nm``, ``rmse_Nm`` and ``trials`` as in ``summary.json`` (N m,
        all frames of the cycles), the errors of the run on its own cycles, speeds, and notes.
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
        "trials": {
            name: trial | {"speed_m_s": speeds[name]} for name, trial in by_trial(errors, cycles).items()
        },
        **describe_tasks(subject.trials, modelled),
        "notes": list(notes),
    }


def render_evaluation(content: dict[str, Any], cycles: TrialCurves) -> str:
    """Write the report of an evaluation as a self-contained HTML page.

    Parameters
    ----------
    content
        Content of ``evaluation.json``, from `describe_evaluation`.
    cycles
        Measured and predicted moments of the same cycles.
    """
    run = content["run"]
    title = f"{content['subject']}: predicted by the {run['method']} calibration of {run['subject']}"
    counts = [f"{counted(cycles.uses.count(use), f'{use} cycle')}" for use in USES if use in cycles.uses]
    under = (
        f"{counted(len(cycles.coordinates), 'coordinate')}, {' and '.join(counts)}; no parameter was fitted."
    )
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict_section(content),
            _errors_section(content, cycles),
            *moment_sections(cycles, content),
            _cycles_section(content, cycles),
            markup.section("Notes", markup.bullets([*content["notes"], _FILES])),
        ],
    )


_FILES = (
    "Errors are in evaluation.json, curves of every cycle in moments/. 'Calibration' and 'validation' are "
    "the uses of the cycles in the settings of the evaluated subject; the run may have used neither."
)


def _verdict_section(content: dict[str, Any]) -> str:
    lines = []
    for use in USES:
        errors, run_errors = content["mae_Nm"][use], content["run"]["mae_Nm"][use]
        if errors is not None:
            comparison = (
                ""
                if run_errors is None
                else f" (in the run, on its own {use} cycles: {decimals(run_errors['mean'])} N m)"
            )
            lines.append(
                f"On {use} cycles predicted and measured joint moments differ by {decimals(errors['mean'])} "
                f"N m on average{comparison}."
            )
    return markup.box(*map(markup.paragraph, lines), kind="verdict")


def _errors_section(content: dict[str, Any], cycles: TrialCurves) -> str:
    columns: dict[str, dict[str, float]] = {}
    for use in USES:
        if content["mae_Nm"][use] is not None:
            columns |= {f"{use}: MAE": content["mae_Nm"][use], f"{use}: RMSE": content["rmse_Nm"][use]}
        if content["run"]["mae_Nm"][use] is not None:
            columns[f"run's {use}: MAE"] = content["run"]["mae_Nm"][use]
    peak = np.nanmax(np.abs(cycles.measured), axis=(0, 2))
    largest = dict(zip(cycles.coordinates, peak.tolist(), strict=True))
    rows = [
        (name, decimals(largest.get(name)), *(decimals(column.get(name)) for column in columns.values()))
        for name in (*cycles.coordinates, "mean")
    ]
    caption = (
        "Errors of joint moments in N m over all frames of the cycles: mean absolute (MAE) and root mean "
        "square (RMSE). 'Run's' are the errors of the calibration on its own cycles."
    )
    return markup.section(
        "Moment errors",
        markup.table(("coordinate", "largest measured", *columns), rows, caption=caption, total=True),
    )


def _cycles_section(content: dict[str, Any], cycles: TrialCurves) -> str:
    columns = (*cycles.coordinates, "mean")
    rows = [
        (name, trial["use"], *(decimals(trial["mae_Nm"].get(column)) for column in columns))
        for name, trial in content["trials"].items()
    ]
    header = ("cycle", "use", *columns)
    return markup.section(
        "Errors by cycle", markup.table(header, rows, caption="Mean absolute errors of each cycle in N m.")
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
    for number, trial in enumerate(content["trials"].values()):
        write_storage(folder / "moments" / f"{trial['file']}.sto", moment_table(cycles, cycles.time, number))
    write_text(folder / "report.html", render_evaluation(content, cycles))


def redraw_evaluation(folder: Path) -> None:
    """Write ``report.html`` again from the other files of the folder.

    Raises
    ------
    InputError
        If a file is missing or damaged.
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
            Problem(str(file), f"is damaged ({error})", hint="write it again with 'wrapjax evaluate'")
        ) from error
    write_text(folder / "report.html", page)


def _read_cycles(content: dict[str, Any], folder: Path) -> TrialCurves:
    coordinates = tuple(content["coordinates"])
    labels = moment_labels(coordinates)
    time, moments = [], []
    for trial in content["trials"].values():
        table = read_storage(folder / f"{trial['file']}.sto")
        is_gait = "task" not in trial
        curves = [
            table.values[:, table.columns.index(label)]
            if is_gait or label in table.columns
            else np.full(table.time.size, np.nan)
            for label in labels
        ]
        # Windows have the frames in which moments were measured.
        unused = (0, 0 if is_gait else FRAMES - table.time.size)
        time.append(np.pad(table.time, unused, constant_values=np.nan))
        moments.append(np.pad(np.array(curves), ((0, 0), unused), constant_values=np.nan))
    both = np.stack(moments)
    return TrialCurves(
        coordinates=coordinates,
        trials=tuple(content["trials"]),
        uses=tuple(trial["use"] for trial in content["trials"].values()),
        tasks=tuple(trial.get("task", GAIT) for trial in content["trials"].values()),
        recordings=tuple(trial.get("recording", name) for name, trial in content["trials"].items()),
        speeds=np.array(
            [
                math.nan if trial["speed_m_s"] is None else trial["speed_m_s"]
                for trial in content["trials"].values()
            ]
        ),
        time=np.stack(time),
        measured=both[:, len(coordinates) :],
        modelled=both[:, : len(coordinates)],
    )
