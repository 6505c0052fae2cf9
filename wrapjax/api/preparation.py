"""From a subject to what a calibration minimises."""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.api.assembly import group_indices, model_parameters, recording, surrogate_paths
from wrapjax.api.fitting import Fit
from wrapjax.api.fitting import fit as fit_paths
from wrapjax.calibrate import PATH_CHANGE, Objective, path_limits, path_modes, pipeline_penalties
from wrapjax.errors import InputError, Problem
from wrapjax.model import Freedom, ModelParameters, free_variables, muscle_states, nga, with_paths
from wrapjax.muscle import HILL_CURVES
from wrapjax.precision import require_float64
from wrapjax.subject import Subject

#: Ways of adjusting a model, by the names of Ao, Fregly et al.
METHODS = ("NGA", "SGA", "LSGA")


def prepare(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | None = None,
    freedom: Freedom | None = None,
    *,
    curves: str = "paper",
) -> Objective:
    """Build what `calibrate` minimises.

    Parameters
    ----------
    subject
        From `load_subject`.
    method
        One of `METHODS`; ignored where ``freedom`` is given.
    fit
        From `wrapjax.fit`; made (or found in the cache) if not given.
    freedom
        What may move, with bounds and priors.
    curves
        Hill curves: ``paper`` or ``opensim``.
    """
    return stages(subject, method, fit, freedom, curves=curves)[-1]


def stages(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | None = None,
    freedom: Freedom | None = None,
    *,
    curves: str = "paper",
) -> tuple[Objective, ...]:
    """Build the problems that `calibrate` solves one after the other; the last is that of `prepare`.

    Where paths may change, a first problem holds them: the many coefficients then start near an
    optimum of the few parameters that every method frees.
    """
    require_float64()
    trials = subject.trials.used_for("calibration")
    if not trials.names:
        raise InputError(
            Problem(str(subject.folder / "subject.toml"), 'no trial is marked use = "calibration"')
        )
    fitted = fit_paths(subject) if fit is None else fit
    freedom = freedom or method_freedom(method, subject, fitted)
    modes = None if freedom.paths is None else modes_of(subject, fitted)
    inputs = recording(subject, trials, surrogate_paths(fitted.surrogate, subject, trials, modes))
    base = model_parameters(subject, path_modes=0 if modes is None else modes.shape[-1])
    names = subject.muscles.names
    reference = eqx.filter_jit(muscle_states)(HILL_CURVES[curves], base, inputs)
    held = Objective(
        curves=HILL_CURVES[curves],
        recording=inputs,
        measured=jnp.asarray(trials.moments),
        variables=free_variables(base, freedom.with_held_paths(), names),
        penalties=pipeline_penalties(
            reference,
            group_indices(subject.activation_groups, names),
            group_indices(subject.fiber_length_groups, names),
        ),
        limits=(),
    )
    if freedom.paths is None:
        return (held,)
    moving = eqx.tree_at(
        lambda problem: (problem.variables, problem.limits),
        held,
        (free_variables(base, freedom, names), path_limits(inputs.path.nominal)),
    )
    return held, moving


def objective(
    subject: Subject, method: str = "NGA", fit: Fit | None = None
) -> Callable[[ModelParameters], Float[Array, ""]]:
    """Give the calibration's cost as a pure jitted function of the parameter tree.

    Use it with `jax.grad`, `jax.jit` and `jax.vmap`; the tree to start from is
    ``prepare(subject, method).variables.base``.

    Examples
    --------
    >>> problem = prepare(subject, "SGA")  # doctest: +SKIP
    >>> slopes = jax.grad(objective(subject, "SGA"))(problem.variables.base)  # doctest: +SKIP
    """
    return eqx.filter_jit(prepare(subject, method, fit).cost)


def method_freedom(method: str, subject: Subject, fit: Fit) -> Freedom:
    """Say what a method frees for a subject.

    NGA: nothing of the geometry. SGA: also all coefficients of all paths. LSGA: those of the muscles
    that lie on a wrapping surface in at least one recorded frame.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method '{method}': expected one of {', '.join(METHODS)}")
    freedom = nga(model_parameters(subject))
    if method == "NGA":
        return freedom
    free = _own_modes(subject, fit)
    if method == "LSGA":
        free &= np.array([name in fit.touching for name in subject.muscles.names])[:, None]
        if not free.any():
            raise InputError(
                Problem(
                    str(subject.model_file),
                    "no driven muscle touches a wrapping surface in the recorded cycles: LSGA frees nothing",
                    hint="use NGA or SGA",
                )
            )
    return with_paths(freedom, method, free, prior_sd=PATH_CHANGE)


def modes_of(subject: Subject, fit: Fit) -> Float[np.ndarray, "muscle term mode"]:
    """Find the modes of the subject's paths over its calibration cycles (see `path_modes`)."""
    trials = subject.trials.used_for("calibration")
    used = np.asarray(fit.surrogate.of_muscles(subject.muscles.names).used)
    muscles, terms = used.shape
    single = np.broadcast_to(np.eye(terms), (muscles, terms, terms))
    path = surrogate_paths(fit.surrogate, subject, trials, single)
    return path_modes(path.nominal, path.modes, used, trials.moment_coordinates)


def _own_modes(subject: Subject, fit: Fit) -> Bool[np.ndarray, "muscle mode"]:
    """Mark the modes that a muscle has: as many as it has coefficients, the first ones."""
    used = np.asarray(fit.surrogate.of_muscles(subject.muscles.names).used)
    return np.arange(used.shape[1])[None] < used.sum(axis=1)[:, None]
