"""Errors of moment arms and wrapping cylinders of a virtual subject after calibration by PGA."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.calibration import Calibration
from wrapjax.calibration.problem import build_objective
from wrapjax.calibration.uncertainty.identifiability import moment_arm_deviation
from wrapjax.datasets.virtual_person.true_parameters import TrueParameters
from wrapjax.geometry.exact_paths.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.osim.personalised_model import write_personalised_model
from wrapjax.subject.subject import Subject

#: A moment arm is identifiable if its standard deviation due to the noise of the moments is below this
#: fraction of its error before calibration,
IDENTIFIABLE_RATIO = 0.1
#: and if that error exceeds this value, m.
MINIMUM_ERROR = 1e-4
# Number of moment arms in the figure.
_DRAWN = 8


@dataclass(frozen=True)
class WrapRecovery:
    """Moment arms and wrapping cylinders after a calibration that changed them, beside the true ones.

    Parameters
    ----------
    muscles
        Names of the muscles that wrap round a freed cylinder.
    coordinates
        Names of all coordinates.
    true
        Moment arms by OpenSim with the true cylinders, m.
    before, after
        Moment arms of the calibrated model with the nominal and with the calibrated cylinders, m.
    deviation
        Standard deviation of the moment arms due to the noise of the moments, mean over frames, m.
    wraps
        Names of the cylinders.
    true_wraps, calibrated_wraps
        Parameters of the cylinders (`WRAP_PARAMETERS`).
    """

    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    true: Float[np.ndarray, "muscle trial coordinate frame"]
    before: Float[np.ndarray, "muscle trial coordinate frame"]
    after: Float[np.ndarray, "muscle trial coordinate frame"]
    deviation: Float[np.ndarray, "muscle coordinate"]
    wraps: tuple[str, ...]
    true_wraps: Float[np.ndarray, "wrap wrap_parameter"]
    calibrated_wraps: Float[np.ndarray, "wrap wrap_parameter"]

    @property
    def error_before(self) -> Float[np.ndarray, "muscle coordinate"]:
        """Mean absolute error of moment arms with nominal cylinders, m."""
        return np.abs(self.before - self.true).mean(axis=(1, 3))

    @property
    def error_after(self) -> Float[np.ndarray, "muscle coordinate"]:
        """Mean absolute error of moment arms after calibration, m."""
        return np.abs(self.after - self.true).mean(axis=(1, 3))

    @property
    def identifiable(self) -> Bool[np.ndarray, "muscle coordinate"]:
        """Whether the recorded moments identify each moment arm, see `identifiable`."""
        return identifiable(self.error_before, self.deviation)

    def largest_errors(self, count: int) -> tuple[tuple[int, int], ...]:
        """Return (muscle, coordinate) indices of the moment arms with the largest initial errors."""
        order = np.argsort(-self.error_before, axis=None, kind="stable")[:count]
        muscles, coordinates = np.unravel_index(order, self.error_before.shape)
        return tuple(zip(muscles.tolist(), coordinates.tolist(), strict=True))

    def content(self) -> dict[str, object]:
        """Entry of ``demo.json``; errors of moment arms are means over the muscles and all frames."""
        errors = {
            coordinate: {
                "before_m": self.error_before[:, column].mean(),
                "after_m": self.error_after[:, column].mean(),
                "open_m": self.deviation[:, column].mean(),
                "told_apart": self.identifiable[:, column].sum(),
            }
            for column, coordinate in enumerate(self.coordinates)
        }
        wraps = {
            name: {
                "true": dict(zip(WRAP_PARAMETERS, true, strict=True)),
                "found": dict(zip(WRAP_PARAMETERS, calibrated, strict=True)),
            }
            for name, true, calibrated in zip(self.wraps, self.true_wraps, self.calibrated_wraps, strict=True)
        }
        return {"muscles": self.muscles, "moment_arm_error": errors, "wraps": wraps}

    def draw(self, file: Path) -> None:
        """Plot the moment arms with the largest errors, mean over cycles, with their standard deviations."""
        from wrapjax.report.calibration.recovery import draw_wrap_recovery

        shown = self.largest_errors(_DRAWN)
        names = [f"{self.muscles[row]} about {self.coordinates[column]}" for row, column in shown]
        rows, columns = np.array(shown).T
        true, before, after = (
            arms.mean(axis=1)[rows, columns] for arms in (self.true, self.before, self.after)
        )
        draw_wrap_recovery(
            file,
            arms=names,
            true=true,
            before=before,
            after=after,
            deviation=self.deviation[rows, columns],
        )


def wrap_recovery(
    calibration: Calibration, true_parameters: TrueParameters, moment_noise: float
) -> WrapRecovery:
    """Compare moment arms and cylinders calibrated by PGA with the true ones.

    Parameters
    ----------
    calibration
        Calibration of a virtual subject with free cylinders.
    true_parameters
        True parameters of that subject.
    moment_noise
        Standard deviation of the noise of the recorded moments, N m.

    Returns
    -------
    WrapRecovery
        True and calibrated moment arms and cylinders.

    Raises
    ------
    ValueError
        If the calibration freed no cylinder.
    """
    subject, result = calibration.subject, calibration.result
    freed, moving = result.freedom.wraps, result.freedom.moving_paths
    if freed is None or moving is None:
        raise ValueError(f"{result.method} frees no cylinder")
    problem = build_objective(subject, result.method, calibration.fit, result.freedom)
    deviation = moment_arm_deviation(problem, result.solution.variables, moment_noise)
    return WrapRecovery(
        muscles=tuple(np.array(result.muscles)[moving].tolist()),
        coordinates=result.coordinates,
        true=compute_true_moment_arms(subject, true_parameters)[moving],
        before=np.asarray(result.initial_states.path.moment_arm)[moving],
        after=np.asarray(result.states.path.moment_arm)[moving],
        deviation=deviation[moving].mean(axis=(1, 3)),
        wraps=freed.names,
        true_wraps=np.stack([true_parameters.wraps.get(name, NOMINAL) for name in freed.names]),
        calibrated_wraps=freed.values_of(np.asarray(result.parameters.path_changes)),
    )


def identifiable(
    error_before: Float[np.ndarray, "muscle coordinate"], deviation: Float[np.ndarray, "muscle coordinate"]
) -> Bool[np.ndarray, "muscle coordinate"]:
    """Find the moment arms that the recorded moments identify.

    Parameters
    ----------
    error_before
        Mean absolute error before calibration, m.
    deviation
        Standard deviation due to the noise of the moments, m.
    """
    return (error_before > MINIMUM_ERROR) & (deviation < IDENTIFIABLE_RATIO * error_before)


def compute_true_moment_arms(
    subject: Subject, true_parameters: TrueParameters
) -> Float[np.ndarray, "muscle trial coordinate frame"]:
    """Compute the moment arms of a virtual subject (m) by OpenSim with the true cylinders."""
    trials, muscles = subject.trials, subject.muscles.names
    poses = np.moveaxis(trials.angles, 1, -1)
    with TemporaryDirectory() as place:
        model_file = Path(place) / "true.osim"
        write_personalised_model(subject.model_file, model_file, true_parameters.wraps, {})
        arms = analyse_muscles(
            model_file, muscles, trials.coordinates, np.concatenate(poses), quiet=True
        ).moment_arm
    columns = [trials.coordinates.index(name) for name in trials.moment_coordinates]
    by_cycle = arms.reshape(*poses.shape, len(muscles))[:, :, columns]
    return np.transpose(by_cycle, (3, 0, 2, 1))
