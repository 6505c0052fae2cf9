"""The muscles whose cylinders' move changed them most, before and after, ready to be drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.result import CalibrationResult
from wrapjax.geometry.path_points import PlacedCylinder, RoutedPath, route_path
from wrapjax.geometry.wrapping import NOMINAL
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from wrapjax.geometry.model_description import ModelDescription

#: As many muscles are drawn.
MOST_MUSCLES = 4
# A moment arm that changed by less (m) cannot be seen.
_LEAST = 1e-4


@dataclass(frozen=True)
class MovedPath:
    """A muscle's path before and after calibration, in the recorded frame where it changed most.

    Parameters
    ----------
    muscle, coordinate
        The moment arm that changed most.
    trial, percent
        Where: cycle, and part of it.
    arm_before, arm_after
        That moment arm, m.
    before, after
        Round nominal cylinders and round moved ones, in ground's frame.
    """

    muscle: str
    coordinate: str
    trial: str
    percent: int
    arm_before: float
    arm_after: float
    before: RoutedPath
    after: RoutedPath

    @property
    def touched(self) -> list[tuple[PlacedCylinder, PlacedCylinder]]:
        """The cylinders that the path lies on before or after, before and after; all if on none."""
        pairs = list(zip(self.before.cylinders, self.after.cylinders, strict=True))
        names = self.before.contacts.keys() | self.after.contacts.keys()
        return [pair for pair in pairs if pair[0].name in names] or pairs


def moved_paths(
    subject: Subject, result: CalibrationResult, model: ModelDescription, most: int = MOST_MUSCLES
) -> list[MovedPath]:
    """Trace the muscles whose moment arms changed most on average, largest change first.

    Parameters
    ----------
    subject, result
        What was calibrated, and what came of it; nothing is traced if no cylinder was free.
    model
        The subject's, as it was before.
    most
        How many muscles.
    """
    wraps = result.freedom.wraps
    if wraps is None:
        return []
    changes = np.abs(_arms(result, after=True) - _arms(result, after=False))
    moving = (wraps.places >= 0).any(axis=1)
    size = np.where(moving, changes.mean(axis=(1, 3)).max(axis=1), 0.0)
    order = [row for row in np.argsort(-size, kind="stable").tolist() if size[row] > _LEAST]
    return [_moved(subject, result, model, muscle, changes[muscle]) for muscle in order[:most]]


def describe_move(before: PlacedCylinder, after: PlacedCylinder) -> str:
    """Say by how much a cylinder moved: its center, its axis, its radius."""
    shift = 1e3 * float(np.linalg.norm(after.center - before.center))
    turn = np.degrees(np.arccos(np.clip(before.axes[:, 2] @ after.axes[:, 2], -1.0, 1.0)))
    return (
        f"{before.name}: moved {shift:.1f} mm, turned {turn:.1f}\N{DEGREE SIGN}, radius "
        f"\N{MULTIPLICATION SIGN} {after.radius / before.radius:.2f} "
        f"({1e3 * before.radius:.1f} to {1e3 * after.radius:.1f} mm)"
    )


def _moved(
    subject: Subject,
    result: CalibrationResult,
    model: ModelDescription,
    muscle: int,
    changes: Float[np.ndarray, "trial coordinate frame"],
) -> MovedPath:
    name = result.muscles[muscle]
    trial, coordinate, frame = np.unravel_index(int(changes.argmax()), changes.shape)
    trials = subject.trials
    spanned = [own for own in model.spanned_by(name) if own in trials.coordinates]
    pose = trials.angles[trial, [trials.coordinates.index(own) for own in spanned], frame]
    before = route_path(model, name, spanned, pose)
    names = [cylinder.name for cylinder in before.cylinders]
    after = route_path(model, name, spanned, pose, _parameters(result, names))
    arms = [float(_arms(result, after=own)[muscle, trial, coordinate, frame]) for own in (False, True)]
    return MovedPath(
        muscle=name,
        coordinate=result.coordinates[coordinate],
        trial=result.trials[trial],
        percent=round(100.0 * frame / (changes.shape[2] - 1)),
        arm_before=arms[0],
        arm_after=arms[1],
        before=before,
        after=after,
    )


def _parameters(result: CalibrationResult, names: list[str]) -> Float[np.ndarray, "wrap wrap_parameter"]:
    """Parameters of these cylinders after calibration; those that were held stay nominal."""
    wraps = result.freedom.wraps
    assert wraps is not None
    changes = dict(
        zip(wraps.names, wraps.changes_of(np.asarray(result.parameters.path_changes)), strict=True)
    )
    return np.stack([NOMINAL + changes.get(name, 0.0) for name in names])


def _arms(result: CalibrationResult, *, after: bool) -> Float[np.ndarray, "muscle trial coordinate frame"]:
    return np.asarray((result.states if after else result.initial_states).path.moment_arm)
