"""``diagnose``: where a calibrated model's error is, which effect explains it, and how far it shrinks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrapjax.calibration.calibration import STARTS, Calibration, cached_calibration
from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.path_penalties import PATH_PENALTIES
from wrapjax.calibration.problem import fit_for_methods
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import IterationCallback
from wrapjax.diagnosis.claims.decision import DecisionConstants
from wrapjax.diagnosis.effects.catalogue import catalogue, refuse_unknown
from wrapjax.diagnosis.evidence.other_tasks import OtherTasks, other_tasks
from wrapjax.diagnosis.fits.baseline import starts_agree
from wrapjax.diagnosis.fits.muscle_law import fit_muscle_law
from wrapjax.diagnosis.inputs.input import DiagnosisInput
from wrapjax.diagnosis.inputs.subject_context import build_context
from wrapjax.diagnosis.localization import ErrorBudget
from wrapjax.diagnosis.pipeline import CatalogueIndependent, run_diagnosis
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.errors import InputError, Problem
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.io.store import Store
from wrapjax.model.variables import free_variables
from wrapjax.path_sources.exact import ExactGeometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.renamed import renamed_arguments
from wrapjax.subject.gait_alone import with_gait_alone
from wrapjax.subject.subject import Subject
from wrapjax.threads import call_together

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

#: Number of null replicates from which the detection threshold is computed.
NULL_REPLICATES = 60
#: Largest number of starts of the calibration where fewer do not agree.
MOST_STARTS = 16


@dataclass(frozen=True)
class Diagnosis:
    """Diagnosis of one leg: its calibration, the result, and what another catalogue can use again.

    Parameters
    ----------
    calibration, result
        Calibration that was diagnosed, and the result.
    data
        Input of the diagnosis.
    independent
        Part of the computation that does not depend on the catalogue; None with too few cycles.
    other_tasks
        Recorded tasks other than gait; None if there are none.
    """

    calibration: Calibration
    result: DiagnosisResult
    data: DiagnosisInput = field(repr=False)
    independent: CatalogueIndependent | None = field(repr=False)
    other_tasks: OtherTasks | None = field(default=None, repr=False)

    @property
    def subject(self) -> Subject:
        """Subject that was diagnosed."""
        return self.calibration.subject

    def to_dataset(self) -> Dataset:
        """Return measured and predicted moments, and evidence by effect, as an `xarray.Dataset`."""
        from wrapjax.report.labelled.diagnosis import diagnosis_dataset

        return diagnosis_dataset(self.result)

    def __str__(self) -> str:
        """Return what the command prints: outcome, most probable effects, errors and advice."""
        from wrapjax.report.diagnosis.words import diagnosis_text

        return diagnosis_text(self.result)

    def summary(self) -> dict[str, Any]:
        """Return the content of ``gap.json``."""
        from wrapjax.report.diagnosis.numbers import describe_diagnosis

        return describe_diagnosis(self.subject, self.result)

    def plot_error_map(self) -> Figure:
        """Draw the repeatable error (N m) by coordinate and phase of the gait cycle, a panel for each speed.

        Raises
        ------
        InputError
            If the recording has too few cycles to divide the error.
        """
        from wrapjax.report.diagnosis.location import map_figure

        return map_figure(self.result, self._budget())

    def plot_error_parts(self) -> Figure:
        """Draw how the squared error divides into bias, repeatable error, what follows the inputs, and noise.

        Raises
        ------
        InputError
            If the recording has too few cycles to divide the error.
        """
        from wrapjax.report.diagnosis.location import parts_figure

        return parts_figure(self.result, self._budget())

    def plot_signatures(self) -> Figure:
        """Draw the mean residual (N m) and the moments that the strongest effects would add."""
        from wrapjax.report.diagnosis.effects import signature_figure

        return signature_figure(self.result)

    def _budget(self) -> ErrorBudget:
        if self.result.budget is None:
            raise InputError(Problem(self.subject.name, self.result.reason or "the error was not divided"))
        return self.result.budget

    def without(
        self,
        *effects: str,
        constants: DecisionConstants | None = None,
        log: Callable[[str], None] = lambda line: None,
    ) -> Diagnosis:
        """Diagnose again with a catalogue without these effects; what does not depend on it is not repeated.

        Parameters
        ----------
        effects
            Identifiers of effects to leave out of the catalogue.
        constants, log
            See `diagnose`.

        Raises
        ------
        InputError
            If an identifier is not in the catalogue.
        """
        data = self.data.without(effects)
        result, independent = run_diagnosis(
            data,
            constants=constants or DecisionConstants.shipped(),
            null_replicates=NULL_REPLICATES,
            known=self.independent,
            other_tasks=self.other_tasks,
            log=log,
        )
        return Diagnosis(self.calibration, result, data, independent, self.other_tasks)

    def save(self, folder: str | Path, *, force: bool = False, note: str = "", motion: bool = False) -> None:
        """Write ``gap.json``, ``moments/`` and ``report.html``, which has the note at its top.

        Parameters
        ----------
        folder
            Folder to create.
        force
            Replace an existing folder.
        note
            Important sentence about the data for the report.
        motion
            Also write ``motion.html``, which shows the error on the model in motion; takes seconds.
        """
        from wrapjax.report.diagnosis.page import write_diagnosis

        write_diagnosis(self.subject, self.result, Path(folder), force=force, note=note, motion=motion)


@renamed_arguments(twins="null_replicates", tuning="constants", tell="log")
def diagnose(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    *,
    without: Sequence[str] = (),
    starts: int = STARTS,
    seed: int = 0,
    null_replicates: int = NULL_REPLICATES,
    constants: DecisionConstants | None = None,
    callback: IterationCallback | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> Diagnosis:
    """Calibrate one leg, and diagnose the remaining error of its model.

    Parameters
    ----------
    subject
        Subject from `load_subject`; the other leg is not used. The model is calibrated to gait. Trials
        of other tasks add evidence for effects (`wrapjax.diagnosis.evidence.other_tasks`).
    method, fit
        See `calibrate`; paths are held as the calibration leaves them.
    without
        Identifiers of effects to leave out of the catalogue.
    starts, seed, callback
        See `calibrate`. Where the two best starts do not agree, twice as many are made, up to `MOST_STARTS`.
        The calibration is cached, and not repeated.
    null_replicates
        Number of null replicates from which the detection threshold is computed.
    constants
        Constants of the decision; those that come with the package if not given.
    log
        Function called with a line at each step.

    Returns
    -------
    Diagnosis
        The best explanation among the effects that can be tested with this recording, not a proof of cause.

    Raises
    ------
    InputError
        If ``without`` contains an unknown effect.
    KeyboardInterrupt
        If it was interrupted; the next call continues there, and finished fits are read from the cache.
    """
    refuse_unknown(without)
    began = time.perf_counter()
    one_leg = replace(with_gait_alone(subject, "the calibration of a diagnosis"), other_leg=None)
    if fit is None and not subject.trials.is_gait.all():
        # The polynomials have to hold over the angles of all tasks.
        fit = fit_for_methods((method,), subject)
    while True:
        calibration = cached_calibration(one_leg, method, fit, starts=starts, seed=seed, callback=callback)
        if calibration.status is Status.interrupted:
            raise KeyboardInterrupt
        if not 1 < starts < MOST_STARTS or starts_agree(calibration.result.outcomes):
            break
        starts = min(2 * starts, MOST_STARTS)
        log(f"the two best starts differ: calibrating from {starts}")
    calibrated = time.perf_counter() - began
    return diagnose_calibrated(
        calibration,
        without=without,
        seed=seed,
        null_replicates=null_replicates,
        constants=constants,
        log=log,
        seconds={"calibration": calibrated},
        all_tasks=subject,
    )


def diagnose_calibrated(
    calibration: Calibration,
    *,
    without: Sequence[str] = (),
    seed: int = 0,
    null_replicates: int = NULL_REPLICATES,
    constants: DecisionConstants | None = None,
    log: Callable[[str], None] = lambda line: None,
    seconds: dict[str, float] | None = None,
    all_tasks: Subject | None = None,
) -> Diagnosis:
    """Diagnose the remaining error of a calibrated model of one leg; see `diagnose`.

    Parameters
    ----------
    calibration
        Calibration of one leg to gait.
    without, seed, null_replicates, constants, log
        See `diagnose`.
    seconds
        Time that earlier steps took, s.
    all_tasks
        The same leg with its tasks other than gait, whose muscle paths the calibration's fit covers; None to
        use gait alone.

    Raises
    ------
    InputError
        If the calibration had compliant tendons, or ``without`` contains an unknown effect.
    """
    if calibration.result.tendon != "rigid":
        message = "has compliant tendons, expected rigid ones: tendon compliance is one of the effects"
        where = f"the calibration of {calibration.subject.name}"
        raise InputError(Problem(where, message, hint='calibrate with tendon="rigid"'))
    began = time.perf_counter()
    data = diagnosis_input(calibration, without)
    tasks = None if all_tasks is None else other_tasks(calibration, data, all_tasks)
    result, independent = run_diagnosis(
        data,
        constants=constants or DecisionConstants.shipped(),
        null_replicates=null_replicates,
        seed=seed,
        other_tasks=tasks,
        log=log,
        seconds=dict(seconds or {}, context=time.perf_counter() - began),
    )
    return Diagnosis(calibration, result, data, independent, tasks)


def diagnosis_input(calibration: Calibration, without: Sequence[str] = ()) -> DiagnosisInput:
    """Collect the input of a diagnosis from a calibration; paths are held as the calibration left them.

    Parameters
    ----------
    calibration
        Calibration of one leg.
    without
        Ids of effects to leave out of the catalogue.
    """
    subject, result = calibration.subject, calibration.result
    trials, solution = subject.trials, result.solution
    calibrated = solution.problem
    assert isinstance(calibrated, Objective)
    problem = calibrated
    if problem.variables.modes:
        problem = _with_held_paths(problem, result)
    cache = Store.of_user("diagnoses")
    # OpenSim and the exact engine take one core, and compiled programs the other.
    (recording, context), law = call_together(
        lambda: build_context(calibration),
        lambda: fit_muscle_law(
            problem,
            result.parameters,
            result.freedom.with_held_paths(),
            result.muscles,
            cache,
            result.curves,
        ),
    )
    columns = [trials.coordinates.index(name) for name in trials.moment_coordinates]
    inside = trials.inside
    order = np.broadcast_to(context.order[:, None, None], (len(trials), 1, trials.time.shape[1]))
    inputs = (
        trials.angles[:, columns],
        trials.angular_velocities[:, columns],
        trials.emg[..., inside],
        order,
    )
    return DiagnosisInput(
        problem=law.held,
        law=law,
        calibrated=calibrated,
        solver_state=solution.state,
        variables=law.variables,
        outcomes=result.outcomes,
        recording=recording,
        context=context,
        entries=catalogue(context, without),
        withheld=tuple(without),
        recordings=trials.recordings,
        uses=trials.uses,
        time=trials.time,
        measured=trials.moments,
        inputs=np.concatenate(inputs, axis=1),
        cache=cache,
    )


def _with_held_paths(problem: Objective, result: CalibrationResult) -> Objective:
    """Fix the paths where the calibration ended, and remove the terms of the objective that concern them."""
    path = problem.recording.path.at(result.parameters.path_changes)
    held = fixed_path(PathState(path.length, path.velocity, path.moment_arm))
    return replace(
        problem,
        recording=replace(problem.recording, path=held),
        variables=free_variables(result.parameters, result.freedom.with_held_paths(), result.muscles),
        penalties=tuple(one for one in problem.penalties if one.name not in PATH_PENALTIES),
        limits=(),
    )
