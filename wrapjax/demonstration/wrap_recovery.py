"""How near a calibration's moment arms and cylinders came to a virtual person's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.calibration import Calibration
from wrapjax.calibration.problem import build_objective
from wrapjax.calibration.uncertainty.intervals import moment_arm_deviation
from wrapjax.datasets.virtual_person.true_parameters import TrueParameters
from wrapjax.geometry.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.osim.personalised_model import write_personalised_model
from wrapjax.subject.subject import Subject

#: An arm counts as told apart from other parameters where the moments leave this part of its change open.
IDENTIFIABLE_RATIO = 0.1
# How many arms the figure shows.
_DRAWN = 8
#: And where it is at least as far (m) from the true one: a smaller change shows nothing.
MINIMUM_ERROR = 1e-4


@dataclass(frozen=True)
class WrapRecovery:
    """Moment arms and cylinders of a calibration that moved them, beside the true ones.

    Parameters
    ----------
    muscles, coordinates
        Those that run by a cylinder that was free, and all coordinates.
    true, before, after
        Moment arms (m): OpenSim's round the true cylinders; the calibration's own round nominal ones and
        round those that it found.
    deviation
        What the moments leave open of them (m), mean over frames: the standard deviation that noise causes.
    wraps, true_wraps, found_wraps
        Names, and parameters as in `WRAP_PARAMETERS`.
    """

    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    true: Float[np.ndarray, "muscle trial coordinate frame"]
    before: Float[np.ndarray, "muscle trial coordinate frame"]
    after: Float[np.ndarray, "muscle trial coordinate frame"]
    deviation: Float[np.ndarray, "muscle coordinate"]
    wraps: tuple[str, ...]
    true_wraps: Float[np.ndarray, "wrap wrap_parameter"]
    found_wraps: Float[np.ndarray, "wrap wrap_parameter"]

    @property
    def error_before(self) -> Float[np.ndarray, "muscle coordinate"]:
        """Mean absolute error of moment arms round nominal cylinders, m."""
        return np.abs(self.before - self.true).mean(axis=(1, 3))

    @property
    def error_after(self) -> Float[np.ndarray, "muscle coordinate"]:
        """Mean absolute error of moment arms after calibration, m."""
        return np.abs(self.after - self.true).mean(axis=(1, 3))

    @property
    def identifiable(self) -> Bool[np.ndarray, "muscle coordinate"]:
        """Arms whose change the moments tell apart from other parameters, to a tenth of its size."""
        return identifiable(self.error_before, self.deviation)

    def largest_errors(self, count: int) -> tuple[tuple[int, int], ...]:
        """Give muscle and coordinate, by number, of the arms that are furthest from nominal."""
        order = np.argsort(-self.error_before, axis=None, kind="stable")[:count]
        muscles, coordinates = np.unravel_index(order, self.error_before.shape)
        return tuple(zip(muscles.tolist(), coordinates.tolist(), strict=True))

    def content(self) -> dict[str, object]:
        """Arrange for JSON; moment-arm errors are means over these muscles and all frames."""
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
                "found": dict(zip(WRAP_PARAMETERS, found, strict=True)),
            }
            for name, true, found in zip(self.wraps, self.true_wraps, self.found_wraps, strict=True)
        }
        return {"muscles": self.muscles, "moment_arm_error": errors, "wraps": wraps}

    def draw(self, file: Path) -> None:
        """Draw the arms that were hidden furthest, mean over cycles, with what the moments leave open."""
        from wrapjax.report.recovery import draw_wrap_recovery

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
    """Compare what PGA found with the true cylinders.

    Parameters
    ----------
    calibration
        Of a virtual subject, with cylinders free.
    truth
        Theirs.
    moment_noise
        Standard deviation of the recorded moments' noise, N m.
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
        found_wraps=NOMINAL + freed.changes_of(np.asarray(result.parameters.path_changes)),
    )


def identifiable(
    error_before: Float[np.ndarray, "muscle coordinate"], deviation: Float[np.ndarray, "muscle coordinate"]
) -> Bool[np.ndarray, "muscle coordinate"]:
    """Tell moment arms whose change the moments do not take for another parameter's; both are in m."""
    return (error_before > MINIMUM_ERROR) & (deviation < IDENTIFIABLE_RATIO * error_before)


def compute_true_moment_arms(
    subject: Subject, true_parameters: TrueParameters
) -> Float[np.ndarray, "muscle trial coordinate frame"]:
    """Compute a virtual person's moment arms (m) by OpenSim, round their true cylinders."""
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
