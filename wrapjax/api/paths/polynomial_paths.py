"""Polynomials as a source of paths: what each method frees of them, and how they run through the cycles."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.api.calibrating.assembly import coefficient_paths, model_parameters, surrogate_paths
from wrapjax.api.paths.exact import beside, engine_of, recorded
from wrapjax.api.paths.wrap_fit import WrapFit
from wrapjax.calibrate import PATH_CHANGE, path_modes
from wrapjax.errors import InputError, Problem
from wrapjax.geometry import (
    AdjustablePath,
    GuardedPaths,
    PathSurrogate,
    TwoLevelPaths,
    guarded_paths,
    two_level_paths,
)
from wrapjax.geometry.wrapped_paths import wrapped_paths
from wrapjax.model import Freedom, FreedWraps, ModelParameters, nga, with_paths
from wrapjax.subject import Subject, Trials

# Frames in which the engine guards polynomials: paths come to jump over several of them.
_GUARDED_EVERY = 4


def polynomial_freedom(
    method: str, subject: Subject, surrogate: PathSurrogate, touching: tuple[str, ...]
) -> Freedom:
    """Say what a method frees for a subject.

    NGA: nothing of the geometry. SGA: also all coefficients of all paths. LSGA: those of the muscles
    that lie on a wrapping surface in at least one recorded frame.
    """
    freedom = nga(model_parameters(subject))
    if method == "NGA":
        return freedom
    free = _own_modes(subject, surrogate)
    if method == "LSGA":
        free &= np.array([name in touching for name in subject.muscles.names])[:, None]
        if not free.any():
            raise InputError(
                Problem(
                    str(subject.model_file),
                    "no driven muscle touches a wrapping surface in the recorded cycles: LSGA frees nothing",
                    hint="use NGA or SGA",
                )
            )
    return with_paths(freedom, method, free, prior_sd=PATH_CHANGE)


def polynomial_paths(
    subject: Subject, trials: Trials, surrogate: PathSurrogate, freedom: Freedom
) -> AdjustablePath:
    """Evaluate the paths over cycles; where they are free they have their modes (see `path_modes`)."""
    modes = None if freedom.paths is None else modes_of(subject, surrogate)
    return surrogate_paths(surrogate, subject, trials, modes)


def modes_of(subject: Subject, surrogate: PathSurrogate) -> Float[np.ndarray, "muscle term mode"]:
    """Find the modes of the subject's paths over its calibration cycles (see `path_modes`)."""
    trials = subject.trials.used_for("calibration")
    used = np.asarray(surrogate.of_muscles(subject.muscles.names).used)
    muscles, terms = used.shape
    single = np.broadcast_to(np.eye(terms), (muscles, terms, terms))
    path = surrogate_paths(surrogate, subject, trials, single)
    return path_modes(path.nominal, path.modes, used, trials.moment_coordinates)


def _own_modes(subject: Subject, surrogate: PathSurrogate) -> Bool[np.ndarray, "muscle mode"]:
    """Mark the modes that a muscle has: as many as it has coefficients, the first ones."""
    used = np.asarray(surrogate.of_muscles(subject.muscles.names).used)
    return np.arange(used.shape[1])[None] < used.sum(axis=1)[:, None]


def wrapped_polynomial_paths(
    subject: Subject, trials: Trials, surrogate: PathSurrogate, wraps: WrapFit, freed: FreedWraps
) -> GuardedPaths:
    """Evaluate the paths over cycles, with coefficients that follow the freed cylinders.

    The exact engine guards them where they would jump.
    """
    engine = engine_of(subject)
    angles, velocities = recorded(trials, engine.coordinates)
    exact, _ = wrapped_paths(
        engine,
        angles[:, :, ::_GUARDED_EVERY],
        velocities[:, :, ::_GUARDED_EVERY],
        trials.moment_coordinates,
        freed.names,
        beside=beside(subject, trials, engine.coordinates)[:, :, ::_GUARDED_EVERY],
    )
    return guarded_paths(_two_level(subject, trials, surrogate, wraps, freed), exact, _GUARDED_EVERY)


def calibrated_polynomials(
    subject: Subject,
    surrogate: PathSurrogate,
    wraps: WrapFit | None,
    freedom: Freedom,
    parameters: ModelParameters,
) -> PathSurrogate:
    """Give the subject's polynomials with coefficients as a calibration left them.

    Parameters
    ----------
    subject, surrogate, wraps
        Whose paths, and how they follow cylinders, where that was sampled.
    freedom, parameters
        What was free, and what came of it. Where paths were held they stay as they are.
    """
    own = surrogate.of_muscles(subject.muscles.names)
    changes = parameters.path_changes
    coefficients = own.coefficients
    if freedom.paths is not None:
        coefficients = coefficients + jnp.einsum("mtk,mk->mt", modes_of(subject, surrogate), changes)
    elif freedom.wraps is not None and wraps is not None:
        moving = np.flatnonzero((freedom.wraps.places >= 0).any(axis=1))
        inner = wraps.inner_of([own.muscles[row] for row in moving], freedom.wraps.places.shape[1])
        coefficients = coefficients.at[moving].add(inner(changes[moving]))
    return replace(own, coefficients=coefficients)


def _two_level(
    subject: Subject, trials: Trials, surrogate: PathSurrogate, wraps: WrapFit, freed: FreedWraps
) -> TwoLevelPaths:
    muscles = subject.muscles.names
    nominal = surrogate_paths(surrogate, subject, trials).nominal
    moving = np.flatnonzero((freed.places >= 0).any(axis=1))
    names = [muscles[row] for row in moving]
    return two_level_paths(
        nominal,
        moving.tolist(),
        wraps.inner_of(names, freed.places.shape[1]),
        coefficient_paths(surrogate, names, trials),
        wraps.limits(muscles, freed.names),
    )
