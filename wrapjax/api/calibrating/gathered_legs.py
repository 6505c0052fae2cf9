"""The legs that are calibrated together, each with its muscle paths and what is free of it."""

from __future__ import annotations

from dataclasses import dataclass

from wrapjax.api.calibrating.extrapolation import STRATEGIES, drive, with_weights
from wrapjax.api.calibrating.problem import method_freedom, source_for, source_like
from wrapjax.api.paths.cylinders import SURFACES
from wrapjax.api.paths.exact import ExactGeometry
from wrapjax.api.paths.fitting import Fit
from wrapjax.calibrate import AugmentedLagrangian
from wrapjax.files import code_hash, content_hash
from wrapjax.model import Freedom
from wrapjax.subject import Subject, read_legs
from wrapjax.subject.synergies import COMMANDS


@dataclass(frozen=True)
class Leg:
    """A leg to calibrate: whose, by which paths, and what may move."""

    subject: Subject
    fit: Fit | ExactGeometry
    freedom: Freedom


def gather_legs(
    subject: Subject,
    fit: Fit | ExactGeometry | None,
    method: str,
    freedom: Freedom | None,
    undriven: str = STRATEGIES[0],
    synergies: int = COMMANDS,
    surfaces: str = SURFACES[0],
) -> list[Leg]:
    """Gather what is calibrated together: the subject's leg, and the other one if it is named."""
    subjects = read_legs(subject)
    if len(subjects) == 2 and freedom is not None:
        raise ValueError("a freedom of one's own is for one leg: take other_leg out of subject.toml")
    legs = []
    for read in subjects:
        leg = drive(read, undriven, synergies)
        given = fit if read is subject else None
        if isinstance(given, ExactGeometry) and given.engine.muscles != leg.muscles.names:
            given = None  # made before these muscles were driven
        if isinstance(given, Fit) and leg is not read:
            given.refuse_others(leg, "fit")
        fitted = given or (source_for((method,), leg) if fit is None else source_like(fit, leg))
        free = with_weights(freedom, leg) if freedom else method_freedom(method, leg, fitted, surfaces)
        legs.append(Leg(leg, fitted, free))
    return legs


@dataclass(frozen=True)
class Law:
    """Of muscles: the names of their Hill curves and tendons."""

    curves: str = "paper"
    tendon: str = "rigid"


def question_of(legs: list[Leg], solver: AugmentedLagrangian, law: Law, starts: int, seed: int) -> str:
    """Name a calibration by all that decides where it goes."""
    return content_hash(code_hash(), *map(_question, legs), repr((solver, law, starts, seed)))


def _question(leg: Leg) -> str:
    """Name a leg's part in a calibration by all that decides where it goes."""
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
