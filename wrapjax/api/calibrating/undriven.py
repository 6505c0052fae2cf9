"""The muscles of a leg that no EMG channel drives."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np

from wrapjax.api.paths.exact import recorded
from wrapjax.errors import InputError
from wrapjax.gap import OtherMuscles
from wrapjax.gap.anatomy import groups_of
from wrapjax.geometry import PathState
from wrapjax.geometry.engine import ExactPaths
from wrapjax.geometry.path_slopes import laid_paths
from wrapjax.model import initial_parameters
from wrapjax.muscle import HILL_CURVES
from wrapjax.osim import describe_model
from wrapjax.subject import Subject


def other_muscles(
    subject: Subject, curves: str, model_file: Path | None = None
) -> tuple[OtherMuscles | None, str]:
    """Lay the muscles that nothing drives, as strong and long as the subject has them; or say why not.

    Parameters
    ----------
    subject
        From `load_subject`.
    curves
        Name of the Hill curves.
    model_file
        The model that paths are taken from, where it is not the subject's own. Parameters are always the
        subject's: of its table of muscle parameters where that has them, else of its model.

    Returns
    -------
    muscles, reason
        Those that can be laid and have a moment arm about a matched coordinate.
    """
    if not subject.undriven_muscles:
        return None, "every muscle of this leg has an EMG channel"
    names, path = acting_muscles(subject, model_file)
    if path is None:
        return None, "the paths of the muscles without an EMG channel are not known about these joints"
    assert subject.undriven_parameters is not None, "read_subject gives them"
    own = subject.undriven_parameters.select(names)
    muscles = OtherMuscles(
        names=names,
        groups=groups_of(names),
        curves=HILL_CURVES[curves],
        parameters=initial_parameters(
            own.max_isometric_force,
            own.optimal_fiber_length,
            own.tendon_slack_length,
            own.pennation_angle,
        ),
        path=path,
    )
    return muscles, ""


def acting_muscles(
    subject: Subject, model_file: Path | None = None
) -> tuple[tuple[str, ...], PathState | None]:
    """Lay those muscles without a channel that can be laid and have an arm about a matched coordinate.

    Parameters
    ----------
    subject, model_file
        As of `other_muscles`.

    Returns
    -------
    names, path
        In the model's order; no path where there is no such muscle.
    """
    model = describe_model(model_file or subject.model_file)

    def can_be_laid(muscle: str) -> bool:
        try:
            ExactPaths(model, (muscle,), ())
        except InputError:
            return False
        return True

    known = tuple(filter(can_be_laid, subject.undriven_muscles))
    if not known:
        return (), None
    spanned = {name for muscle in known for name in model.spanned_by(muscle)}
    engine = ExactPaths(model, known, tuple(name for name in subject.trials.coordinates if name in spanned))
    trials = subject.trials
    every = laid_paths(engine, *recorded(trials, engine.coordinates), trials.moment_coordinates)
    moving = np.flatnonzero(np.any(every.moment_arm != 0.0, axis=(1, 2, 3)))
    if not moving.size:
        return (), None
    return tuple(known[row] for row in moving), jax.tree.map(lambda leaf: leaf[moving], every)
