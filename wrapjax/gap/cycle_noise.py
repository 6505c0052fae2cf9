"""How residuals differ from cycle to cycle: a covariance from the deviations within each speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from wrapjax.gap.covariance import Matrix, periodic_kernel, within_cycles

#: Widths of the kernel that are tried, in gait cycles.
WIDTHS = (0.015, 0.025, 0.035, 0.05, 0.08)
# Part of the variance that does not go on from phase to phase.
_WHITE = 0.02
# Deviations weigh so many cycles against coordinates that are independent: few cycles say little of
# correlations.
_PRIOR_CYCLES = 2.0


@dataclass(frozen=True)
class CycleNoise:
    """Noise that is new in each cycle and goes on over its phases.

    Parameters
    ----------
    between
        Covariance of coordinates at one phase, (N m)^2.
    width
        Over how much of a gait cycle noise goes on alike.
    """

    between: Float[np.ndarray, "coordinate coordinate"]
    width: float

    def block(self, phases: int) -> Float[np.ndarray, "own own"]:
        """Give the covariance within one cycle."""
        return np.kron(self.between, _kernel(phases, self.width))

    def covariance(self, cycles: int, phases: int) -> Matrix:
        """Give the covariance of several cycles."""
        block = self.block(phases)
        return within_cycles(np.broadcast_to(block, (cycles, *block.shape)))


def cycle_noise(
    residuals: Float[np.ndarray, "cycle coordinate phase"], speeds: Int[np.ndarray, " cycle"]
) -> CycleNoise:
    """Estimate the noise from how cycles of one speed differ, by maximum likelihood.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    speeds
        Which speed each cycle was walked at, counted from 0; at least two cycles of one of them.
    """
    counts = np.bincount(speeds)
    # Each cycle's deviation from its speed's mean is smaller than from the truth.
    scale = np.sqrt(counts / np.maximum(counts - 1.0, 1.0))[speeds]
    means = np.stack([residuals[speeds == speed].mean(axis=0) for speed in range(len(counts))])
    deviations = (residuals - means[speeds]) * scale[:, None, None]
    deviations = deviations[counts[speeds] > 1]
    if not len(deviations):
        raise ValueError(f"cycles a speed: {counts.tolist()}; two of one are the fewest that show noise")
    return max((_at_width(deviations, width) for width in WIDTHS), key=lambda found: found[0])[1]


def _at_width(
    deviations: Float[np.ndarray, "cycle coordinate phase"], width: float
) -> tuple[float, CycleNoise]:
    """Give the profile likelihood of a width and the covariance of coordinates that goes with it."""
    cycles, coordinates, phases = deviations.shape
    kernel = _kernel(phases, width)
    whitened = np.einsum("ckp,pq,clq->kl", deviations, np.linalg.inv(kernel), deviations)
    between = whitened / (cycles * phases)
    logarithm = np.linalg.slogdet(between)[1]
    likelihood = -0.5 * cycles * (phases * logarithm + coordinates * np.linalg.slogdet(kernel)[1])
    independent = np.diag(np.diag(between))
    shrunk = (cycles * between + _PRIOR_CYCLES * independent) / (cycles + _PRIOR_CYCLES)
    return float(likelihood), CycleNoise(shrunk, width)


def _kernel(phases: int, width: float) -> Float[np.ndarray, "phase phase"]:
    return (1.0 - _WHITE) * periodic_kernel(phases, width) + _WHITE * np.eye(phases)
