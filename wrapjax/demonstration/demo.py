"""``demo``: calibrate a virtual subject whose truth is known by every method, and diagnose another.

The end of the demo: a virtual person with something amiss, and what a diagnosis says of it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.calibration.calibration import Calibration, calibrate
from wrapjax.calibration.problem import build_objective
from wrapjax.calibration.result import CalibrationResult
from wrapjax.calibration.solvers.multistart import IterationCallback
from wrapjax.calibration.uncertainty.intervals import laplace_deviation
from wrapjax.datasets.virtual_person.folder import Series
from wrapjax.datasets.virtual_person.hidden_effects import HIDDEN_EFFECTS
from wrapjax.datasets.virtual_person.subject import write_virtual_subject
from wrapjax.datasets.virtual_person.true_parameters import TrueParameters, parameter_names
from wrapjax.demonstration.wrap_recovery import WrapRecovery, wrap_recovery
from wrapjax.diagnosis.diagnosis import Diagnosis, diagnose
from wrapjax.io.files import write_json
from wrapjax.model.parameters import QUANTITIES
from wrapjax.path_sources.exact import exact_geometry
from wrapjax.path_sources.path_fitting import fit
from wrapjax.progress import print_progress
from wrapjax.subject.subject import load_subject

#: What readers of the page must not miss.
NOTE = (
    "This person walks by the package's own equations, and what was hidden in the recording has a form like "
    "the catalogue's: same-form data, a unit test and no accuracy."
)
#: Of the walking: more cycles than the demo's calibrations need, as what repeats has to be told from noise.
_SERIES = (Series(0.8, 4, 1), Series(1.2, 4, 1))
_DIAGNOSIS_STARTS, _NULL_REPLICATES = 2, 20
#: Not drawn by lot: of a size that people have it leads the list and is not named.
EXCLUDED_EFFECTS = ("emg_crosstalk",)


@dataclass(frozen=True)
class DiagnosisDemonstration:
    """What was hidden in a virtual person, and what a diagnosis says."""

    #: None for nothing.
    hidden: str | None
    diagnosis: Diagnosis

    @property
    def correct(self) -> bool:
        """Whether what was hidden is named, alone or in a tie; of nothing: whether nothing is."""
        result = self.diagnosis.result
        said = {*result.named, *(id for tie in result.ties for id in tie)}
        return self.hidden in said if self.hidden else not said

    @property
    def content(self) -> dict[str, Any]:
        """As ``demo.json`` has it."""
        result = self.diagnosis.result
        return {
            "hidden": self.hidden,
            "outcome": result.outcome,
            "named": result.named,
            "ties": result.ties,
            "right": self.correct,
            "note": NOTE,
        }


def draw_effect(seed: int) -> str:
    """Draw what is hidden, of `HIDDEN_EFFECTS` without `EXCLUDED_EFFECTS`."""
    names = sorted(set(HIDDEN_EFFECTS) - set(EXCLUDED_EFFECTS))
    return names[int(np.random.default_rng([seed, 5]).integers(len(names)))]


def demonstrate_diagnosis(
    folder: Path,
    hidden: str | None,
    *,
    seed: int = 0,
    force: bool = False,
    quiet: bool = True,
    callback: IterationCallback | None = None,
    log: Callable[[str], None] = lambda line: None,
) -> DiagnosisDemonstration:
    """Make up a person with something amiss, and diagnose them.

    Parameters
    ----------
    folder
        Gets ``hidden_effect/`` (the subject) and ``gap/``.
    hidden
        One of `HIDDEN_EFFECTS`; None for nothing.
    seed, force, quiet, callback
        As of `demo`.
    tell
        As of `diagnose`.
    """
    place = folder / "hidden_effect"
    write_virtual_subject(
        place, seed=seed, moment_noise=1.0, series=_SERIES, hidden_effect=hidden, force=force
    )
    subject = load_subject(place)
    found = diagnose(
        subject,
        "NGA",
        fit(subject, "engine", seed=seed, quiet=quiet),
        starts=_DIAGNOSIS_STARTS,
        seed=seed,
        null_replicates=_NULL_REPLICATES,
        callback=callback,
        log=log,
    )
    found.save(folder / "gap", force=force, note=NOTE)
    return DiagnosisDemonstration(hidden, found)


#: Of the virtual recordings, N m.
MOMENT_NOISE = 1.0
#: How far the person's cylinders may be from the model's, in 5 mm, 10 degrees and 10 % of the radius.
WRAP_SPREAD = 0.6
# Those that move paths take longer, and one start shows them.
_STARTS = {"NGA": 4, "SGA": 1, "LSGA": 1, "PGA": 1}


@dataclass(frozen=True)
class Recovery:
    """How far one kind of parameter is from the truth, over muscles."""

    parameter: str
    unit: str
    median_error_before: float
    median_error_after: float
    #: What the moments alone leave open, median over muscles: the standard deviation that their noise causes.
    median_deviation: float


@dataclass(frozen=True)
class Demonstration:
    """A virtual subject, calibrated by every method, beside its truth."""

    #: By method.
    calibrations: dict[str, Calibration]
    true_parameters: TrueParameters
    #: Of NGA's parameters.
    recovery: tuple[Recovery, ...]
    #: Of PGA's cylinders and moment arms.
    wraps: WrapRecovery
    #: Of a person with something amiss.
    gap: DiagnosisDemonstration

    @property
    def converged(self) -> bool:
        """Whether every method's calibration did."""
        return all(one.status.converged for one in self.calibrations.values())

    def save(self, folder: Path) -> None:
        """Write ``demo.json``, and figures of parameters and of moment arms against the truth."""
        from wrapjax.report.recovery import draw_recovery

        content = {
            "schema": 1,
            "note": "same-form data: a unit test, not an accuracy",
            "recovery": [vars(row) for row in self.recovery],
            "wrap_recovery": self.wraps.content(),
            "gap": self.gap.content,
            "methods": {name: _in_short(one.result) for name, one in self.calibrations.items()},
        }
        write_json(folder / "demo.json", content)
        result = self.calibrations["NGA"].result
        draw_recovery(result.initial, result.parameters, self.true_parameters, folder / "recovery.png")
        self.wraps.draw(folder / "wrap_recovery.png")


