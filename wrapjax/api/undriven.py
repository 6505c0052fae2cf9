"""The muscles of a leg that no EMG channel drives."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np

from wrapjax.api.exact import recorded
from wrapjax.errors import InputError
from wrapjax.gap import OtherMuscles
from wrapjax.gap.anatomy import groups_of
from wrapjax.geometry.engine import ExactPaths
from wrapjax.geometry.path_slopes import laid_paths
from wrapjax.model import initial_parameters
from wrapjax.muscle import HILL_CURVES
from wrapjax.osim import describe_model
from wrapjax.subject import Subject
from wrapjax.subject.model_file import read_model_file


def other_muscles(
    subject: Subject, curves: str, model_file: Path | None = None
) -> tuple[OtherMuscles | None, str]:
    """Lay the muscles without a channel, with the model's own parameters; or say why there are none.

    Parameters
    ----------
    subject
        From `load_subject`.
    curves
        Name of the Hill curves.
    model_file
        The model that paths are taken from, where it is not the subject's own.

    Returns
    -------
    muscles, reason
        Those that can be laid and have a moment arm about a matched coordinate.
    """
    file = model_file or subject.model_file
    if not subject.undriven_muscles:
        return None, "every muscle of this leg has an EMG channel"
    model = describe_model(file)
    table = read_model_file(file).muscles

    def can_be_laid(muscle: str) -> bool:
        try:
            ExactPaths(model, (muscle,), ())
        except InputError:
            return False
        return muscle in table.names

    known = tuple(filter(can_be_laid, subject.undriven_muscles))
    spanned = {name for muscle in known for name in model.spanned_by(muscle)}
    engine = ExactPaths(model, known, tuple(name for name in subject.trials.coordinates if name in spanned))
    trials = subject.trials
    cycles = (*recorded(trials, engine.coordinates), trials.moment_coordinates)
    every = laid_paths(engine, *cycles) if known else None
    moving = () if every is None else np.flatnonzero(np.any(every.moment_arm != 0.0, axis=(1, 2, 3)))
    names = tuple(known[row] for row in moving)
    if every is None or not names:
        return None, "the paths of the muscles without an EMG channel are not known about these joints"
    own = table.select(names)
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
        path=jax.tree.map(lambda leaf: leaf[moving], every),
    )
    return muscles, ""
