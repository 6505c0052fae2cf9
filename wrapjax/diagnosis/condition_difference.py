"""Result of a comparison of two conditions of one person."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.condition_contrast import Contrast, Direction, strongest
from wrapjax.diagnosis.effects.effect import Effect, NotTestable
from wrapjax.diagnosis.score_test import Score
from wrapjax.subject.subject import Subject


@dataclass(frozen=True)
class DifferenceResult:
    """What differs between two conditions of one person.

    Parameters
    ----------
    subject
        Subject with the trials of both conditions.
    conditions
        Names of the condition that is compared, and of the one that it is compared with.
    cycles
        Number of calibration cycles of each condition at the speeds that both have.
    coordinates
        Names of the coordinates.
    speeds
        Speeds that both conditions have, m/s; NaN where unknown.
    measured_difference
        Mean measured moment of the first condition less that of the second, N m.
    contrast
        Difference of the residuals, and the evidence for each effect of one condition alone.
    effects
        Effects by id.
    not_testable
        Effects that cannot be tested, with reasons.
    """

    subject: Subject
    conditions: tuple[str, str]
    cycles: tuple[int, int]
    coordinates: tuple[str, ...]
    speeds: Float[np.ndarray, " speed"]
    measured_difference: Float[np.ndarray, "speed coordinate phase"]
    contrast: Contrast
    effects: dict[str, Effect]
    not_testable: tuple[NotTestable, ...]

    @property
    def leading(self) -> tuple[tuple[Score, Direction], ...]:
        """Effects above the threshold and within 3 nats of the strongest, the strongest first."""
        chosen = strongest(self.contrast.scores, self.contrast.threshold)
        return tuple((self.contrast.scores[place], self.contrast.directions[place]) for place in chosen)

    @property
    def outcome(self) -> str:
        """``none`` if no effect of one condition is above the threshold, ``named`` for one, else ``tie``."""
        names = {direction.id for _, direction in self.leading}
        return ("none", "named", "tie")[min(len(names), 2)]
