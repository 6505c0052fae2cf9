"""Demonstration: calibration of a virtual subject by every method, and diagnosis of a simulated effect.

The true parameters of the virtual subject are known, and its recordings come from the package's own
equations.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.calibration.calibration import Calibration, calibrate
from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.problem import build_objective
from wrapjax.calibration.solvers.multistart import IterationCallback
from wrapjax.calibration.uncertainty.identifiability import laplace_deviation
from wrapjax.datasets.virtual_person.hidden_effects import HIDDEN_EFFECTS
from wrapjax.datasets.virtual_person.true_parameters import TrueParameters, parameter_names
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_subject
from wrapjax.demonstration.wrap_recovery import WrapRecovery, wrap_recovery
from wrapjax.diagnosis.diagnosis import Diagnosis, diagnose
from wrapjax.io.files import write_json
from wrapjax.model.parameters import QUANTITIES
from wrapjax.path_sources.exact import exact_geometry
from wrapjax.path_sources.path_fitting import fit
from wrapjax.progress import print_progress
from wrapjax.subject.subject import load_subject

#: Note on the page of the demonstration's diagnosis.
NOTE = (
    "The recordings of this virtual person come from the package's own equations, and the simulated effect "
    "has a form like the catalogue's: same-form data, a unit test and no accuracy."
)
#: Walking of the diagnosed person: a diagnosis needs more cycles than a calibration, to separate repeatable
#: error from noise.
_SERIES = (Series(0.8, 4, 1), Series(1.2, 4, 1))
_DIAGNOSIS_STARTS, _NULL_REPLICATES = 2, 20
#: Effects that `draw_effect` excludes: at a realistic size this one has the most evidence but is not named.
EXCLUDED_EFFECTS = ("emg_crosstalk",)


@dataclass(frozen=True)
class DiagnosisDemonstration:
    """Diagnosis of a virtual person with a known simulated effect.

    Parameters
    ----------
    hidden
        Identifier of the simulated effect; None for none.
    diagnosis
        Diagnosis of the person.
    """

    hidden: str | None
    diagnosis: Diagnosis

    @property
    def correct(self) -> bool:
        """Whether the simulated effect is named, alone or in a tie; without one, whether none is named."""
        result = self.diagnosis.result
        named = {*result.named, *(id for tie in result.ties for id in tie)}
        return self.hidden in named if self.hidden else not named

    @property
    def content(self) -> dict[str, Any]:
        """Entry of ``demo.json``."""
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
    """Draw a random effect from `HIDDEN_EFFECTS` without `EXCLUDED_EFFECTS`."""
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
    """Simulate a virtual person with an effect, and diagnose it.

    Parameters
    ----------
    folder
        Folder in which ``hidden_effect/`` (the subject) and ``gap/`` (the diagnosis) are written.
    hidden
        Identifier of the effect, one of `HIDDEN_EFFECTS`; None for none.
    seed
        Seed of the person, the walking and the noise.
    force
        Replace existing folders.
    quiet
        Print no progress of the fit.
    callback
        As in `calibrate`.
    log
        As in `diagnose`.

    Returns
    -------
    DiagnosisDemonstration
        The diagnosis beside the simulated effect.
    """
    place = folder / "hidden_effect"
    write_virtual_subject(
        place, seed=seed, moment_noise=1.0, series=_SERIES, hidden_effect=hidden, force=force
    )
    subject = load_subject(place)
    diagnosis = diagnose(
        subject,
        "NGA",
        fit(subject, "engine", seed=seed, quiet=quiet),
        starts=_DIAGNOSIS_STARTS,
        seed=seed,
        null_replicates=_NULL_REPLICATES,
        callback=callback,
        log=log,
    )
    diagnosis.save(folder / "gap", force=force, note=NOTE, motion=True)
    return DiagnosisDemonstration(hidden, diagnosis)


#: Standard deviation of the noise of the virtual moments, N m.
MOMENT_NOISE = 1.0
#: Largest displacement of the virtual subject's cylinders, as a multiple of 5 mm, 10 degrees and 10 % of the
#: radius.
WRAP_SPREAD = 0.6
# Number of starting points. Methods that change paths take longer, and one start suffices to show them.
_STARTS = {"NGA": 4, "SGA": 1, "LSGA": 1, "PGA": 1}


@dataclass(frozen=True)
class Recovery:
    """Errors of one kind of parameter before and after calibration.

    Parameters
    ----------
    parameter, unit
        Name and unit of the parameter.
    median_error_before, median_error_after
        Median absolute error over muscles.
    median_deviation
        Median over muscles of the standard deviation that the noise of the moments causes, without priors.
    """

    parameter: str
    unit: str
    median_error_before: float
    median_error_after: float
    median_deviation: float


@dataclass(frozen=True)
class Demonstration:
    """Calibrations of a virtual subject by every method beside its true parameters, and a diagnosis.

    Parameters
    ----------
    calibrations
        Calibrations by method.
    true_parameters
        True parameters of the virtual subject.
    recovery
        Errors of the parameters that NGA calibrates.
    wraps
        Errors of moment arms and wrapping cylinders by PGA.
    effect_diagnosis
        Diagnosis of another virtual person with a simulated effect.
    """

    calibrations: dict[str, Calibration]
    true_parameters: TrueParameters
    recovery: tuple[Recovery, ...]
    wraps: WrapRecovery
    effect_diagnosis: DiagnosisDemonstration

    @property
    def converged(self) -> bool:
        """Whether the calibrations by all methods converged."""
        return all(calibration.status.converged for calibration in self.calibrations.values())

    def save(self, folder: Path) -> None:
        """Write ``demo.json``, and figures of estimated against true parameters and moment arms."""
        from wrapjax.report.calibration.recovery import draw_recovery

        content = {
            "schema": 1,
            "note": "same-form data: a unit test, not an accuracy",
            "recovery": [vars(row) for row in self.recovery],
            "wrap_recovery": self.wraps.content(),
            "gap": self.effect_diagnosis.content,
            "methods": {name: _method_summary(entry.result) for name, entry in self.calibrations.items()},
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
    """Calibrate a virtual subject by every method and compare it with its true parameters; diagnose another.

    The recordings come from the package's own equations, so this tests the software and not its accuracy on
    people. The subject's cylinders are displaced from those of its model. NGA cannot account for that; SGA
    and LSGA can by their polynomials, and PGA, with the exact engine, by moving the cylinders, as far as
    noisy moments determine them. Another virtual person has an effect that the seed selects and that is noted
    in no input file, and is diagnosed.

    Parameters
    ----------
    folder
        Output folder: ``virtual_subject/``, ``fit/``, one folder for each method, ``hidden_effect/``,
        ``gap/``, ``demo.json``, ``recovery.png`` and ``wrap_recovery.png``.
    seed
        Seed of the person, the walking, the noise and the effect.
    force
        Replace existing results.
    quiet
        Print no progress.
    callback
        As in `calibrate`.
    checkpoints
        Folder of the checkpoints, with one folder for each method; removed at the end. None for no
        checkpoints.
    resume
        Continue from the checkpoints. Everything else is computed again in place.

    Returns
    -------
    Demonstration
        Calibrations, true parameters, errors and the diagnosis.

    Raises
    ------
    InputError
        If the output exists already and ``force`` and ``resume`` are not set.
    """
    folder, force = Path(folder), force or resume
    print_progress("simulating the recordings of a virtual person", quiet=quiet)
    true_parameters = write_virtual_subject(
        folder / "virtual_subject",
        seed=seed,
        moment_noise=MOMENT_NOISE,
        wrap_spread=WRAP_SPREAD,
        force=force,
    )
    subject = load_subject(folder / "virtual_subject")
    fitted = fit(subject, seed=seed, quiet=quiet)
    fitted.save(folder / "fit", subject=subject, force=force, motion=True)
    calibrations = {}
    for method, starts in _STARTS.items():
        print_progress(f"calibrating by {method}", quiet=quiet)
        paths = exact_geometry(subject) if method == "PGA" else fitted
        method_checkpoints = None if checkpoints is None else checkpoints / method
        calibrations[method] = calibrate(
            subject,
            method,
            paths,
            starts=starts,
            seed=seed,
            callback=callback,
            checkpoints=method_checkpoints,
            resume=resume and method_checkpoints is not None and method_checkpoints.exists(),
        )
        # Saving would delete the checkpoints, which are needed until the whole demonstration is done.
        replace(calibrations[method], checkpoints=None).save(folder / method, force=force, motion=True)
    print_progress("simulating an effect in another virtual person, and diagnosing it", quiet=quiet)
    effect_diagnosis = demonstrate_diagnosis(
        folder,
        draw_effect(seed),
        seed=seed,
        force=force,
        quiet=quiet,
        callback=callback,
        log=lambda line: print_progress(line, quiet=quiet),
    )
    demonstration = Demonstration(
        calibrations,
        true_parameters,
        _recovery(calibrations["NGA"], true_parameters),
        wrap_recovery(calibrations["PGA"], true_parameters, MOMENT_NOISE),
        effect_diagnosis,
    )
    demonstration.save(folder)
    if checkpoints is not None:
        shutil.rmtree(checkpoints, ignore_errors=True)
    return demonstration


def _method_summary(result: CalibrationResult) -> dict[str, float]:
    """Summarise moment errors (N m), change of moment arms (m) and number of variables of a method."""
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
    """Compute the errors of the muscle parameters that NGA calibrates."""
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
