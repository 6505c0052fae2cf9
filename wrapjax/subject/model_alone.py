"""A leg of a model without recordings, with an electrode on every group of muscles."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.io.model_file import read_model_file
from wrapjax.subject.muscle_groups import activation_groups, fiber_length_groups, group_by_excitation
from wrapjax.subject.muscle_parameters import check_muscle_parameters
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import FRAMES, Trials

#: Coordinates of a leg, without the suffix of the side.
LEG_COORDINATES = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_angle",
    "ankle_angle",
    "subtalar_angle",
)


def subject_of_model(model_file: str | Path, side: str = "r") -> Subject:
    """Return a leg of a model as a subject without trials.

    Each group of muscles that usually share an excitation has an electrode. Muscles without the suffix of a
    side belong to no leg.

    Parameters
    ----------
    model_file
        OpenSim model (``.osim``).
    side
        Side of the leg, ``l`` or ``r``.

    Raises
    ------
    InputError
        If the file is not a model, or the model has no coordinates or no muscles of such a leg.
    """
    file = Path(model_file)
    model = read_model_file(file)
    free = {info.name for info in model.coordinates if info.motion_type == "rotational" and not info.locked}
    coordinates = tuple(
        name
        for stem in LEG_COORDINATES
        if (name := next((one for one in (f"{stem}_{side}", stem) if one in free), ""))
    )
    names = tuple(name for name in model.muscles.names if re.search(f"_{side}$", name))
    problems: list[Problem] = []
    if not coordinates:
        expected = ", ".join(f"{stem}_{side}" for stem in LEG_COORDINATES[:1] + LEG_COORDINATES[3:5])
        problems.append(Problem(str(file), f"expected coordinates of a leg, such as {expected}, found none"))
    if not names:
        problems.append(Problem(str(file), f"expected muscles whose names end in '_{side}', found none"))
    channels = dict(group_by_excitation(names))
    driven = tuple(name for members in channels.values() for name in members)
    muscles = check_muscle_parameters(model.muscles, driven, file, problems) if not problems else None
    if problems or muscles is None:
        raise InputError(problems)
    numbers = {name: place for place, members in enumerate(channels.values()) for name in members}
    return Subject(
        name=file.stem,
        mass_kg=model.mass_kg,
        side=side,
        paretic=None,
        folder=file.parent,
        model_file=file,
        other_leg=None,
        muscles=muscles,
        muscle_channels=tuple(numbers[name] for name in muscles.names),
        activation_groups=activation_groups(model.groups, muscles.names, side),
        fiber_length_groups=fiber_length_groups(model.groups, muscles.names, side),
        undriven_muscles=(),
        trials=_no_trials(coordinates, tuple(channels)),
        recordings=(),
        emg_rates=(),
        notes=(),
    )


def _no_trials(coordinates: tuple[str, ...], channels: tuple[str, ...]) -> Trials:
    joint, emg = np.zeros((0, len(coordinates), FRAMES)), np.zeros((0, len(channels), FRAMES))
    return Trials(
        names=(),
        recordings=(),
        uses=(),
        speeds=np.zeros(0),
        coordinates=coordinates,
        moment_coordinates=coordinates,
        channels=channels,
        time=np.zeros((0, FRAMES)),
        angles=joint,
        angular_velocities=joint,
        moments=joint,
        emg_time=np.zeros((0, FRAMES)),
        emg=emg,
    )
