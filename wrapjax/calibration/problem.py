"""From a subject to what a calibration minimises."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.path_penalties import feasibility_limits, path_limits, proximity_penalty
from wrapjax.calibration.penalties import pipeline_penalties
from wrapjax.errors import InputError, Problem
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.jax_setup import require_float64
from wrapjax.model.alteration import tendon_alterations
from wrapjax.model.forward import muscle_states
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters, with_path_modes
from wrapjax.model.variables import free_variables
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.path_sources.exact import SURFACES, ExactGeometry, exact_geometry
from wrapjax.path_sources.model_inputs import group_indices, model_parameters, recording
from wrapjax.path_sources.path_fitting import fit as fit_paths
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import with_synergy_weights
from wrapjax.path_sources.wrap_fitting import fit_wraps
from wrapjax.subject.subject import Subject

#: Ways of adjusting a model, by the names of Ao, Fregly et al.
METHODS = ("NGA", "SGA", "LSGA", "PGA")


def build_objective(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    freedom: Freedom | None = None,
    *,
    curves: str = "paper",
    tendon: str = "rigid",
) -> Objective:
    """Build what `calibrate` minimises.

    Parameters
    ----------
    subject
        From `load_subject`.
    method
        One of `METHODS`; ignored where ``freedom`` is given.
    fit
        Source of the muscle paths: from `wrapjax.fit` (polynomials), made or found in the cache if not
        given; or from `wrapjax.exact_geometry`.
    freedom
        What may move, with bounds and priors.
    curves
        Hill curves: ``paper`` or ``opensim``.
    tendon
        ``rigid`` or ``compliant`` (`wrapjax.model.TENDONS`).
    """
    return build_stages(subject, method, fit, freedom, curves=curves, tendon=tendon)[-1]


def build_stages(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    freedom: Freedom | None = None,
    *,
    curves: str = "paper",
    tendon: str = "rigid",
) -> tuple[Objective, ...]:
    """Build the problems that `calibrate` solves one after the other; the last is that of `build_objective`.

    Where paths may change, a first problem holds them: the many coefficients then start near an
    optimum of the few parameters that every method frees. It is of one shape for all methods, so that what is
    compiled for one serves the others.
    """
    require_float64()
    trials = subject.trials.used_for("calibration")
    if not trials.names:
        raise InputError(
            Problem(str(subject.folder / "subject.toml"), 'no trial is marked use = "calibration"')
        )
    fitted = fit_for_methods((method,), subject) if fit is None else fit
    freedom = with_synergy_weights(freedom, subject) if freedom else method_freedom(method, subject, fitted)
    paths = fitted.paths(subject, trials, freedom)
    nominal = PathState(paths.nominal.length, paths.nominal.velocity, paths.nominal.moment_arm)
    inputs = recording(subject, trials, fixed_path(nominal))
    base = model_parameters(subject)
    names = subject.muscles.names
    alterations = tendon_alterations(tendon, len(names))
    reference = eqx.filter_jit(muscle_states)(HILL_CURVES[curves], base, inputs, alterations)
    held = Objective(
        curves=HILL_CURVES[curves],
        recording=inputs,
        measured=jnp.asarray(trials.moments),
        variables=free_variables(base, freedom.with_held_paths(), names),
        penalties=pipeline_penalties(
            reference,
            group_indices(subject.activation_groups, names),
            group_indices(subject.fiber_length_groups, names),
            range(len(subject.muscle_channels), len(names)),
        ),
        limits=(),
        alterations=alterations,
    )
    if freedom.paths is None and freedom.wraps is None:
        return (held,)
    moving = replace(
        held,
        recording=replace(inputs, path=paths),
        variables=free_variables(with_path_modes(base, paths.modes_count), freedom, names),
    )
    if freedom.wraps is None:
        return held, replace(moving, limits=path_limits(paths.nominal))
    kept = () if paths.nominal.proximity is None else (proximity_penalty(len(names)),)
    moving = replace(moving, penalties=(*held.penalties, *kept), limits=feasibility_limits(paths.nominal))
    return held, moving


def fit_for_methods(
    methods: Sequence[str],
    subject: Subject,
    geometry: str = "opensim",
    *,
    seed: int = 0,
    processes: int | None = None,
    quiet: bool = True,
) -> Fit:
    """Make the polynomials that serve all of these methods, or find them in the cache.

    Where PGA is among them they know how they follow cylinders, and are made from the exact engine's
    paths: half a million analyses take it minutes, and OpenSim hours (`wrapjax.fit_wraps` does either).

    Parameters
    ----------
    methods
        Of `METHODS`.
    subject
        From `load_subject`.
    geometry
        Whose paths they are fitted to where PGA is not among the methods; as of `wrapjax.fit`.
    seed, processes, quiet
        As of `wrapjax.fit`.
    """
    knows_cylinders = "PGA" in methods
    source = "engine" if knows_cylinders else geometry
    fitted = fit_paths(subject, source, seed=seed, processes=processes, quiet=quiet)
    return fit_wraps(subject, fitted, processes=processes, quiet=quiet) if knows_cylinders else fitted


def matching_path_source(fit: Fit | ExactGeometry, subject: Subject) -> Fit | ExactGeometry:
    """Take a subject's paths from where another's, the other leg's for example, come from."""
    if isinstance(fit, ExactGeometry):
        return exact_geometry(subject, fit.name)
    fitted = fit_paths(subject, fit.geometry)
    return fitted if fit.wraps is None else fit_wraps(subject, fitted)


def objective(
    subject: Subject, method: str = "NGA", fit: Fit | ExactGeometry | None = None
) -> Callable[[ModelParameters], Float[Array, ""]]:
    """Give the calibration's cost as a pure jitted function of the parameter tree.

    Use it with `jax.grad`, `jax.jit` and `jax.vmap`; the tree to start from is
    ``build_objective(subject, method).variables.base``.

    Examples
    --------
    >>> problem = build_objective(subject, "SGA")  # doctest: +SKIP
    >>> slopes = jax.grad(objective(subject, "SGA"))(problem.variables.base)  # doctest: +SKIP
    """
    return eqx.filter_jit(build_objective(subject, method, fit).cost)


def method_freedom(
    method: str, subject: Subject, fit: Fit | ExactGeometry, surfaces: str = SURFACES[0]
) -> Freedom:
    """Say what a method frees for a subject, of the paths from this source; `SURFACES` are PGA's."""
    if method not in METHODS:
        raise ValueError(f"unknown method '{method}': expected one of {', '.join(METHODS)}")
    if surfaces not in SURFACES:
        raise ValueError(f"unknown surfaces '{surfaces}': expected one of {', '.join(SURFACES)}")
    return with_synergy_weights(fit.freedom(method, subject, surfaces), subject)
