"""Legs to calibrate, each with its muscle paths and freedom, and the fingerprint of a calibration."""

from __future__ import annotations

from dataclasses import dataclass

from wrapjax.calibration.problem import fit_for_methods, matching_path_source, method_freedom
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.io.files import code_hash, content_hash
from wrapjax.model.freedom import Freedom
from wrapjax.path_sources.exact import ExactGeometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import STRATEGIES, apply_undriven_strategy, with_synergy_weights
from wrapjax.path_sources.wrap_freedom import SURFACES
from wrapjax.subject.subject import Subject, read_legs
from wrapjax.subject.synergies import DEFAULT_SYNERGIES


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
        Method, one of `wrapjax.calibration.problem.METHODS`; ignored where ``freedom`` is given.
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
    """Muscle model of a calibration: names of the Hill curves and of the kind of tendon."""

    curves: str = "paper"
    tendon: str = "rigid"


def calibration_fingerprint(
    legs: list[LegSetup], solver: AugmentedLagrangian, options: MuscleOptions, starts: int, seed: int
) -> str:
    """Compute the hash of everything that determines the result of a calibration."""
    return content_hash(code_hash(), *map(_fingerprint, legs), repr((solver, options, starts, seed)))


def _fingerprint(leg: LegSetup) -> str:
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
        repr((subject.activation_groups, subject.fiber_length_groups)),
        repr(leg.freedom),
        *(() if subject.synergies is None else (repr(subject.synergies.basis),)),
    )
