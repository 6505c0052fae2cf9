"""Inputs of the forward model for a subject: parameters, EMG splines, polynomial paths over its cycles."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.geometry.paths import AbstractPath, AdjustablePath, PathState, fixed_path
from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.model.forward import Recording
from wrapjax.model.parameters import ModelParameters, initial_parameters
from wrapjax.muscle.excitation import CommandSplines, EmgSpline, fit_emg_spline
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials


def model_parameters(subject: Subject, *, path_modes: int = 0) -> ModelParameters:
    """Build the initial parameter tree of a subject's calibration.

    Parameters
    ----------
    subject
        Subject with its muscle parameters.
    path_modes
        Number of path modes (see `AdjustablePath`); their coefficients are zero.
    """
    muscles = subject.muscles
    return initial_parameters(
        muscles.max_isometric_force,
        muscles.optimal_fiber_length,
        muscles.tendon_slack_length,
        muscles.pennation_angle,
        path_modes=path_modes,
        commands=None if subject.synergies is None else subject.synergies.basis.count,
    )


def surrogate_paths(
    surrogate: PathSurrogate,
    subject: Subject,
    trials: Trials,
    modes: Float[np.ndarray, "muscle term mode"] | None = None,
) -> AdjustablePath:
    """Evaluate the polynomial paths of the subject's muscles over cycles.

    Moment arms are about the coordinates whose moments are matched, in their order.

    Parameters
    ----------
    surrogate
        Polynomials of at least the subject's muscles.
    subject
        Subject with its muscles.
    trials
        Cycles over which to evaluate.
    modes
        Changes of the coefficients per unit of each path mode, m, for the subject's muscles in their order;
        None for held paths.
    """
    angles, velocities = _recorded_motion(surrogate, trials)
    own = surrogate.select_muscles(subject.muscles.names)
    arms = functools.partial(_arms_about, surrogate.coordinates, trials.moment_coordinates)
    nominal = arms(eqx.filter_jit(own)(angles, velocities))
    if modes is None:
        return fixed_path(nominal)
    changes = eqx.filter_jit(PathSurrogate.mode_derivatives)(own, angles, velocities, jnp.asarray(modes))
    return AdjustablePath(nominal, arms(changes))


def coefficient_paths(surrogate: PathSurrogate, muscles: Sequence[str], trials: Trials) -> PathState:
    """Compute the change of paths per unit (1 m) of each coefficient; leading axes are ``muscle term``."""
    own = surrogate.select_muscles(muscles)
    count, terms = own.coefficients.shape
    single = jnp.broadcast_to(jnp.eye(terms), (count, terms, terms))
    path = eqx.filter_jit(PathSurrogate.mode_derivatives)(own, *_recorded_motion(surrogate, trials), single)
    return _arms_about(surrogate.coordinates, trials.moment_coordinates, path)


def _recorded_motion(
    surrogate: PathSurrogate, trials: Trials
) -> tuple[Float[Array, "trial coordinate frame"], Float[Array, "trial coordinate frame"]]:
    """Return angles and angular velocities of the surrogate's coordinates in trials."""
    columns = [trials.coordinates.index(name) for name in surrogate.coordinates]
    return jnp.asarray(trials.angles[:, columns]), jnp.asarray(trials.angular_velocities[:, columns])


def _arms_about(given: tuple[str, ...], wanted: tuple[str, ...], path: PathState) -> PathState:
    """Select moment arms about the wanted coordinates; zero about coordinates without polynomials."""
    places = np.array([given.index(name) if name in given else len(given) for name in wanted])
    arms = np.asarray(path.moment_arm)
    moment_arm = np.append(arms, np.zeros_like(arms[..., :1, :]), axis=-2)[..., places, :]
    return PathState(path.length, path.velocity, jnp.asarray(moment_arm))


def recording(subject: Subject, trials: Trials, path: AbstractPath) -> Recording:
    """Combine the EMG splines of the muscles, or their synergy commands, with their paths.

    Parameters
    ----------
    subject
        Subject with its muscles and channels.
    trials
        Cycles with their EMG.
    path
        Paths of the subject's muscles over these cycles.
    """
    splines = fit_emg_spline(trials.emg_time, trials.emg, trials.emg_starts)
    channels = np.array(subject.muscle_channels)
    emg = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[channels]), splines)
    if subject.synergies is not None:
        emg = _with_commands(emg, subject, trials)
    return Recording(emg=emg, path=path, padding=trials.padding)


def _with_commands(emg: EmgSpline, subject: Subject, trials: Trials) -> EmgSpline:
    """Append muscles without a channel, whose EMG splines are zero, and add the synergy commands."""
    assert subject.synergies is not None
    added = len(subject.synergies.muscles)
    driven, *shape = emg.coefficients.shape
    zero_emg = jnp.zeros((added, *shape))
    step = jnp.broadcast_to(emg.step[:1], (added, len(trials)))
    read = subject.synergies.basis.commands(trials.emg, trials.channels)
    commands = fit_emg_spline(trials.emg_time, read, trials.emg_starts).coefficients
    for_all_muscles = jnp.broadcast_to(
        jnp.moveaxis(commands, 0, 1), (driven + added, len(trials), len(commands), *commands.shape[2:])
    )
    share = jnp.repeat(jnp.array([0.0, 1.0]), np.array([driven, added]), total_repeat_length=driven + added)
    return EmgSpline(
        coefficients=jnp.concatenate([emg.coefficients, zero_emg]),
        step=jnp.concatenate([emg.step, step]),
        commands=CommandSplines(
            for_all_muscles, jnp.broadcast_to(share[:, None], (driven + added, len(trials)))
        ),
        start=None if emg.start is None else jnp.broadcast_to(emg.start[:1], (driven + added, len(trials))),
    )


def group_indices(
    groups: tuple[tuple[str, ...], ...], muscles: tuple[str, ...]
) -> tuple[tuple[int, ...], ...]:
    """Convert groups of muscle names to groups of muscle indices."""
    return tuple(tuple(muscles.index(name) for name in group) for group in groups)
