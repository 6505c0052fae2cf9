"""Objective of a calibration from a subject, its muscle paths and a method; setup of one or two legs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.objective import MOMENT_ERROR, Objective
from wrapjax.calibration.path_penalties import feasibility_limits, path_limits, proximity_penalty
from wrapjax.calibration.penalties import pipeline_penalties
from wrapjax.calibration.sample_weights import moment_errors_by_weight
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.errors import InputError, Problem
from wrapjax.geometry.paths import AdjustablePath, PathState, fixed_path
from wrapjax.io.files import content_hash
from wrapjax.io.store import fingerprint
from wrapjax.jax_setup import require_float64
from wrapjax.model.alteration import tendon_alterations
from wrapjax.model.forward import muscle_states
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters, with_muscle_law, with_path_modes
from wrapjax.model.variables import Variables, free_variables
from wrapjax.muscle.curves import hill_curves
from wrapjax.muscle.published_laws import GIVEN_LAW
from wrapjax.path_sources.exact import SURFACES, ExactGeometry, exact_geometry
from wrapjax.path_sources.model_inputs import group_indices, model_parameters, recording
from wrapjax.path_sources.path_fitting import fit as fit_paths
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import STRATEGIES, apply_undriven_strategy, with_synergy_weights
from wrapjax.path_sources.wrap_fitting import fit_wraps
from wrapjax.subject.subject import Subject, read_legs
from wrapjax.subject.synergies import DEFAULT_SYNERGIES

#: Methods of calibration, by the names of Ao, Fregly et al.; see `wrapjax.calibrate`.
METHODS = ("NGA", "SGA", "LSGA", "PGA")


def build_objective(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    freedom: Freedom | None = None,
    *,
    curves: str = "paper",
    tendon: str = "rigid",
    muscle_law: str = GIVEN_LAW,
) -> Objective:
    """Build the objective that `calibrate` minimises for one leg.

    Parameters
    ----------
    subject
        Subject from `load_subject`.
    method
        Method, one of `METHODS` (see `calibrate`); ignored where ``freedom`` is given.
    fit
        Source of the muscle paths: polynomials from `wrapjax.fit`, computed or taken from the cache if not
        given, or paths from `wrapjax.exact_geometry`.
    freedom
        Custom selection of parameters, with bounds and priors.
    curves
        Hill curves: ``paper`` or ``opensim``.
    tendon
        Kind of tendon: ``rigid`` or ``compliant``.
    muscle_law
        Name of a published muscle law; see `wrapjax.muscle.published_laws`.

    Returns
    -------
    Objective
        Objective over the trials marked ``calibration``. Its variables are in solver units; ``parameters``
        and ``start`` convert between them and the parameter tree.

    Raises
    ------
    InputError
        If no trial is marked ``calibration``, or the method has nothing to free.
    ValueError
        If the method, the kind of tendon or the muscle law is unknown.

    Examples
    --------
    >>> problem = build_objective(subject, "NGA")  # doctest: +SKIP
    >>> variables = problem.start(problem.initial)  # doctest: +SKIP
    >>> problem.linearize(variables).gradient  # doctest: +SKIP
    """
    return build_stages(subject, method, fit, freedom, curves=curves, tendon=tendon, muscle_law=muscle_law)[
        -1
    ]


def build_stages(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    freedom: Freedom | None = None,
    *,
    curves: str = "paper",
    tendon: str = "rigid",
    muscle_law: str = GIVEN_LAW,
) -> tuple[Objective, ...]:
    """Build the objectives that `calibrate` minimises one after the other; the last is `build_objective`'s.

    Where paths may change, a first stage holds them, so that the many path variables start near an optimum of
    the parameters that every method frees. Its shape is the same for all methods, so that functions compiled
    for one serve the others. Parameters are those of `build_objective`.
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
    base = with_muscle_law(model_parameters(subject), muscle_law, curves)
    names = subject.muscles.names
    alterations = tendon_alterations(tendon, len(names))
    reference = eqx.filter_jit(muscle_states)(hill_curves(curves), base, inputs, alterations)
    errors = moment_errors_by_weight(trials)
    held = Objective(
        curves=hill_curves(curves),
        recording=inputs,
        measured=jnp.asarray(np.nan_to_num(trials.moments)),
        variables=free_variables(base, freedom.with_held_paths(), names),
        penalties=pipeline_penalties(
            reference,
            group_indices(subject.activation_groups, names),
            group_indices(subject.fiber_length_groups, names),
            range(len(subject.muscle_channels), len(names)),
            tuple(place for place, task in enumerate(trials.tasks) if task == "passive"),
        ),
        limits=(),
        alterations=alterations,
        moment_error=np.array(MOMENT_ERROR) if errors is None else errors,
    )
    if freedom.paths is None and freedom.wraps is None:
        return (held,)
    moving = replace(
        held,
        recording=replace(inputs, path=paths),
        variables=free_variables(with_path_modes(base, paths.modes_count), freedom, names),
    )
    if freedom.wraps is None:
        assert isinstance(paths, AdjustablePath), "paths with free coefficients are linear in them"
        crossing = crossing_variables(paths, moving.variables)
        return held, replace(moving, limits=path_limits(paths.nominal), crossing_variables=crossing)
    proximity = () if paths.nominal.proximity is None else (proximity_penalty(len(names)),)
    moving = replace(
        moving, penalties=(*held.penalties, *proximity), limits=feasibility_limits(paths.nominal)
    )
    return held, moving


