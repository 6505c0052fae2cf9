"""Muscles of a leg without an EMG channel: their paths, and excitation by synergies of the measured EMG."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.path_derivatives import compute_nominal_paths
from wrapjax.geometry.paths import PathState
from wrapjax.io.model_file import read_model_file
from wrapjax.model.freedom import Freedom, with_synergies
from wrapjax.model.parameters import ModelParameters, initial_parameters
from wrapjax.muscle.curves import AbstractCurves, hill_curves
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import recorded_motion
from wrapjax.subject.muscle_groups import activation_groups, fiber_length_groups, group_by_excitation
from wrapjax.subject.muscle_parameters import check_muscle_parameters
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.subject import Subject
from wrapjax.subject.synergies import DEFAULT_SYNERGIES, Synergies, SynergyBasis, fit_synergies


class UndrivenMuscles(eqx.Module):
    """Muscles without an EMG channel, with parameters and paths over the recorded cycles."""

    names: tuple[str, ...] = eqx.field(static=True)
    #: Groups of these muscles that are assumed to have the same excitation, by the name of the group.
    groups: tuple[tuple[str, tuple[str, ...]], ...] = eqx.field(static=True)
    curves: AbstractCurves
    #: Leading axis of the leaves of both: ``muscle``.
    parameters: ModelParameters
    path: PathState


def build_undriven_muscles(
    subject: Subject, curves: str, model_file: Path | None = None
) -> tuple[UndrivenMuscles | None, str]:
    """Build the muscles without an EMG channel that act on the matched coordinates.

    Parameters
    ----------
    subject
        Subject from `load_subject`.
    curves
        Name of the Hill curves.
    model_file
        Model for the paths, if not the subject's. Muscle parameters are always those of the subject: of its
        parameter table where it has them, else of its model.

    Returns
    -------
    muscles, reason
        Muscles whose paths the exact engine supports and that have a moment arm about a matched coordinate;
        None with the reason if there are none.
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
        curves=hill_curves(curves),
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
    """Compute the paths of muscles without an EMG channel that act on the matched coordinates.

    Parameters
    ----------
    subject, model_file
        See `build_undriven_muscles`.

    Returns
    -------
    names, path
        Names of the muscles whose paths the exact engine supports and that have a moment arm about a matched
        coordinate, in the model's order, and their paths; None if there are none.
    """
    model = describe_model(model_file or subject.model_file)

    def is_supported(muscle: str) -> bool:
        try:
            ExactPaths(model, (muscle,), ())
        except InputError:
            return False
        return True

    supported = tuple(filter(is_supported, subject.undriven_muscles))
    if not supported:
        return (), None
    spanned = {name for muscle in supported for name in model.spanned_by(muscle)}
    engine = ExactPaths(
        model, supported, tuple(name for name in subject.trials.coordinates if name in spanned)
    )
    trials = subject.trials
    paths = compute_nominal_paths(
        engine, *recorded_motion(trials, engine.coordinates), trials.moment_coordinates
    )
    moving = np.flatnonzero(np.any(paths.moment_arm != 0.0, axis=(1, 2, 3)))
    if not moving.size:
        return (), None
    return tuple(supported[row] for row in moving), jax.tree.map(lambda leaf: leaf[moving], paths)


#: Strategies for muscles without an electrode: they are left undriven, or driven by synergies.
STRATEGIES = ("left", "synergies")


def apply_undriven_strategy(
    subject: Subject, undriven: str = STRATEGIES[0], synergies: int = DEFAULT_SYNERGIES
) -> Subject:
    """Apply a strategy for a subject's muscles without an electrode.

    Parameters
    ----------
    subject
        Subject from `load_subject`.
    undriven
        Strategy, one of `STRATEGIES`. ``left``: the muscles remain undriven, and the subject is returned
        unchanged. ``synergies``: their excitations are weighted sums of the first principal components of the
        measured EMG, with weights that a calibration determines. The muscles are then those of
        ``[emg.extrapolated]`` in the settings, one excitation per line; without that table every muscle of
        this leg whose path the exact engine supports and that has a moment arm about a matched coordinate,
        with separate excitations.
    synergies
        Number of principal components.

    Returns
    -------
    Subject
        Subject whose muscles are those with channels followed by those that synergies drive.

    Raises
    ------
    InputError
        If there is no such muscle, there are fewer channels than synergies, or a muscle of the table cannot
        be driven.
    ValueError
        If the strategy is unknown.
    """
    if undriven not in STRATEGIES:
        raise ValueError(f"unknown strategy '{undriven}': expected one of {', '.join(STRATEGIES)}")
    if undriven == "left" or subject.synergies is not None:
        return subject
    return drive_by_synergies(subject, _basis(subject, synergies), _groups(subject))


def drive_by_synergies(
    subject: Subject, basis: SynergyBasis, groups: Mapping[str, tuple[str, ...]]
) -> Subject:
    """Add muscles that given synergies drive to the muscles of a subject.

    Parameters
    ----------
    subject
        Subject with the muscles of ``groups``, which have no channel.
    basis
        Synergies: of this subject's EMG, or of an earlier calibration.
    groups
        Muscles of each excitation, by its name.

    Raises
    ------
    InputError
        If the parameters of a muscle are invalid.
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
    """Add the weights of a subject's synergies to a freedom, if it has synergies."""
    synergies = subject.synergies
    if synergies is None or freedom.synergies is not None:
        return freedom
    number = {muscle: place for place, own in enumerate(synergies.groups.values()) for muscle in own}
    places = np.array([number.get(muscle, -1) for muscle in subject.muscles.names])
    return with_synergies(freedom, tuple(synergies.groups), places, synergies.basis.count)


def _basis(subject: Subject, count: int) -> SynergyBasis:
    """Compute the synergies of the calibration cycles."""
    trials = subject.trials.used_for("calibration")
    channels = trials.channels
    if count > len(channels):
        message = f"{count} synergies were asked for, and {len(channels)} EMG channels have at most as many"
        raise InputError(Problem(str(subject.folder / SETTINGS_FILE), message, "[emg.channels]"))
    return fit_synergies(trials.emg, channels, count)


def _groups(subject: Subject) -> dict[str, tuple[str, ...]]:
    """Determine the excitations and the muscles of each, by the name of the excitation."""
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
