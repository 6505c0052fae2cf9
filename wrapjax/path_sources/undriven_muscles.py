"""The muscles of a leg that no EMG channel drives.

Muscles without an electrode, driven by synergies of the measured EMG.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.engine import ExactPaths
from wrapjax.geometry.path_derivatives import compute_nominal_paths
from wrapjax.geometry.paths import PathState
from wrapjax.io.model_file import read_model_file
from wrapjax.model.freedom import Freedom
from wrapjax.model.freedom import with_synergies as with_free_weights
from wrapjax.model.parameters import ModelParameters, initial_parameters
from wrapjax.muscle.curves import HILL_CURVES, AbstractCurves
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import recorded_motion
from wrapjax.subject.muscle_groups import activation_groups, fiber_length_groups, group_by_excitation
from wrapjax.subject.muscle_parameters import check_muscle_parameters
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.subject import Subject
from wrapjax.subject.synergies import DEFAULT_SYNERGIES, Synergies, SynergyBasis, fit_synergies


class UndrivenMuscles(eqx.Module):
    """Muscles of the leg that no EMG channel drives, over the recorded cycles."""

    names: tuple[str, ...] = eqx.field(static=True)
    #: Names of those that one unrecorded drive would excite together, by the name of the group.
    groups: tuple[tuple[str, tuple[str, ...]], ...] = eqx.field(static=True)
    curves: AbstractCurves
    #: Leaves of both lead with ``muscle``.
    parameters: ModelParameters
    path: PathState


def build_undriven_muscles(
    subject: Subject, curves: str, model_file: Path | None = None
) -> tuple[UndrivenMuscles | None, str]:
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
    muscles = UndrivenMuscles(
        names=names,
        groups=group_by_excitation(names),
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
        As of `build_undriven_muscles`.

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
    every = compute_nominal_paths(
        engine, *recorded_motion(trials, engine.coordinates), trials.moment_coordinates
    )
    moving = np.flatnonzero(np.any(every.moment_arm != 0.0, axis=(1, 2, 3)))
    if not moving.size:
        return (), None
    return tuple(known[row] for row in moving), jax.tree.map(lambda leaf: leaf[moving], every)


#: What may become of muscles without an electrode: nothing drives them, or synergies do.
STRATEGIES = ("left", "synergies")


def apply_undriven_strategy(
    subject: Subject, undriven: str = STRATEGIES[0], synergies: int = DEFAULT_SYNERGIES
) -> Subject:
    """Say what drives a subject's muscles without an electrode.

    Parameters
    ----------
    subject
        From `load_subject`.
    undriven
        ``left``: nothing does, and the subject is given back as it is. ``synergies``: weighted sums of the
        first principal components of the measured EMG, whose weights a calibration finds. Then the muscles
        are those of ``[emg.extrapolated]`` in the settings, a line an excitation; without that table every
        muscle of this leg that the exact engine can lay and that has a moment arm about a matched
        coordinate, each with an excitation of its own.
    synergies
        How many components.

    Returns
    -------
    Subject
        With the muscles that are driven now after those that have channels. Whatever takes a subject's
        muscle paths takes those of all.

    Raises
    ------
    InputError
        If there is no such muscle, fewer channels than synergies, or a muscle that cannot be driven.
    """
    if undriven not in STRATEGIES:
        raise ValueError(f"unknown strategy '{undriven}': expected one of {', '.join(STRATEGIES)}")
    if undriven == "left" or subject.synergies is not None:
        return subject
    return drive_by_synergies(subject, _basis(subject, synergies), _groups(subject))


def drive_by_synergies(
    subject: Subject, basis: SynergyBasis, groups: Mapping[str, tuple[str, ...]]
) -> Subject:
    """Drive these muscles of a subject by these synergies.

    Parameters
    ----------
    subject
        Whose muscles; those of ``groups`` are without a channel.
    basis
        Of the commands: this subject's own, or that of an earlier calibration of the person.
    groups
        By the name of an excitation, the muscles that have it.
    """
    synergies = Synergies(basis, dict(groups))
    own = subject.undriven_parameters
    assert own is not None, "read_subject gives them"
    problems: list[Problem] = []
    added = check_muscle_parameters(own, synergies.muscles, subject.model_file, problems)
    if added is None:
        raise InputError(problems)
    muscles = subject.muscles.extended_by(added)
    model_groups = read_model_file(subject.model_file).groups
    left = tuple(name for name in subject.undriven_muscles if name not in added.names)
    return replace(
        subject,
        muscles=muscles,
        activation_groups=activation_groups(model_groups, muscles.names, subject.side),
        fiber_length_groups=fiber_length_groups(model_groups, muscles.names, subject.side),
        undriven_muscles=left,
        undriven_parameters=own.select(left),
        synergies=synergies,
    )


def with_synergy_weights(freedom: Freedom, subject: Subject) -> Freedom:
    """Free the weights of a subject's synergies as well, where it has any."""
    synergies = subject.synergies
    if synergies is None or freedom.synergies is not None:
        return freedom
    number = {muscle: place for place, own in enumerate(synergies.groups.values()) for muscle in own}
    places = np.array([number.get(muscle, -1) for muscle in subject.muscles.names])
    return with_free_weights(freedom, tuple(synergies.groups), places, synergies.basis.count)


def _basis(subject: Subject, count: int) -> SynergyBasis:
    """Find synergies in the cycles that are calibrated on."""
    trials = subject.trials.used_for("calibration")
    channels = trials.channels
    if count > len(channels):
        message = f"{count} synergies were asked for, and {len(channels)} EMG channels have at most as many"
        raise InputError(Problem(str(subject.folder / SETTINGS_FILE), message, "[emg.channels]"))
    return fit_synergies(trials.emg, channels, count)


def _groups(subject: Subject) -> dict[str, tuple[str, ...]]:
    """Name the excitations, and the muscles of each."""
    file = str(subject.folder / SETTINGS_FILE)
    acting, _ = acting_muscles(subject)
    if subject.extrapolated is None:
        if not acting:
            message = "has no muscle without a channel whose path is known and that acts on these coordinates"
            raise InputError(Problem(file, message, hint="use --undriven left"))
        return {name: (name,) for name in acting}
    problems = [
        Problem(
            file,
            f"'{muscle}' cannot be driven: its path is not known, or it acts on none of the coordinates",
            f"[emg.extrapolated] {name}",
        )
        for name, muscles in subject.extrapolated.items()
        for muscle in muscles
        if muscle not in acting
    ]
    if not subject.extrapolated:
        problems.append(Problem(file, "expected at least one excitation, found none", "[emg.extrapolated]"))
    if problems:
        raise InputError(problems)
    return dict(subject.extrapolated)
