"""Advice on the next recording, where a recording cannot tell effects apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.experiments import EXPERIMENTS, Experiment

#: Squared distance of two effects, in squared standard deviations, at which one is 20 times as likely as the
#: other: the evidence of 3 nats is half of it.
_SEPARATING_DISTANCE = 6.0


@dataclass(frozen=True)
class Advice:
    """Experiment that would tell apart effects that a recording cannot.

    Parameters
    ----------
    splits
        Identifiers of the effects; empty where it tells more of each, but no two apart.
    experiment
        What to record.
    minutes
        Duration in the laboratory.
    cycles
        Number of cycles that would make one effect 20 times as likely as the other; None if not known.
    information
        Information on what is undecided that it adds to what is known and the trials before it, nats; None
        if it was not simulated.
    """

    splits: tuple[str, ...]
    experiment: str
    minutes: int
    cycles: int | None = None
    information: float | None = None


def effects_by_experiment() -> dict[Experiment, tuple[str, ...]]:
    """List the identifiers of the effects that each experiment shows."""
    shows: dict[Experiment, tuple[str, ...]] = dict.fromkeys(EXPERIMENTS, ())
    for definition in CATALOGUE.values():
        if definition.experiment is not None:
            shows[definition.experiment] = (*shows.get(definition.experiment, ()), definition.id)
    return shows


def advise(tie: Sequence[str], least_apart: float, cycles: int) -> Advice | None:
    """Find the shortest experiment that tells members of a tie apart; None if there is no such experiment.

    An experiment that would show all members of the tie does not tell them apart.

    Parameters
    ----------
    tie
        Identifiers of effects that the recording cannot tell apart.
    least_apart
        Squared distance of the two most similar effects over all cycles, in squared standard deviations.
    cycles
        Number of these cycles.
    """
    shows = effects_by_experiment()
    for experiment in sorted(shows, key=lambda experiment: experiment.minutes):
        shown = set(shows[experiment]) & set(tie)
        if shown and shown != set(tie):
            more = ceil(_SEPARATING_DISTANCE * cycles / least_apart) if least_apart > 0.0 else None
            return Advice(tuple(tie), experiment.text, experiment.minutes, more)
    return None