def crossing_variables(paths: AdjustablePath, variables: Variables) -> tuple[tuple[int, ...], ...]:
    """Find the variables of the muscles with a moment arm about each coordinate."""
    nominal = (np.asarray(paths.nominal.moment_arm) != 0.0).any(axis=(1, 3))
    changed = (np.asarray(paths.modes.moment_arm) != 0.0).any(axis=(1, 2, 4))
    crosses = nominal | changed
    return tuple(tuple(np.setdiff1d(variables.index[own], variables.count).tolist()) for own in crosses.T)


def fit_for_methods(
    methods: Sequence[str],
    subject: Subject,
    geometry: str = "opensim",
    *,
    seed: int = 0,
    processes: int | None = None,
    quiet: bool = True,
) -> Fit:
    """Fit the polynomials that several methods need, or take them from the cache.

    If PGA is one of the methods, the polynomials depend on wrap parameters and are fitted to paths of the
    exact engine: half a million analyses take it minutes, and OpenSim hours (`wrapjax.fit_wraps` supports
    both).

    Parameters
    ----------
    methods
        Methods, of `METHODS`.
    subject
        Subject from `load_subject`.
    geometry
        Source of lengths and moment arms for methods other than PGA; see `wrapjax.fit`.
    seed, processes, quiet
        See `wrapjax.fit`.

    Returns
    -------
    Fit
        Polynomial paths, with ``wraps`` for PGA.
    """
    with_wraps = "PGA" in methods
    source = "engine" if with_wraps else geometry
    fitted = fit_paths(subject, source, seed=seed, processes=processes, quiet=quiet)
    return fit_wraps(subject, fitted, processes=processes, quiet=quiet) if with_wraps else fitted


def matching_path_source(fit: Fit | ExactGeometry, subject: Subject) -> Fit | ExactGeometry:
    """Build a path source for a subject of the same kind as an existing one, as that of the other leg."""
    if isinstance(fit, ExactGeometry):
        if fit.bones is None:
            return exact_geometry(subject, fit.name)
        return exact_geometry(
            subject, fit.name, bone_folders=fit.bones.folders, bone_distance=fit.bones.distance
        )
    fitted = fit_paths(subject, fit.geometry)
    if fit.wraps is None:
        return fitted
    if any(quality.near_bone_share is not None for quality in fit.wraps.quality.values()):
        raise InputError(
            Problem(
                str(subject.folder),
                "the first leg's surfaces stay near bones by its fit, which has no bones of this leg",
                hint="calibrate the legs one by one, without other_leg, or fit without bones",
            )
        )
    return fit_wraps(subject, fitted, thresholds=fit.wraps.thresholds)


def objective(
    subject: Subject, method: str = "NGA", fit: Fit | ExactGeometry | None = None
) -> Callable[[ModelParameters], Float[Array, ""]]:
    """Return the cost of a calibration as a pure, compiled function of the parameter tree.

    Use it with `jax.grad`, `jax.jit` and `jax.vmap`. The initial parameter tree is
    ``build_objective(subject, method).variables.base``.

    Parameters
    ----------
    subject, method, fit
        See `build_objective`.

    Returns
    -------
    Callable
        Function from `ModelParameters` to the cost (dimensionless scalar), without hard limits.

    Raises
    ------
    InputError, ValueError
        See `build_objective`.

    Examples
    --------
    >>> problem = build_objective(subject, "SGA")  # doctest: +SKIP
    >>> slopes = jax.grad(objective(subject, "SGA"))(problem.variables.base)  # doctest: +SKIP
    """
    return eqx.filter_jit(build_objective(subject, method, fit).cost)


