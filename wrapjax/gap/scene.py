"""What is known once effects are scored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.gap.effect import Effect
from wrapjax.gap.held_out import CrossFit
from wrapjax.gap.linearized import LinearGap
from wrapjax.gap.result import Certificate
from wrapjax.gap.score import Candidate, Score, Scored
from wrapjax.gap.verdict import Tuning
from wrapjax.gap.where import Where

if TYPE_CHECKING:
    from wrapjax.gap.investigation import Investigation


@dataclass(frozen=True)
class Scene:
    """What is known once effects are scored.

    Parameters
    ----------
    case
        What is looked at.
    effects
        By id, over the calibration cycles.
    gap, sizes
        Straight lines, and standard deviations of measured moments (N m).
    plain, place, certificate
        The plain model: fits to parts of the cycles, what they leave, and whether they are good enough.
    amount_weight
        What a squared prior standard deviation costs in a refit.
    scored, strongest_of_twins
        Of the subject, and the strongest evidence in each person with nothing amiss.
    tuning
        Constants of the verdict.
    """

    case: Investigation
    effects: dict[str, Effect]
    gap: LinearGap
    sizes: Float[np.ndarray, " coordinate"]
    plain: CrossFit
    place: Where
    certificate: Certificate
    amount_weight: float
    scored: Scored
    strongest_of_twins: Float[np.ndarray, " twin"]
    tuning: Tuning

    @property
    def candidates(self) -> dict[str, Candidate]:
        """By id."""
        return {candidate.id: candidate for candidate in self.gap.candidates}

    @property
    def scores(self) -> dict[str, Score]:
        """By id, the strongest evidence first."""
        return {one.id: one for one in sorted(self.scored.scores, key=lambda one: -one.evidence)}
