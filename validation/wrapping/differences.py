"""Tables of differences of lengths and moment arms, by cause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Differences:
    """Differences between two computations of the same paths.

    Parameters
    ----------
    name
        What was compared.
    length
        Difference of length, m; NaN where OpenSim's length is none.
    moment_arm
        Largest difference of a moment arm, m (m/rad) or, about a translation, 1.
    limit
        Largest difference of length that counts as agreement, m.
    """

    name: str
    length: Float[np.ndarray, " path"]
    moment_arm: Float[np.ndarray, " path"]
    limit: float

    @property
    def beyond(self) -> Bool[np.ndarray, " path"]:
        """Paths whose lengths differ by more than the limit."""
        return self.length > self.limit

    def row(self) -> str:
        """Format a row of the table."""
        known = np.isfinite(self.length)
        # Sometimes OpenSim gives a length and no moment arm.
        length, arm = self.length[known], self.moment_arm[known & np.isfinite(self.moment_arm)]
        numbers = [
            f"{function(values):.1e}"
            for values in (length, arm)
            for function in (np.median, lambda one: np.percentile(one, 99), np.max)
        ]
        return (
            f"| {self.name} | {len(self.length)} | {' | '.join(numbers)} | {self.limit:.0e} | "
            f"{int(self.beyond.sum())} | {int((~known).sum())} |"
        )


_TITLES = (
    *("paths", "number", "length: median, m", "99th percentile", "worst"),
    *("arm: median", "99th percentile", "worst", "limit, m", "beyond it", "OpenSim gives none"),
)
#: Head of the table.
HEAD = f"| {' | '.join(_TITLES)} |\n|{'---|' * len(_TITLES)}"
