"""Every task left out in turn: how well a model calibrated on the others predicts it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wrapjax.calibration.calibration import STARTS, Calibration, calibrate, write_calibrated_model
from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.metrics import LeftOutTask, errors_by_task
from wrapjax.osim.model import describe_model
from wrapjax.subject.trials import Trials


@dataclass(frozen=True)
class LeftOutTasks:
    """Calibration on all tasks, and its errors beside those of calibrations without each task.

    Parameters
    ----------
    calibration
        Calibration on all tasks.
    rows
        One row for each task and coordinate that was measured in it.
    """

    calibration: Calibration
    rows: tuple[LeftOutTask, ...]

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the folder of the run as `Calibration.save` does, with ``left_out_tasks.csv``."""
        from wrapjax.report.calibration.run_page import write_run

        write_run(
            [(leg.subject, leg.result) for leg in self.calibration.legs],
            Path(folder),
            force=force,
            describe_model=describe_model,
            write_calibrated_model=write_calibrated_model,
            left_out=self.rows,
        )
        if self.calibration.checkpoints is not None:
            self.calibration.checkpoints.close()


def leave_out_tasks(
    calibration: Calibration,
    *,
    starts: int = STARTS,
    seed: int = 0,
    log: Callable[[str], None] = lambda line: None,
) -> LeftOutTasks:
    """Calibrate without each task in turn and predict its trials, those for validation included.

    Parameters
    ----------
    calibration
        Calibration on all tasks; its freedom, curves, tendons, muscle law, solver and paths are used.
    starts, seed
        See `calibrate`.
    log
        Function called with a line before each calibration.

    Returns
    -------
    LeftOutTasks
        Errors in N m of both models in each task, the calibrations being otherwise alike.

    Raises
    ------
    InputError
        If there are not at least two tasks with trials for calibration, or two legs were calibrated together.
    """
    subject, result = calibration.subject, calibration.result
    trials = subject.trials
    if calibration.other_leg is not None:
        message = "expected one leg, found two that were calibrated together"
        raise InputError(Problem(str(subject.folder), message, "[subject] other_leg"))
    calibrated = trials.used_for("calibration")
    tasks = tuple(dict.fromkeys(calibrated.tasks))
    if len(tasks) < 2:
        message = (
            f"expected two or more tasks with trials for calibration, found {', '.join(tasks) or 'none'}"
        )
        raise InputError(Problem(str(subject.folder), message))
    with_all = {(row.task, row.coordinate): row for row in errors_by_task(trials, result.modelled)}
    rows = []
    for task in tasks:
        log(f"calibrating without {task}")
        uses = tuple(
            "validation" if own == task else use for own, use in zip(trials.tasks, trials.uses, strict=True)
        )
        found = calibrate(
            replace(subject, trials=replace(trials, uses=uses), other_leg=None),
            result.method,
            calibration.fit,
            result.freedom,
            solver=result.solver,
            starts=starts,
            seed=seed,
            curves=result.curves,
            tendon=result.tendon,
            muscle_law=result.muscle_law,
        )
        for row in errors_by_task(trials.of_task(task), found.result.modelled[_of_task(trials, task)]):
            rows.append(LeftOutTask(row, with_all[task, row.coordinate], found.status.converged))
    return LeftOutTasks(calibration, tuple(rows))


def _of_task(trials: Trials, task: str) -> np.ndarray:
    return np.array([entry == task for entry in trials.tasks])
