"""``diagnose_against``: what differs between two conditions of one person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from wrapjax.calibration.calibration import STARTS, cached_calibration
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import IterationCallback
from wrapjax.diagnosis.conditions.condition_contrast import (
    Contrast,
    DifferenceResult,
    compute_contrast,
    contrast_rows,
)
from wrapjax.diagnosis.diagnosis import diagnosis_input
from wrapjax.diagnosis.effects.catalogue import CATALOGUE, refuse_unknown
from wrapjax.diagnosis.effects.effect import NotTestable
from wrapjax.diagnosis.evidence.linearization import linearized_model
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames
from wrapjax.errors import InputError, Problem
from wrapjax.path_sources.exact import ExactGeometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.subject.gait_alone import with_gait_alone
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset


#: Fewest calibration cycles of each condition at a common speed.
FEWEST_CYCLES = 3
#: Reason why an effect with `shared_by_conditions` explains no difference.
SHARED = "it is the same in both conditions of one person"


@dataclass(frozen=True)
class ConditionDifference(DifferenceResult):
    """What differs between two conditions of one person; its fields are those of `DifferenceResult`."""

    def summary(self) -> dict[str, Any]:
        """Return the content of ``difference.json``."""
        from wrapjax.report.diagnosis.difference_page import describe_difference

        return describe_difference(self)

    def to_dataset(self) -> Dataset:
        """Return the difference of the conditions, and evidence by effect, as an `xarray.Dataset`."""
        from wrapjax.report.labelled.diagnosis import difference_dataset

        return difference_dataset(self)

    def plot_difference(self) -> Figure:
        """Draw the difference of the residuals (N m) and what the strongest effect explains of it."""
        from wrapjax.report.diagnosis.difference_page import difference_figure

        return difference_figure(self)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``difference.json`` and ``report.html``."""
        from wrapjax.report.diagnosis.difference_page import write_difference

        write_difference(self, Path(folder), force=force)


def diagnose_against(
    subject: Subject,
    conditions: tuple[str, str],
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    *,
    without: Sequence[str] = (),
    starts: int = STARTS,
    seed: int = 0,
    callback: IterationCallback | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> ConditionDifference:
    """Find what differs between two conditions of one person.

    The model is calibrated to both conditions together, as everything of the person is the same in both. At
    each common speed the mean residuals of the two conditions are subtracted, so that errors of the model
    that are the same in both cancel, and every effect of the catalogue is tested in one condition alone; see
    `wrapjax.diagnosis.conditions.condition_contrast`. Effects of the body's muscle paths and of calibrated
    parameters are left out, as they are the same in both.

    Parameters
    ----------
    subject
        Subject with the trials of both conditions, from `load_conditions`. Gait cycles marked ``calibration``
        are used.
    conditions
        Names of the conditions.
    method, fit, starts, callback
        See `calibrate`; the calibration is cached.
    without
        Identifiers of effects to leave out of the catalogue.
    seed
        Seed of the calibration and of the reassignments of cycles.
    log
        Function called with a line at each step.

    Returns
    -------
    ConditionDifference
        Difference of the conditions in N m, and the evidence for each effect of one of them, nats.

    Raises
    ------
    InputError
        If ``without`` contains an unknown effect, or the conditions have too few cycles at a common speed.
    KeyboardInterrupt
        If the calibration was interrupted.
    """
    refuse_unknown(without)
    gait = with_gait_alone(subject, "a diagnosis")
    log("calibrating both conditions together")
    calibration = cached_calibration(gait, method, fit, starts=starts, seed=seed, callback=callback)
    if calibration.status is Status.interrupted:
        raise KeyboardInterrupt
    data = diagnosis_input(calibration, without)
    chosen = data.plan.calibration
    is_first = np.array([gait.trials.conditions[cycle] == conditions[0] for cycle in chosen])
    speeds = data.speeds[chosen]
    _require_cycles(gait, conditions, speeds, is_first)
    log("computing the signature of every effect")
    linearized = linearized_model(
        data.law.free,
        jnp.asarray(data.law.with_free_law(data.variables)),
        data.calibration_recording,
        data.measured[chosen],
        data.calibration_context,
        tuple(data.calibration_effects.values()),
        groups=_groups(speeds, is_first),
    )
    own = tuple(one for one in linearized.candidates if not CATALOGUE[one.id].shared_by_conditions)
    linearized = replace(linearized, candidates=own)
    log("comparing the conditions")
    contrast = compute_contrast(linearized, speeds, is_first, data.measured_moment_sd, seed)
    return _difference(gait, conditions, data, contrast, speeds, is_first)


def _groups(
    speeds: Int[np.ndarray, " cycle"], is_first: Bool[np.ndarray, " cycle"]
) -> Int[np.ndarray, " cycle"]:
    """Assign a number to each group of cycles that repeat each other: one condition at one speed."""
    return np.unique(2 * speeds + is_first, return_inverse=True)[1]


def _require_cycles(
    subject: Subject,
    conditions: tuple[str, str],
    speeds: Int[np.ndarray, " cycle"],
    is_first: Bool[np.ndarray, " cycle"],
) -> None:
    """Raise an error if no speed has enough calibration cycles of both conditions."""
    for speed in np.unique(speeds):
        own = speeds == speed
        if min((own & is_first).sum(), (own & ~is_first).sum()) >= FEWEST_CYCLES:
            return
    counts = f"{int(is_first.sum())} of '{conditions[0]}' and {int((~is_first).sum())} of '{conditions[1]}'"
    message = (
        f"expected {FEWEST_CYCLES} or more calibration cycles of both conditions at a common speed, found "
        f"{counts}"
    )
    raise InputError(Problem(str(subject.folder), message, "[[trial]] condition, speed_m_s"))


def _difference(
    subject: Subject,
    conditions: tuple[str, str],
    data: DiagnosisInput,
    contrast: Contrast,
    speeds: Int[np.ndarray, " cycle"],
    is_first: Bool[np.ndarray, " cycle"],
) -> ConditionDifference:
    rows = contrast_rows(speeds, is_first)
    chosen = data.plan.calibration
    measured = data.measured[chosen][..., phase_frames(data.measured.shape[-1])]
    known = data.context.speeds[chosen]
    used = rows != 0.0
    return ConditionDifference(
        subject=subject,
        conditions=conditions,
        cycles=(int((used.any(axis=0) & is_first).sum()), int((used.any(axis=0) & ~is_first).sum())),
        coordinates=data.context.coordinates,
        speeds=np.array([known[row][0] for row in used]),
        measured_difference=np.einsum("sc,ckp->skp", rows, measured),
        contrast=contrast,
        effects=dict(data.calibration_effects),
        not_testable=tuple(
            entry if isinstance(entry, NotTestable) else NotTestable(entry.id, SHARED)
            for entry in data.entries
            if isinstance(entry, NotTestable) or CATALOGUE[entry.id].shared_by_conditions
        ),
    )
