"""Result of the search for the trials that would tell most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.protocol.detectability import Detection
from wrapjax.diagnosis.protocol.trials import CandidateTrial


@dataclass(frozen=True)
class AdvisedTrial:
    """A trial and what it adds to the recorded cycles and the trials before it.

    Parameters
    ----------
    trial
        The trial.
    information
        Information on what is undecided that it adds, nats.
    expected_evidence
        Expected log Bayes factor of an undecided effect of its prior size, with this trial and those before
        it: the median over effects, weighted by their probability, nats.
    detected
        How well effects can be seen and told apart with it and those before it.
    splits
        Pairs of effects that cannot be told apart before it and can with it.
    """

    trial: CandidateTrial
    information: float
    expected_evidence: float
    detected: Detection
    splits: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class ProtocolResult:
    """The trials that would tell most.

    Parameters
    ----------
    name
        Name of the subject or the model.
    basis
        What had been recorded, in words.
    effects
        Identifiers of the effects.
    weights
        How undecided each effect is; sums to one.
    before
        How well effects can be seen and told apart without further trials.
    expected_before
        As `AdvisedTrial.expected_evidence`, without further trials.
    advised
        The best trial, the best one after it, and so on.
    considered
        All trials with the information that each adds alone, nats, most first.
    seconds
        Computing time, s.
    """

    name: str
    basis: str
    effects: tuple[str, ...]
    weights: Float[np.ndarray, " effect"]
    before: Detection
    expected_before: float
    advised: tuple[AdvisedTrial, ...]
    considered: tuple[tuple[CandidateTrial, float], ...]
    seconds: float

    @property
    def after(self) -> Detection:
        """How well effects can be seen and told apart with all advised trials."""
        return self.advised[-1].detected if self.advised else self.before
