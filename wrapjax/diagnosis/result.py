"""What a diagnosis found, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.effects.effect import NotTestable
from wrapjax.diagnosis.error_budget import Budget
from wrapjax.diagnosis.linearization import LinearizedModel

#: How a diagnosis can end.
#:
#: named
#:     One effect explains the error best, or several do together, each of them needed beside the others.
#: tie
#:     Several do that this recording cannot tell apart.
#: unknown
#:     Something is wrong with the model that no effect of the catalogue explains.
#: none
#:     Nothing that is larger than what such data show where nothing is amiss.
#: insufficient_data
#:     Too few cycles to tell what repeats from what does not.
#: not_converged
#:     The plain model was not fitted as well as it can be; what is left is the fit's.
OUTCOMES = ("named", "tie", "unknown", "none", "insufficient_data", "not_converged")


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval, or why there is none.

    Parameters
    ----------
    value, low, high
        NaN where there is a ``reason``.
    reason
        Why it cannot be told; empty where it can.
    """

    value: float
    low: float
    high: float
    reason: str = ""

    @property
    def known(self) -> bool:
        """Whether it can be told."""
        return not self.reason

    @classmethod
    def unknown(cls, reason: str) -> Estimate:
        """Say why it cannot be told."""
        return cls(np.nan, np.nan, np.nan, reason)


@dataclass(frozen=True)
class EffectSize:
    """How much of an effect there is, in physical units."""

    name: str
    value: float
    sd: float
    unit: str


@dataclass(frozen=True)
class EffectFinding:
    """What is said of one effect that this recording can test.

    Parameters
    ----------
    id
        Of the effect.
    probability
        Among all effects, nothing, and what is not in the catalogue; 0 to 1.
    evidence
        For it against no effect, nats.
    detectability
        In standard deviations, of an effect of expected size: below 2 this recording could not show it.
    decision
        A phrase: what to make of it.
    amounts
        Most plausible ones.
    negative_control
        It must stay quiet in such a recording.
    """

    id: str
    probability: float
    evidence: float
    detectability: float
    decision: str
    effect_sizes: tuple[EffectSize, ...]
    negative_control: bool = False


@dataclass(frozen=True)
class Released:
    """A calibrated parameter, before and after the effect was there to take its part.

    Parameters
    ----------
    label
        As ``soleus_l.emg_scale``.
    before, after, sd
        Solver units; the last is how far the calibration expects it to be from its mean.
    at_bound
        Whether it stood on a bound before.
    """

    label: str
    before: float
    after: float
    sd: float
    at_bound: bool


@dataclass(frozen=True)
class Alternative:
    """The model with an effect, fitted again together with all that is calibrated.

    Parameters
    ----------
    ids
        Of the effect, or of several at once.
    predicted
        Joint moments, N m; every cycle from a fit that has not seen it.
    held_out_cycles, held_out_speed
        Share of the explainable error that the effect removes there.
    gains
        By how much each left-out block of cycles became likelier, nats.
    speed_conflict
        Squared difference of the amounts fitted to each speed, in squared standard deviations; a wrong
        mechanism usually needs another amount for each. None where there is one speed.
    released
        What calibration had put in its place.
    """

    ids: tuple[str, ...]
    predicted: Float[np.ndarray, "cycle coordinate frame"]
    held_out_cycles: Estimate
    held_out_speed: Estimate
    gains: tuple[float, ...]
    speed_conflict: float | None
    released: tuple[Released, ...]


