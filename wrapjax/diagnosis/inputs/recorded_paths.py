"""Recorded muscle paths, for their derivatives by errors in the inputs of inverse dynamics."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray

from wrapjax.diagnosis.inputs.recorded_movement import RecordedMovement
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.paths import PathState
from wrapjax.subject.subject import Subject

Motion = Float[ndarray, "trial _ frame"]


@dataclass(frozen=True)
class RecordedPaths:
    """Muscle paths of a subject along the recorded movement, and what their derivatives are computed from.

    Parameters
    ----------
    subject, movement
        Subject, and its recorded movement.
    engine
        Exact engine of the subject's muscles; None where a path has elements that it does not support.
    paths
        Recorded paths; None where only `engine` is needed.
    by_angle
        Derivatives of the paths by the angles of the moment coordinates; leaves lead with ``muscle
        coordinate``. None where they are not known.
    """

    subject: Subject
    movement: RecordedMovement
    engine: ExactPaths | None = None
    paths: PathState | None = None
    by_angle: PathState | None = None


def engine_motion(engine: ExactPaths, subject: Subject) -> tuple[Motion, Motion, tuple[str, ...]]:
    """Select the motion that the exact engine computes paths along.

    Returns
    -------
    angles, velocities
        Angles (rad) and angular velocities (rad/s) of the engine's coordinates.
    moment_coordinates
        Coordinates about which moment arms are computed.
    """
    trials = subject.trials
    columns = [trials.coordinates.index(name) for name in engine.coordinates]
    return trials.angles[:, columns], trials.angular_velocities[:, columns], trials.moment_coordinates