def demo(
    folder: str | Path,
    *,
    seed: int = 0,
    force: bool = False,
    quiet: bool = True,
    callback: IterationCallback | None = None,
    checkpoints: Path | None = None,
    resume: bool = False,
) -> Demonstration:
    """Make up a person, let them walk, calibrate by every method, and compare with the truth.

    The virtual leg walks by the package's own equations, so this shows what calibration finds of what it
    looks for; how well it does on people is another question. Its true cylinders are a little elsewhere
    than the model's. NGA cannot follow them, SGA and LSGA can with polynomials, and PGA, by the exact
    engine, with the cylinders themselves: as far as noisy moments say where they are. Another person has
    something amiss that no file tells of, drawn by the seed; a diagnosis says what.

    Parameters
    ----------
    folder
        Gets ``virtual_subject/``, ``fit/``, a folder a method, ``hidden_effect/``, ``gap/``, ``demo.json``,
        ``recovery.png`` and ``wrap_recovery.png``.
    seed
        Decides the person, the walking and the noise.
    force
        Replace what is there.
    quiet
        Print no progress.
    callback
        As in `calibrate`.
    journal, resume
        As in `calibrate`: the folder has one a method in it, and they go when all is done. What else is there
        is made again in place.
    """
    folder, force = Path(folder), force or resume
    print_progress("building a virtual person and letting it walk", quiet=quiet)
    true_parameters = write_virtual_subject(
        folder / "virtual_subject",
        seed=seed,
        moment_noise=MOMENT_NOISE,
        wrap_spread=WRAP_SPREAD,
        force=force,
    )
    subject = load_subject(folder / "virtual_subject")
    fitted = fit(subject, seed=seed, quiet=quiet)
    fitted.save(folder / "fit", subject=subject, force=force)
    calibrations = {}
    for method, starts in _STARTS.items():
        print_progress(f"calibrating by {method}", quiet=quiet)
        paths = exact_geometry(subject) if method == "PGA" else fitted
        book = None if checkpoints is None else checkpoints / method
        calibrations[method] = calibrate(
            subject,
            method,
            paths,
            starts=starts,
            seed=seed,
            callback=callback,
            checkpoints=book,
            resume=resume and book is not None and book.exists(),
        )
        # Saving closes a journal: not before the last one is done.
        replace(calibrations[method], checkpoints=None).save(folder / method, force=force)
    print_progress("hiding something in another virtual person, and diagnosing it", quiet=quiet)
    gap = demonstrate_diagnosis(
        folder,
        draw_effect(seed),
        seed=seed,
        force=force,
        quiet=quiet,
        callback=callback,
        log=lambda line: print_progress(line, quiet=quiet),
    )
    shown = Demonstration(
        calibrations,
        true_parameters,
        _recovery(calibrations["NGA"], true_parameters),
        wrap_recovery(calibrations["PGA"], true_parameters, MOMENT_NOISE),
        gap,
    )
    shown.save(folder)
    if checkpoints is not None:
        shutil.rmtree(checkpoints, ignore_errors=True)
    return shown


def _in_short(result: CalibrationResult) -> dict[str, float]:
    """Mean absolute moment errors in N m, and the change of moment arms in m."""
    error = np.abs(result.modelled - result.measured).mean(axis=(1, 2))
    uses = np.array(result.uses)
    arms = np.asarray(result.states.path.moment_arm) - np.asarray(result.initial_states.path.moment_arm)
    return {
        "mae_calibration_Nm": float(error[uses == "calibration"].mean()),
        "mae_validation_Nm": float(error[uses == "validation"].mean()),
        "largest_moment_arm_change_m": float(np.abs(arms).max()),
        "n_variables": len(result.labels),
    }


def _recovery(calibration: Calibration, true_parameters: TrueParameters) -> tuple[Recovery, ...]:
    result = calibration.result
    problem = build_objective(calibration.subject, "NGA", calibration.fit)
    deviation = laplace_deviation(problem, result.solution.variables, MOMENT_NOISE)
    rows = []
    for name in parameter_names():
        true = getattr(true_parameters, name)
        before, after = (np.asarray(getattr(tree, name)) for tree in (result.initial, result.parameters))
        rows.append(
            Recovery(
                parameter=name,
                unit=QUANTITIES[name].unit,
                median_error_before=float(np.median(np.abs(before - true))),
                median_error_after=float(np.median(np.abs(after - true))),
                median_deviation=float(np.median(deviation[:, problem.variables.names.index(name)])),
            )
        )
    return tuple(rows)
