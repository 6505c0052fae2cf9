"""``protocol``: the trials that would tell most about what a model of a person lacks."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from wrapjax.calibration.calibration import STARTS, cached_calibration
from wrapjax.calibration.problem import fit_for_methods
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import IterationCallback
from wrapjax.diagnosis.claims.decision import TIE_DISTANCE
from wrapjax.diagnosis.diagnosis import Diagnosis, diagnosis_input
from wrapjax.diagnosis.effects.catalogue import refuse_unknown
from wrapjax.diagnosis.evidence.linearization import Candidate
from wrapjax.diagnosis.evidence.other_tasks import other_tasks
from wrapjax.diagnosis.evidence.score_test import MIN_DETECTABILITY
from wrapjax.diagnosis.evidence.task_covariance import ErrorSizes, TaskCovariance
from wrapjax.diagnosis.protocol.detectability import Design, Detection, detection, information_gain
from wrapjax.diagnosis.protocol.inputs import ProtocolInput, input_of_calibration, input_of_model
from wrapjax.diagnosis.protocol.result import AdvisedTrial, ProtocolResult
from wrapjax.diagnosis.protocol.trials import CandidateTrial
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.errors import InputError, Problem
from wrapjax.path_sources.exact import ExactGeometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.subject.gait_alone import with_gait_alone
from wrapjax.subject.model_alone import subject_of_model
from wrapjax.subject.subject import Subject, load_subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset


#: Number of trials that are advised.
ADVISED = 3
# Effects whose probability is smaller than this are not undecided.
_LEAST_WEIGHT = 0.005


@dataclass(frozen=True)
class Protocol(ProtocolResult):
    """The trials that would tell most; its fields are those of `ProtocolResult`."""

    def summary(self) -> dict[str, Any]:
        """Return the content of ``protocol.json``."""
        from wrapjax.report.diagnosis.protocol_page import describe_protocol

        return describe_protocol(self)

    def to_dataset(self) -> Dataset:
        """Return detectability, distances of effects and information by trial as an `xarray.Dataset`."""
        from wrapjax.report.labelled.diagnosis import protocol_dataset

        return protocol_dataset(self)

    def plot_detectability(self) -> Figure:
        """Draw the detectability of every effect before and after the advised trials."""
        from wrapjax.report.diagnosis.protocol_page import detectability_figure

        return detectability_figure(self)

    def added_to(self, diagnosis: Diagnosis) -> Diagnosis:
        """Return a diagnosis whose advice also lists the trials that would tell most."""
        advice = (*diagnosis.result.advice, *(one.advice for one in self.advised))
        return replace(diagnosis, result=replace(diagnosis.result, advice=advice))

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``protocol.json`` and ``report.html``.

        Parameters
        ----------
        folder
            Folder to create.
        force
            Replace an existing folder.
        """
        from wrapjax.report.diagnosis.protocol_page import write_protocol

        write_protocol(self, Path(folder), force=force)