def method_freedom(
    method: str, subject: Subject, fit: Fit | ExactGeometry, surfaces: str = SURFACES[0]
) -> Freedom:
    """Build the freedom of a method for a subject.

    Parameters
    ----------
    method
        Method, one of `METHODS`.
    subject
        Subject with its muscles.
    fit
        Source of the muscle paths.
    surfaces
        Wraps that PGA frees, one of `SURFACES`.

    Raises
    ------
    InputError
        If the method has nothing to free.
    ValueError
        If the method or ``surfaces`` is unknown.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method '{method}': expected one of {', '.join(METHODS)}")
    if surfaces not in SURFACES:
        raise ValueError(f"unknown surfaces '{surfaces}': expected one of {', '.join(SURFACES)}")
    return with_synergy_weights(fit.freedom(method, subject, surfaces), subject)


@dataclass(frozen=True)
class LegSetup:
    """Inputs of the calibration of one leg: subject, source of the muscle paths, and freedom."""

    subject: Subject
    fit: Fit | ExactGeometry
    freedom: Freedom


def build_leg_setups(
    subject: Subject,
    fit: Fit | ExactGeometry | None,
    method: str,
    freedom: Freedom | None,
    undriven: str = STRATEGIES[0],
    synergies: int = DEFAULT_SYNERGIES,
    surfaces: str = SURFACES[0],
) -> list[LegSetup]:
    """Build the setups of the legs that are calibrated together: the subject's, and its ``other_leg`` if any.

    Parameters
    ----------
    subject
        Subject to calibrate.
    fit
        Source of the subject's muscle paths; None to fit polynomials or take them from the cache. The paths
        of the other leg come from a source of the same kind.
    method
        Method, one of `METHODS`; ignored where ``freedom`` is given.
    freedom
        Custom freedom, for one leg alone.
    undriven, synergies
        See `apply_undriven_strategy`.
    surfaces
        Wraps that PGA frees, one of `SURFACES`.

    Returns
    -------
    list of LegSetup
        One or two legs, the subject's first.

    Raises
    ------
    ValueError
        If a custom freedom is given for two legs.
    InputError
        If the fit is not one of the subject, or the method has nothing to free.
    """
    subjects = read_legs(subject)
    if len(subjects) == 2 and freedom is not None:
        raise ValueError("a custom freedom is for one leg alone: remove other_leg from subject.toml")
    legs = []
    for read in subjects:
        leg = apply_undriven_strategy(read, undriven, synergies)
        given = fit if read is subject else None
        if isinstance(given, ExactGeometry) and given.engine.muscles != leg.muscles.names:
            given = None  # built before the undriven muscles were added
        if isinstance(given, Fit) and leg is not read:
            given.require_subject(leg, "fit")
        fitted = given or (fit_for_methods((method,), leg) if fit is None else matching_path_source(fit, leg))
        free = (
            with_synergy_weights(freedom, leg) if freedom else method_freedom(method, leg, fitted, surfaces)
        )
        legs.append(LegSetup(leg, fitted, free))
    return legs


@dataclass(frozen=True)
class MuscleOptions:
    """Muscle model of a calibration: names of the Hill curves, the kind of tendon and the muscle law.

    Raises
    ------
    ValueError
        If there are no such curves.
    """

    curves: str = "paper"
    tendon: str = "rigid"
    law: str = GIVEN_LAW

    def __post_init__(self):
        hill_curves(self.curves)


def calibration_fingerprint(
    legs: list[LegSetup], solver: AugmentedLagrangian, options: MuscleOptions, starts: int, seed: int
) -> str:
    """Compute the fingerprint of a calibration."""
    # Curves of one's own may change under one name.
    curves = hill_curves(options.curves)
    coefficients = map(np.asarray, jax.tree.leaves(eqx.filter(curves, eqx.is_array_like)))
    muscle_model = content_hash(str(type(curves)), *coefficients)
    inputs = (*map(_hash_of_leg, legs), repr((solver, options, starts, seed)), muscle_model)
    return fingerprint(*inputs, module="wrapjax.calibration.calibration")


def _hash_of_leg(leg: LegSetup) -> str:
    """Compute the hash of a leg's inputs to a calibration."""
    subject, trials = leg.subject, leg.subject.trials
    return content_hash(
        subject.model_file,
        leg.fit.key,
        repr(subject.muscles),
        trials.moments,
        trials.emg,
        trials.angles,
        repr((trials.names, trials.uses, trials.moment_coordinates, subject.muscle_channels)),
        repr((trials.tasks, trials.given_samples, trials.leading)),
        repr((subject.activation_groups, subject.fiber_length_groups)),
        repr(leg.freedom),
        *(() if subject.synergies is None else (repr(subject.synergies.basis),)),
    )
