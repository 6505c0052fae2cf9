"""``demo``: calibrate a virtual subject whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrapjax.api.calibration import Calibration, calibrate
from wrapjax.api.fitting import fit
from wrapjax.api.preparation import prepare
from wrapjax.calibrate import Watch, laplace_deviation
from wrapjax.files import write_json
from wrapjax.model import QUANTITIES
from wrapjax.progress import say
from wrapjax.subject import read_subject
from wrapjax.virtual import VirtualTruth, write_virtual_subject
from wrapjax.virtual.truth import parameter_names

#: Of the virtual recordings, N m.
MOMENT_NOISE = 1.0


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
    """A calibrated virtual subject beside its truth."""

    calibration: Calibration
    truth: VirtualTruth
    recovery: tuple[Recovery, ...]

    def save(self, folder: Path) -> None:
        """Write ``demo.json`` and a figure of calibrated against true parameters."""
        from wrapjax.report.recovery_figure import draw_recovery

        rows = [vars(row) for row in self.recovery]
        content = {"schema": 1, "note": "same-form data: a unit test, not an accuracy", "recovery": rows}
        write_json(folder / "demo.json", content)
        result = self.calibration.result
        draw_recovery(result.initial, result.parameters, self.truth, folder / "recovery.png")


def demo(
    folder: str | Path,
    *,
    seed: int = 0,
    force: bool = False,
    quiet: bool = True,
    callback: Watch | None = None,
) -> Demonstration:
    """Make up a person, let them walk, calibrate, and compare with the truth.

    The virtual leg walks by the package's own equations, so this shows that calibration finds what it
    looks for; how well it does on people is another question.

    Parameters
    ----------
    folder
        Gets ``virtual_subject/``, ``fit/``, ``NGA/``, ``demo.json`` and ``recovery.png``.
    seed
        Decides the person, the walking and the noise.
    force
        Replace what is there.
    quiet
        Print no progress.
    callback
        As in `calibrate`.
    """
    folder = Path(folder)
    say("building a virtual person and letting it walk", quiet=quiet)
    truth = write_virtual_subject(
        folder / "virtual_subject", seed=seed, moment_noise=MOMENT_NOISE, force=force
    )
    subject = read_subject(folder / "virtual_subject")
    fitted = fit(subject, seed=seed, quiet=quiet)
    fitted.save(folder / "fit", force=force)
    say("compiling (once; later runs take it from the cache)", quiet=quiet)
    calibration = calibrate(subject, "NGA", fitted, callback=callback)
    calibration.save(folder / "NGA", force=force)
    shown = Demonstration(calibration, truth, _recovery(calibration, truth))
    shown.save(folder)
    return shown


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