@dataclass(frozen=True)
class ConvergenceCheck:
    """Whether the plain model was fitted as well as it can be.

    Parameters
    ----------
    problems
        Sentences; none where it was.
    costs
        Where each start ended, lowest first.
    spread
        Of the two lowest: relative difference.
    decrement
        By how much the cost could still fall, as a share of the explainable error.
    conflicts
        By kind of parameter: how far fits to each speed (``by_speed``) and to each half of the cycles are
        apart, in standard deviations, root mean square.
    """

    problems: tuple[str, ...]
    costs: tuple[float, ...]
    spread: float
    decrement: float
    conflicts: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether a diagnosis may be built on it."""
        return not self.problems


@dataclass(frozen=True)
class Advice:
    """What would tell apart effects that this recording cannot.

    Parameters
    ----------
    splits
        Ids of the effects.
    experiment
        What to record.
    minutes
        In the laboratory.
    cycles
        How many would make one 20 times as likely as the other; None where that is not known.
    """

    splits: tuple[str, ...]
    experiment: str
    minutes: int
    cycles: int | None = None


@dataclass(frozen=True)
class MuscleShare:
    """Which muscle forces would take the error away, as far as moment arms can tell.

    Parameters
    ----------
    force
        Change of force, N; mean over the cycles of each speed.
    resolution
        0 where moment arms cannot tell this muscle's part, 1 where they tell all of it.
    """

    muscles: tuple[str, ...]
    force: Float[np.ndarray, "muscle speed phase"]
    resolution: Float[np.ndarray, " muscle"]


@dataclass(frozen=True)
class DiagnosisResult:
    """Where the error is, which effect explains it best, and how far it shrinks.

    Parameters
    ----------
    outcome
        One of `OUTCOMES`.
    reason
        A sentence for it.
    named, ties, credible_set
        Ids; see `wrapjax.diagnose`. The set may hold ``none_of_these``.
    effects
        All that could be tested, the most probable first.
    none_probability, unknown_probability
        Of nothing amiss, and of something that is not in the catalogue.
    not_testable, withheld
        Effects that this recording cannot show, and those left out of the catalogue on request.
    coordinates, trials, recordings, uses, speeds, time
        Names of coordinates and cycles, the recording each cycle is from, and what it was for; m/s (NaN:
        unknown); s.
    measured, plain
        Joint moments, N m, and what the plain model says of each cycle from fits that have not seen it.
    budget, budget_speeds
        The plain model's error split into parts, and the speed of each of its rows, m/s; None where cycles
        are too few.
    map
        Root mean square of the error that repeats, N m, by speed as the budget; empty where that is None.
    explainable_share
        Of the whole error.
    alternatives
        Effects that were fitted, the most probable first.
    shares
        Part of the explainable error that each accepted effect removes, Shapley's over all orders.
    likeness
        Ids, and how much of each effect (row) each other one (column) cannot imitate, in squared standard
        deviations.
    muscles
        None where it could not be told.
    alarm, global_p
        Evidence that data without any effect exceed in few cases, nats, and the share of those that
        exceed what was found.
    advice, certificate
        See there.
    seconds
        By part of the work.
    lines
        What effects were scored on; None where there is no diagnosis.
    """

    outcome: str
    reason: str
    named: tuple[str, ...]
    ties: tuple[tuple[str, ...], ...]
    credible_set: tuple[str, ...]
    effects: tuple[EffectFinding, ...]
    none_probability: float
    unknown_probability: float
    not_testable: tuple[NotTestable, ...]
    withheld: tuple[str, ...]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    recordings: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " cycle"]
    time: Float[np.ndarray, "cycle frame"]
    measured: Float[np.ndarray, "cycle coordinate frame"]
    plain: Float[np.ndarray, "cycle coordinate frame"]
    budget: Budget | None
    budget_speeds: Float[np.ndarray, " speed"]
    map: Float[np.ndarray, "speed coordinate bin"]
    explainable_share: Estimate
    alternatives: tuple[Alternative, ...]
    shares: dict[str, float]
    likeness: tuple[tuple[str, ...], Float[np.ndarray, "effect effect"]]
    muscles: MuscleShare | None
    detection_threshold: float
    global_p: float
    advice: tuple[Advice, ...]
    convergence_check: ConvergenceCheck
    seconds: dict[str, float]
    lines: LinearizedModel | None = None
