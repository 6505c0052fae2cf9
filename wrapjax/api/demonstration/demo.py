"""``demo``: calibrate a virtual subject whose truth is known by every method, and diagnose another."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wrapjax.api.calibrating.calibration import Calibration, calibrate
from wrapjax.api.calibrating.problem import prepare
from wrapjax.api.demonstration.gap_demo import GapDemonstration, demonstrate_gap, drawn_effect
from wrapjax.api.demonstration.wrap_recovery import WrapRecovery, wrap_recovery
from wrapjax.api.paths.exact import exact_geometry
from wrapjax.api.paths.fitting import fit
from wrapjax.calibrate import CalibrationResult, Watch, laplace_deviation
from wrapjax.files import write_json
from wrapjax.model import QUANTITIES
from wrapjax.progress import say
from wrapjax.subject import read_subject
from wrapjax.virtual import VirtualTruth, write_virtual_subject
from wrapjax.virtual.truth import parameter_names

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
    truth: VirtualTruth
    #: Of NGA's parameters.
    recovery: tuple[Recovery, ...]
    #: Of PGA's cylinders and moment arms.
    wraps: WrapRecovery
    #: Of a person with something amiss.
    gap: GapDemonstration

    @property
    def converged(self) -> bool:
        """Whether every method's calibration did."""
        return all(one.status.converged for one in self.calibrations.values())

    def save(self, folder: Path) -> None:
        """Write ``demo.json``, and figures of parameters and of moment arms against the truth."""
        from wrapjax.report.recovery_figure import draw_recovery

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
        draw_recovery(result.initial, result.parameters, self.truth, folder / "recovery.png")
        self.wraps.draw(folder / "wrap_recovery.png")


def demo(
    folder: str | Path,
    *,
    seed: int = 0,
    force: bool = False,
    quiet: bool = True,
    callback: Watch | None = None,
    journal: Path | None = None,
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
    say("building a virtual person and letting it walk", quiet=quiet)
    truth = write_virtual_subject(
        folder / "virtual_subject",
        seed=seed,
        moment_noise=MOMENT_NOISE,
        wrap_spread=WRAP_SPREAD,
        force=force,
    )
    subject = read_subject(folder / "virtual_subject")
    fitted = fit(subject, seed=seed, quiet=quiet)
    fitted.save(folder / "fit", subject=subject, force=force)
    calibrations = {}
    for method, starts in _STARTS.items():
        say(f"calibrating by {method}", quiet=quiet)
        paths = exact_geometry(subject) if method == "PGA" else fitted
        book = None if journal is None else journal / method
        calibrations[method] = calibrate(
            subject,
            method,
            paths,
            starts=starts,
            seed=seed,
            callback=callback,
            journal=book,
            resume=resume and book is not None and book.exists(),
        )
        # Saving closes a journal: not before the last one is done.
        replace(calibrations[method], journal=None).save(folder / method, force=force)
    say("hiding something in another virtual person, and diagnosing it", quiet=quiet)
    gap = demonstrate_gap(
        folder,
        drawn_effect(seed),
        seed=seed,
        force=force,
        quiet=quiet,
        callback=callback,
        tell=lambda line: say(line, quiet=quiet),
    )
    shown = Demonstration(
        calibrations,
        truth,
        _recovery(calibrations["NGA"], truth),
        wrap_recovery(calibrations["PGA"], truth, MOMENT_NOISE),
        gap,
    )
    shown.save(folder)
    if journal is not None:
        shutil.rmtree(journal, ignore_errors=True)
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


def _recovery(calibration: Calibration, truth: VirtualTruth) -> tuple[Recovery, ...]:
    result = calibration.result
    problem = prepare(calibration.subject, "NGA", calibration.fit)
    deviation = laplace_deviation(problem, result.solution.variables, MOMENT_NOISE)
    rows = []
    for name in parameter_names():
        true = getattr(truth, name)
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
