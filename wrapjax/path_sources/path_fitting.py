"""Fitting of polynomials to the length and moment arms of a subject's muscle paths (``fit``)."""

from __future__ import annotations

import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.geometry.exact_paths.engine import ExactPaths, Wrapping, nominal_parameters, wrap_at_samples
from wrapjax.geometry.surrogates.surrogate import PathSurrogate, fit_surrogate
from wrapjax.io.files import content_hash
from wrapjax.io.store import Store, fingerprint
from wrapjax.jax_setup import require_float64
from wrapjax.osim.model import describe_model, spanned_coordinates
from wrapjax.osim.muscle_analysis import PathGeometry, analyse_muscles, touching_muscles
from wrapjax.path_sources.exact import WRAPPINGS
from wrapjax.path_sources.path_samples import fit_poses
from wrapjax.path_sources.polynomial_fit import Fit, PathError, read_fit
from wrapjax.subject.subject import Subject

#: Sources of the lengths and moment arms to which polynomials are fitted.
GEOMETRIES = ("opensim", *WRAPPINGS)


def fit(
    subject: Subject,
    geometry: str = "opensim",
    *,
    seed: int = 0,
    processes: int | None = None,
    quiet: bool = True,
) -> Fit:
    """Fit polynomials in the coordinates to the length and moment arms of every driven muscle.

    This is the outer level of the surrogate, which suffices for NGA, SGA and LSGA. For PGA the coefficients
    must also depend on wrap parameters: pass the result to `wrapjax.fit_wraps`, which takes a thousand times
    as many path evaluations.

    The training poses are 400 random poses near the recorded cycles and 100 frames of the fastest cycle;
    errors are evaluated in 500 other random poses.

    Parameters
    ----------
    subject
        Subject from `load_subject`.
    geometry
        Source of lengths and moment arms: ``opensim`` (muscle analysis of OpenSim), ``engine`` (exact engine,
        shortest paths) or ``engine-parity`` (exact engine, paths as in OpenSim 4.6).
    seed
        Seed of the random poses.
    processes
        Number of worker processes for OpenSim; by default one per core.
    quiet
        Print no progress.

    Returns
    -------
    Fit
        Polynomials with their errors (mm), also stored in the user's cache, from which the same fit is read
        again.

    Raises
    ------
    InputError
        If a muscle's path has an element that the exact engine does not support.
    ValueError
        If the geometry is unknown.

    Examples
    --------
    >>> fitted = fit(subject, "engine")  # doctest: +SKIP
    >>> fitted.errors["soleus_l"].moment_arm_rmse_mm  # doctest: +SKIP
    >>> fitted.save("fit", subject=subject)  # doctest: +SKIP
    """
    require_float64()
    if geometry not in GEOMETRIES:
        raise ValueError(f"unknown geometry '{geometry}': expected one of {', '.join(GEOMETRIES)}")
    key = _key(subject, geometry, seed)
    store = Store.of_user("fit")
    if (known := store.read(key, read_fit)) is not None:
        return known
    result = _fit(subject, geometry, key, seed, processes, quiet)
    result.write_to_cache(store.place(key))
    return result


def _key(subject: Subject, geometry: str, seed: int) -> str:
    trials = subject.trials
    settings_hash = fingerprint(
        repr(subject.muscles.names),
        repr(trials.coordinates),
        trials.angles,
        trials.time,
        geometry,
        seed,
        module=__name__,
    )
    return f"{content_hash(subject.model_file)}-{settings_hash}"


def _fit(subject: Subject, geometry: str, key: str, seed: int, processes: int | None, quiet: bool) -> Fit:
    muscles = subject.muscles.names
    spans = spanned_coordinates(subject.model_file, muscles)
    # Coordinates that were not recorded have the default values of the model.
    recorded = subject.trials.coordinates
    coordinates = tuple(name for name in recorded if any(name in spans[one] for one in muscles))
    poses = fit_poses(subject, coordinates, seed)
    model = describe_model(subject.model_file)
    started = time.perf_counter()
    both = np.concatenate([poses.training, poses.validation])
    if geometry == "opensim":
        analysed = analyse_muscles(
            subject.model_file, muscles, coordinates, both, processes=processes, quiet=quiet
        )
    else:
        engine = ExactPaths(model, muscles, coordinates)
        analysed, _ = _analyse_by_engine(engine, both, WRAPPINGS[geometry])
    analysed_at = time.perf_counter()
    count = len(poses.training)
    surrogate = fit_surrogate(
        muscles, coordinates, spans, poses.training, analysed.length[:count], analysed.moment_arm[:count]
    )
    fitted_at = time.perf_counter()
    if geometry == "opensim":
        touching = touching_muscles(subject.model_file, muscles, coordinates, poses.recorded)
    else:
        _, touching = _analyse_by_engine(engine, poses.recorded, WRAPPINGS[geometry])
    touched_at = time.perf_counter()
    wrapped = {muscle.name: bool(muscle.wraps) for muscle in model.muscles}
    return Fit(
        key=key,
        surrogate=surrogate,
        errors=path_errors(surrogate, poses.validation, analysed, slice(count, None), wrapped),
        touching=touching,
        seconds={
            "analysis": analysed_at - started,
            "fit": fitted_at - analysed_at,
            "contact": touched_at - fitted_at,
        },
        geometry=geometry,
        seed=seed,
    )


def _analyse_by_engine(
    engine: ExactPaths, poses: Float[np.ndarray, "pose coordinate"], wrapping: Wrapping
) -> tuple[PathGeometry, tuple[str, ...]]:
    """Compute all paths with nominal wraps, and list the muscles that touch a wrap in some pose."""
    found = {
        name: wrap_at_samples(posed, nominal_parameters(len(engine.wraps_of(name)))[None], wrapping)
        for name, posed in engine.posed(poses).items()
    }
    length = np.stack([path.length[0] for path in found.values()], axis=-1)
    moment_arm = np.stack([path.moment_arm[0] for path in found.values()], axis=-1)
    touching = tuple(name for name, path in found.items() if path.touching.any())
    return PathGeometry(engine.muscles, engine.coordinates, length, moment_arm), touching


def path_errors(
    surrogate: PathSurrogate,
    poses: np.ndarray,
    reference: PathGeometry,
    rows: slice,
    wrapped: dict[str, bool],
) -> dict[str, PathError]:
    """Compute the errors of a surrogate muscle by muscle.

    Errors of moment arms are pooled over the poses and the coordinates that the muscle spans.

    Parameters
    ----------
    surrogate
        Polynomials to evaluate.
    poses
        Poses of shape (pose, coordinate), rad or m.
    reference
        Lengths and moment arms to compare with, m.
    rows
        Rows of ``reference`` that belong to ``poses``.
    wrapped
        Whether each muscle has wraps.
    """
    grid = jnp.asarray(poses.T[None])
    path = eqx.filter_jit(surrogate)(grid, jnp.zeros_like(grid))
    length_error = np.asarray(path.length)[:, 0] - reference.length[rows].T
    arm_error = np.asarray(path.moment_arm)[:, 0] - np.transpose(reference.moment_arm[rows], (2, 1, 0))
    return {
        muscle: PathError.of(
            length_error[index],
            arm_error[index, surrogate.slots(muscle)],
            wrapped=wrapped[muscle],
            terms=int(np.asarray(surrogate.used[index]).sum()),
        )
        for index, muscle in enumerate(surrogate.muscles)
    }