def protocol(
    subject: Subject | Diagnosis | str | Path,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    *,
    probabilities: Mapping[str, float] | None = None,
    side: str = "r",
    without: Sequence[str] = (),
    starts: int = STARTS,
    seed: int = 0,
    callback: IterationCallback | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> Protocol:
    """Find the trials that would tell most about what the model of a person lacks.

    Candidate trials are simulated by the forward model: passive rotations and isometric ramps of each joint,
    a squat, faster and slower gait. Every effect of the catalogue has a signature in each of them. Trials are
    compared by the information on which effects are present, with calibrated parameters, the muscle law and
    all nuisances marginalised; see `wrapjax.diagnosis.protocol.detectability`.

    Parameters
    ----------
    subject
        Subject from `load_subject`, which is calibrated to its gait (the calibration is cached), with all
        tasks that were recorded; a finished diagnosis, which is not repeated; or an OpenSim model (``.osim``)
        alone, with an electrode on every group of muscles.
    method, fit, starts, seed, callback
        See `calibrate`; not used with a finished diagnosis.
    probabilities
        Probability of each effect by a finished diagnosis: trials are then advised that tell apart what it
        left undecided. Effects that are not given have none. If None, those of the diagnosis that is given;
        without one all effects count alike.
    side
        Leg of a model alone, ``l`` or ``r``.
    without
        Identifiers of effects to leave out.
    log
        Function called with a line at each step.

    Returns
    -------
    Protocol
        The trials, with the detectability of every effect before and after them.

    Raises
    ------
    InputError
        If ``without`` contains an unknown effect, or the exact engine does not support the model.
    KeyboardInterrupt
        If the calibration was interrupted.
    """
    refuse_unknown(without)
    began = time.perf_counter()
    if isinstance(subject, Diagnosis):
        of_gait, others = subject.data.without((*subject.data.withheld, *without)), subject.other_tasks
        if probabilities is None:
            probabilities = undecided(subject.result)
        calibration = subject.calibration
    else:
        leg = subject if isinstance(subject, Subject) else subject_of_model(subject, side)
        if not len(leg.trials):
            log("computing the signature of every effect in every trial")
            data = input_of_model(leg, without)
            basis = "the model alone, without recordings, with an electrode on every group of muscles"
            return advise_trials(leg.name, basis, data, probabilities, began, log)
        one_leg = replace(with_gait_alone(leg, "the calibration before the advice"), other_leg=None)
        all_gait = bool(leg.trials.is_gait.all())
        if fit is None and not all_gait:
            # The polynomials have to hold over the angles of all tasks.
            fit = fit_for_methods((method,), leg)
        calibration = cached_calibration(one_leg, method, fit, starts=starts, seed=seed, callback=callback)
        if calibration.status is Status.interrupted:
            raise KeyboardInterrupt
        of_gait = diagnosis_input(calibration, without)
        others = None if all_gait else other_tasks(calibration, of_gait, leg)
    log("computing the signature of every effect in every trial")
    data = input_of_calibration(calibration, of_gait, others)
    return advise_trials(calibration.subject.name, _basis(data), data, probabilities, began, log)


def undecided(result: DiagnosisResult) -> dict[str, float] | None:
    """Return the probability of each effect by a diagnosis; None where it gives no effect any."""
    found = {
        one.id: one.probability
        for one in result.effects
        if one.id not in ("none", "unknown") and one.probability is not None
    }
    return found if max(found.values(), default=0.0) >= _LEAST_WEIGHT else None


def _basis(data: ProtocolInput) -> str:
    """Write what had been recorded."""
    cycles = int(np.sum(data.trial == -1))
    others = data.trial[data.trial < -1]
    trials = len(np.unique(others))
    basis = f"{cycles} recorded gait cycle{'s' if cycles > 1 else ''}"
    if not trials:
        return basis
    return f"{basis} and {len(others)} s of {trials} other trial{'s' if trials > 1 else ''}"


def subject_and_probabilities(place: Path, side: str = "r") -> tuple[Subject, dict[str, float] | None]:
    """Read a subject folder, a model alone, or a finished diagnosis with its subject.

    Parameters
    ----------
    place
        Subject folder, OpenSim model (``.osim``), or folder of ``wrapjax diagnose``.
    side
        Leg of a model alone.

    Returns
    -------
    subject, probabilities
        Subject, and the probability of each effect by the diagnosis; None without one.
    """
    if place.suffix.lower() == ".osim":
        return subject_of_model(place, side), None
    file = place / "gap.json"
    if not file.is_file():
        return load_subject(place), None
    probabilities = read_probabilities(place)
    folder = json.loads(file.read_text(encoding="utf-8")).get("subject_folder")
    if not isinstance(folder, str):
        raise InputError(
            Problem(str(file), "expected the folder of the subject, found none", "subject_folder")
        )
    return load_subject(place / folder), probabilities


def read_probabilities(folder: Path) -> dict[str, float]:
    """Read the probability of each effect from a folder of ``wrapjax diagnose``.

    Raises
    ------
    InputError
        If its ``gap.json`` is damaged or holds no probabilities.
    """
    file = folder / "gap.json"
    try:
        effects = json.loads(file.read_text(encoding="utf-8"))["effects"]
        found = {
            str(one["id"]): float(one["probability"])
            for one in effects
            if one["id"] not in ("none", "unknown") and one["probability"] is not None
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(Problem(str(file), f"is damaged ({error})")) from error
    if not any(found.values()):
        raise InputError(
            Problem(str(file), "expected probabilities of effects, found none: the diagnosis has no result")
        )
    return found


def advise_trials(
    name: str,
    basis: str,
    data: ProtocolInput,
    probabilities: Mapping[str, float] | None,
    began: float,
    log: Callable[[str], None] = lambda line: None,
) -> Protocol:
    """Choose trials one after the other, each the best after the earlier ones."""
    log("comparing trials")
    candidates = tuple(one for one in data.linearized.candidates if one.id not in data.negative_controls)
    design, row_trial = _design(data, candidates)
    weights, rivals = _weights(candidates, probabilities)

    def gain(information: Float[np.ndarray, "column column"]) -> float:
        detected = detection(information, candidates, pairs=probabilities is not None)
        return information_gain(detected, weights, rivals)

    design = design.recorded(np.flatnonzero(row_trial < 0)).of_rows(np.flatnonzero(row_trial >= 0))
    row_trial = row_trial[row_trial >= 0]
    start = gain(design.information)
    before = detection(design.information, candidates)
    left = list(range(len(data.trials)))
    advised: list[AdvisedTrial] = []
    considered: list[tuple[CandidateTrial, float]] = []
    reached, last = start, before
    for _ in range(min(ADVISED, len(left))):
        found = {
            number: gain(design.information_with(np.flatnonzero(row_trial == number))) for number in left
        }
        if not considered:
            ranked = sorted(found, key=lambda number: -found[number])
            considered = [(data.trials[number], found[number] - start) for number in ranked]
        best = max(found, key=lambda number: found[number])
        value = found[best]
        detected = detection(design.information_with(np.flatnonzero(row_trial == best)), candidates)
        advised.append(
            AdvisedTrial(
                data.trials[best],
                value - reached,
                _weighted_median(detected.expected_evidence, weights),
                detected,
                _split(candidates, last, detected, weights),
            )
        )
        design = design.recorded(np.flatnonzero(row_trial == best))
        left.remove(best)
        reached, last = value, detected
    return Protocol(
        name=name,
        basis=basis,
        effects=tuple(one.id for one in candidates),
        weights=weights,
        before=before,
        expected_before=_weighted_median(before.expected_evidence, weights),
        advised=tuple(advised),
        considered=tuple(considered),
        seconds=time.perf_counter() - began,
    )


def _weights(
    candidates: Sequence[Candidate], probabilities: Mapping[str, float] | None
) -> tuple[Float[np.ndarray, " effect"], Float[np.ndarray, "effect effect"]]:
    """Compute how undecided each effect is, and the probability of each of its rivals."""
    count = len(candidates)
    if probabilities is None:
        return np.full(count, 1.0 / count), np.eye(count)
    known = np.array([probabilities.get(one.id, 0.0) for one in candidates])
    known = np.where(known < _LEAST_WEIGHT, 0.0, known)
    if not known.any():
        raise InputError(Problem("probabilities", "expected one of an effect of the catalogue, found none"))
    rest = np.maximum(1.0 - known, 1e-9)
    rivals = known[None] / rest[:, None]
    np.fill_diagonal(rivals, np.maximum(1.0 - known.sum(), 0.0) / rest)
    return known / known.sum(), rivals


def _weighted_median(values: Float[np.ndarray, " effect"], weights: Float[np.ndarray, " effect"]) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(share, 0.5 * share[-1])])


def _split(
    candidates: Sequence[Candidate],
    before: Detection,
    after: Detection,
    weights: Float[np.ndarray, " effect"],
) -> tuple[tuple[str, str], ...]:
    """List pairs that cannot be distinguished before and can after, the most undecided first."""
    least = np.maximum(after.apart, after.apart.T)
    split = before.tied(TIE_DISTANCE, MIN_DETECTABILITY) & (least >= TIE_DISTANCE)
    split &= (weights > 0.0)[:, None] & (weights > 0.0)[None]
    first, second = np.nonzero(np.triu(split))
    order = np.argsort([-weights[one] * weights[other] for one, other in zip(first, second, strict=True)])
    return tuple((candidates[first[place]].id, candidates[second[place]].id) for place in order)


def _design(data: ProtocolInput, candidates: Sequence[Candidate]) -> tuple[Design, Int[np.ndarray, " row"]]:
    """Build the design over the rows that are measured, and the trial of each; -1 of recorded rows."""
    rows = np.flatnonzero(data.known)
    design = Design.of_effects(candidates, TaskCovariance.of(data, rows)(ErrorSizes()), rows)
    return design, np.repeat(data.trial, data.linearized.residual[0].size)[rows]
