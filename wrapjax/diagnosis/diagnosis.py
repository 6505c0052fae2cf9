"""``diagnose``: where the remaining error is, which effect explains it best, and how far it shrinks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.calibration.calibration import STARTS, Calibration, cached_calibration
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.path_penalties import PATH_PENALTIES
from wrapjax.calibration.result import CalibrationResult
from wrapjax.calibration.solvers.checkpoints import SolveCache
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import IterationCallback
from wrapjax.diagnosis.case import DiagnosisInput, Look
from wrapjax.diagnosis.effects.catalogue import catalogue
from wrapjax.diagnosis.effects.catalogue import refuse_unknown as refuse_unknown
from wrapjax.diagnosis.pipeline import investigate
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.diagnosis.subject_context import diagnosis_context
from wrapjax.diagnosis.verdict import DecisionConstants
from wrapjax.errors import InputError, Problem
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.io.files import cache_folder
from wrapjax.model.variables import free_variables
from wrapjax.path_sources.exact import ExactGeometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from xarray import Dataset

#: No-effect twins that the alarm level is read off.
NULL_REPLICATES = 60


@dataclass(frozen=True)
class Diagnosis:
    """What remains to be explained of a subject's moments, and what explains it best.

    Parameters
    ----------
    calibration, result
        What was calibrated, and what is said of it.
    case, look
        What was looked at, and what the plain model leaves of it (None where that was not asked): all that
        another catalogue needs.
    """

    calibration: Calibration
    result: DiagnosisResult
    case: DiagnosisInput = field(repr=False)
    look: Look | None = field(repr=False)

    @property
    def subject(self) -> Subject:
        """Whose."""
        return self.calibration.subject

    @property
    def dataset(self) -> Dataset:
        """Moments measured and predicted, and evidence by effect, as an `xarray.Dataset` with units."""
        from wrapjax.report.labelled_arrays import diagnosis_dataset

        return diagnosis_dataset(self.result)

    def without(
        self,
        *effects: str,
        constants: DecisionConstants | None = None,
        log: Callable[[str], None] = lambda line: None,
    ) -> Diagnosis:
        """Say what would be said if nobody knew of these effects; what does not depend on them is kept.

        Parameters
        ----------
        effects
            Ids of effects to leave out of the catalogue.
        tuning, tell
            As of `diagnose`.

        Raises
        ------
        InputError
            If one of them is no effect.
        """
        case = replace(self.case, entries=catalogue(self.case.context, effects), withheld=effects)
        found, look = investigate(
            case,
            constants=constants or DecisionConstants.shipped(),
            null_replicates=NULL_REPLICATES,
            seen=self.look,
            log=log,
        )
        return Diagnosis(self.calibration, found, case, look)

    def save(self, folder: str | Path, *, force: bool = False, note: str = "") -> None:
        """Write ``gap.json``, ``moments/`` and ``report.html``, which has the note at its top."""
        from wrapjax.report.diagnosis_page import write_diagnosis

        write_diagnosis(self.subject, self.result, Path(folder), force=force, note=note)


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
    """Calibrate one leg and say what its model still lacks.

    Parameters
    ----------
    subject
        From `load_subject`. Its other leg is left alone.
    method, fit
        As of `calibrate`; paths are held as calibration leaves them.
    without
        Ids of effects to leave out of the catalogue: what would be said if nobody knew of them?
    starts, seed, callback
        As of `calibrate`. The calibration is kept in the cache, and not done twice.
    twins
        How many people with nothing amiss the alarm level is read off.
    tuning
        Constants of the verdict; those that are shipped if not given.
    tell
        Called with a line at each step.

    Returns
    -------
    Diagnosis
        Best explained by, among the effects that can be tested with this recording: never a proof of cause.

    Raises
    ------
    InputError
        If ``without`` names no effect.
    KeyboardInterrupt
        If it was interrupted; the next time it goes on where it stopped, and the fits that it had done are
        recalled.
    """
    refuse_unknown(without)
    began = time.perf_counter()
    alone = replace(subject, other_leg=None)
    calibration = cached_calibration(alone, method, fit, starts=starts, seed=seed, callback=callback)
    if calibration.status is Status.interrupted:
        raise KeyboardInterrupt
    calibrated = time.perf_counter() - began
    return diagnose_calibrated(
        calibration,
        without=without,
        seed=seed,
        null_replicates=null_replicates,
        constants=constants,
        log=log,
        seconds={"calibration": calibrated},
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
) -> Diagnosis:
    """Say what a calibrated model of one leg still lacks; see `diagnose`.

    Raises
    ------
    InputError
        If the calibration had compliant tendons, or ``without`` names no effect.
    """
    if calibration.result.tendon != "rigid":
        message = (
            "has tendons that stretch, where rigid ones were expected: stretch is one of a diagnosis' effects"
        )
        where = f"the calibration of {calibration.subject.name}"
        raise InputError(Problem(where, message, hint='calibrate with tendon="rigid"'))
    began = time.perf_counter()
    case = diagnosis_input(calibration, without)
    known = dict(seconds or {}, context=time.perf_counter() - began)
    found, look = investigate(
        case,
        constants=constants or DecisionConstants.shipped(),
        null_replicates=null_replicates,
        seed=seed,
        log=log,
        seconds=known,
    )
    return Diagnosis(calibration, found, case, look)


def diagnosis_input(calibration: Calibration, without: Sequence[str] = ()) -> DiagnosisInput:
    """Gather what is looked at; paths are held as calibration left them."""
    recording, context = diagnosis_context(calibration)
    subject, result = calibration.subject, calibration.result
    trials, solution = subject.trials, result.solution
    problem, variables = solution.problem, np.asarray(solution.variables)
    assert isinstance(problem, Objective)
    if problem.variables.modes:
        problem = _held(problem, result)
        variables = np.asarray(problem.start(result.parameters))
    columns = [trials.coordinates.index(name) for name in trials.moment_coordinates]
    inside = slice(trials.padding, trials.emg.shape[-1] - trials.padding)
    order = np.broadcast_to(context.order[:, None, None], (len(trials), 1, trials.time.shape[1]))
    inputs = (
        trials.angles[:, columns],
        trials.angular_velocities[:, columns],
        trials.emg[..., inside],
        order,
    )
    return DiagnosisInput(
        problem=problem,
        variables=variables,
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
        kept=SolveCache(cache_folder("diagnoses")),
    )


def _held(problem: Objective, result: CalibrationResult) -> Objective:
    """Hold paths, and drop what a calibration asks of them."""
    path = problem.recording.path.at(result.parameters.path_changes)
    held = fixed_path(PathState(path.length, path.velocity, path.moment_arm))
    return replace(
        problem,
        recording=replace(problem.recording, path=held),
        variables=free_variables(result.parameters, result.freedom.with_held_paths(), result.muscles),
        penalties=tuple(one for one in problem.penalties if one.name not in PATH_PENALTIES),
        limits=(),
    )
