"""Muscle paths round nominal and calibrated wraps, for the muscles whose moment arms changed most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.geometry.exact_paths.engine import ExactPaths, nominal_parameters, wrap_at_samples
from wrapjax.geometry.exact_paths.routed_path import PlacedWrap, RoutedPath, route_path
from wrapjax.geometry.surfaces.wrap_methods import CYLINDER
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from wrapjax.geometry.skeleton.model_description import ModelDescription

#: Number of muscles that are drawn.
MOST_MUSCLES = 4
# Smallest mean change of a moment arm (m) that is visible in a figure.
_LEAST = 1e-4


@dataclass(frozen=True)
class MovedPath:
    """A muscle's path before and after calibration, in the recorded frame where its moment arm changed most.

    Parameters
    ----------
    muscle, coordinate
        Muscle and coordinate of the moment arm.
    place
        Cycle and phase of the frame: ``75 % of walk/02``.
    arm_before, arm_after
        Moment arm in that frame, m.
    before, after
        Paths round the nominal and round the calibrated wraps, in the ground frame.
    """

    muscle: str
    coordinate: str
    place: str
    arm_before: float
    arm_after: float
    before: RoutedPath
    after: RoutedPath

    @property
    def touched(self) -> list[tuple[PlacedWrap, PlacedWrap]]:
        """Surfaces (before, after) that the path touches before or after; all if it touches none."""
        pairs = list(zip(self.before.wraps, self.after.wraps, strict=True))
        names = self.before.contacts.keys() | self.after.contacts.keys()
        return [pair for pair in pairs if pair[0].name in names] or pairs


def moved_paths(
    subject: Subject, result: CalibrationResult, model: ModelDescription, most: int = MOST_MUSCLES
) -> list[MovedPath]:
    """Compute the paths of the muscles whose moment arms changed most on average, largest change first.

    Parameters
    ----------
    subject, result
        Calibrated subject and result of the calibration; the list is empty if no wrap was free.
    model
        Subject's model before calibration.
    most
        Largest number of muscles.
    """
    wraps = result.freedom.wraps
    if wraps is None:
        return []
    changes = np.abs(_arms(result, after=True) - _arms(result, after=False))
    moving = (wraps.places >= 0).any(axis=1)
    size = np.where(moving, changes.mean(axis=(1, 3)).max(axis=1), 0.0)
    order = [row for row in np.argsort(-size, kind="stable").tolist() if size[row] > _LEAST]
    return [_moved(subject, result, model, muscle, changes[muscle]) for muscle in order[:most]]


def path_round_moved_wraps(
    model: ModelDescription,
    muscle: str,
    coordinates: Sequence[str],
    pose: Float[np.ndarray, " coordinate"],
    parameters: Float[np.ndarray, "wrap wrap_parameter"],
) -> MovedPath:
    """Compute a muscle's shortest path round nominal and moved wraps in one pose.

    Parameters
    ----------
    model, muscle
        Model and name of the muscle.
    coordinates, pose
        Names and values (rad or m) of coordinates. The moment arm is that which changes most.
    parameters
        Wrap parameters of the muscle's wraps in the order of its path.
    """
    posed = ExactPaths(model, (muscle,), coordinates).posed(np.asarray(pose, dtype=float)[None])[muscle]
    both = np.stack([nominal_parameters(*parameters.shape), parameters])
    arms = np.asarray(wrap_at_samples(posed, both).moment_arm)[:, 0]
    largest = int(np.abs(arms[1] - arms[0]).argmax())
    return MovedPath(
        muscle=muscle,
        coordinate=coordinates[largest],
        place="this pose",
        arm_before=float(arms[0, largest]),
        arm_after=float(arms[1, largest]),
        before=route_path(model, muscle, coordinates, pose),
        after=route_path(model, muscle, coordinates, pose, parameters),
    )


def describe_move(before: PlacedWrap, after: PlacedWrap) -> str:
    """Write how far a surface's center moved, its axis turned and its sizes changed."""
    shift = 1e3 * float(np.linalg.norm(after.center - before.center))
    turn = np.degrees(np.arccos(np.clip(before.axes[:, 2] @ after.axes[:, 2], -1.0, 1.0)))
    moved = f"{before.name}: moved {shift:.1f} mm"
    turned = "" if before.kind == "sphere" else f", turned {turn:.1f}\N{DEGREE SIGN}"
    times = "\N{MULTIPLICATION SIGN}"
    if before.kind in (CYLINDER, "sphere"):
        ratio, ends = (
            after.radius / before.radius,
            f"{1e3 * before.radius:.1f} to {1e3 * after.radius:.1f} mm",
        )
        return f"{moved}{turned}, radius {times} {ratio:.2f} ({ends})"
    count = 2 if before.kind == "torus" else 3
    ratios = [f"{new / old:.2f}" for new, old in zip(after.sizes[:count], before.sizes[:count], strict=True)]
    return f"{moved}{turned}, {'radii' if count == 2 else 'semi-axes'} {times} {', '.join(ratios)}"


def _moved(
    subject: Subject,
    result: CalibrationResult,
    model: ModelDescription,
    muscle: int,
    changes: Float[np.ndarray, "trial coordinate frame"],
) -> MovedPath:
    muscle_name = result.muscles[muscle]
    trial, coordinate, frame = np.unravel_index(int(changes.argmax()), changes.shape)
    trials = subject.trials
    spanned = [name for name in model.spanned_by(muscle_name) if name in trials.coordinates]
    pose = trials.angles[trial, [trials.coordinates.index(name) for name in spanned], frame]
    before = route_path(model, muscle_name, spanned, pose)
    names = [wrap.name for wrap in before.wraps]
    after = route_path(model, muscle_name, spanned, pose, _wrap_parameters(result, names))
    arms = [float(_arms(result, after=after)[muscle, trial, coordinate, frame]) for after in (False, True)]
    return MovedPath(
        muscle=muscle_name,
        coordinate=result.coordinates[coordinate],
        place=f"{round(100.0 * frame / (changes.shape[2] - 1))} % of {result.trials[trial]}",
        arm_before=arms[0],
        arm_after=arms[1],
        before=before,
        after=after,
    )


def _wrap_parameters(result: CalibrationResult, names: list[str]) -> Float[np.ndarray, "wrap wrap_parameter"]:
    """Look up parameters of the named wraps after calibration; nominal for those that were held."""
    wraps = result.freedom.wraps
    assert wraps is not None
    changes = dict(
        zip(wraps.names, wraps.changes_of(np.asarray(result.parameters.path_changes)), strict=True)
    )
    return np.stack([wraps.nominal + changes.get(name, 0.0) for name in names])


def _arms(result: CalibrationResult, *, after: bool) -> Float[np.ndarray, "muscle trial coordinate frame"]:
    return np.asarray((result.states if after else result.initial_states).path.moment_arm)
