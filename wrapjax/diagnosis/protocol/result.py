"""Result of the search for the trials that would tell most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.claims.advice import Advice
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
        How well effects can be detected and distinguished with it and those before it.
    splits
        Pairs of effects that cannot be distinguished before it and can with it.
    """

    trial: CandidateTrial
    information: float
    expected_evidence: float
    detected: Detection
    splits: tuple[tuple[str, str], ...]

    @property
    def conditions(self) -> str:
        """Effort, and the angles of the joints that are held, in words."""
        held = ", ".join(f"{name} {value:g} deg" for name, value in self.trial.posture.items())
        return f"{self.trial.effort}{'; held: ' + held if held else ''}"

    @property
    def advice(self) -> Advice:
        """The trial as the advice of a diagnosis."""
        return Advice(
            splits=tuple(dict.fromkeys(id for pair in self.splits for id in pair)),
            experiment=f"{self.trial.what} ({self.conditions})",
            minutes=self.trial.minutes,
            information=self.information,
        )


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
        How well effects can be detected and distinguished without further trials.
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
        """How well effects can be detected and distinguished with all advised trials."""
        return self.advised[-1].detected if self.advised else self.before
