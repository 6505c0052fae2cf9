"""How residuals differ from cycle to cycle: a covariance from the deviations within each speed.

Part of it are errors of what was recorded, run through the model: they join coordinates as muscles do. How
large those are is read off the deviations as well, and what they explain is not counted twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from wrapjax.gap.covariance import InputErrors, Matrix, input_blocks, periodic_kernel, within_cycles

#: Widths of the kernel that are tried, in gait cycles.
WIDTHS = (0.015, 0.025, 0.035, 0.05, 0.08)
#: Sizes of the errors of inputs that are tried, in what is expected of them.
INPUT_SHARES = (0.0, 0.35, 0.7, 1.0, 1.5, 2.2)
# Part of the variance that does not go on from phase to phase.
_WHITE = 0.02
# Deviations weigh so many cycles against coordinates that are independent: few cycles say little of
# correlations.
_PRIOR_CYCLES = 2.0
# Of the variance of a coordinate, at least so much is left for noise that no input makes.
_LEAST_NOISE = 0.05


@dataclass(frozen=True)
class CycleNoise:
    """Noise that is new in each cycle and goes on over its phases.

    Parameters
    ----------
    between
        Covariance of coordinates at one phase, (N m)^2, of what no input makes.
    width
        Over how much of a gait cycle that goes on alike.
    input_shares
        How large errors of each input are, in what is expected of them.
    """

    between: Float[np.ndarray, "coordinate coordinate"]
    width: float
    input_shares: tuple[float, ...] = ()

    def block(self, phases: int) -> Float[np.ndarray, "own own"]:
        """Give the covariance within one cycle, without errors of inputs."""
        return np.kron(self.between, _kernel(phases, self.width))

    def covariance(self, cycles: int, phases: int) -> Matrix:
        """Give the covariance of several cycles, without errors of inputs."""
        block = self.block(phases)
        return within_cycles(np.broadcast_to(block, (cycles, *block.shape)))


def cycle_noise(
    residuals: Float[np.ndarray, "cycle coordinate phase"],
    speeds: Int[np.ndarray, " cycle"],
    inputs: Sequence[InputErrors] = (),
) -> CycleNoise:
    """Estimate the noise from how cycles of one speed differ, by maximum likelihood.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    speeds
        Which speed each cycle was walked at, counted from 0; at least two cycles of one of them.
    inputs
        Errors of what was recorded, at their expected sizes.
    """
    counts = np.bincount(speeds)
    # Each cycle's deviation from its speed's mean is smaller than from the truth.
    scale = np.sqrt(counts / np.maximum(counts - 1.0, 1.0))[speeds]
    means = np.stack([residuals[speeds == speed].mean(axis=0) for speed in range(len(counts))])
    several = counts[speeds] > 1
    deviations = ((residuals - means[speeds]) * scale[:, None, None])[several]
    if not len(deviations):
        raise ValueError(f"cycles a speed: {counts.tolist()}; two of one are the fewest that show noise")
    blocks = [input_blocks(errors)[several] for errors in inputs]
    found = [
        _at(deviations, blocks, width, shares)
        for width in WIDTHS
        for shares in product(INPUT_SHARES, repeat=len(blocks))
    ]
    return max(found, key=lambda one: one[0])[1]


def _at(
    deviations: Float[np.ndarray, "cycle coordinate phase"],
    blocks: Sequence[Float[np.ndarray, "cycle own own"]],
    width: float,
    shares: tuple[float, ...],
) -> tuple[float, CycleNoise]:
    """Give the likelihood of a width and of sizes of input errors, with the noise that they leave."""
    cycles, coordinates, phases = deviations.shape
    kernel = _kernel(phases, width)
    inverse = np.linalg.inv(kernel)
    made = np.zeros((cycles, coordinates * phases, coordinates * phases))
    for share, block in zip(shares, blocks, strict=True):
        made += share**2 * block
    whole = np.einsum("ckp,pq,clq->kl", deviations, inverse, deviations) / (cycles * phases)
    of_inputs = np.einsum("ckplq,pq->kl", made.reshape(cycles, *(coordinates, phases) * 2), inverse)
    between = _positive(whole - of_inputs / (cycles * phases), np.diag(whole))
    independent = np.diag(np.diag(between))
    noise = CycleNoise(
        (cycles * between + _PRIOR_CYCLES * independent) / (cycles + _PRIOR_CYCLES), width, shares
    )
    if not blocks:
        # Alike in all cycles: of a Kronecker product, the determinant needs its factors alone.
        quadratic = cycles * phases * np.trace(np.linalg.solve(between, whole))
        logarithm = phases * np.linalg.slogdet(between)[1] + coordinates * np.linalg.slogdet(kernel)[1]
        return float(-0.5 * (quadratic + cycles * logarithm)), noise
    alone = np.kron(between, kernel)
    likelihood = 0.0
    for own, block in zip(deviations.reshape(cycles, -1), made, strict=True):
        factor = scipy.linalg.cholesky(alone + block, lower=True, check_finite=False)
        seen = scipy.linalg.solve_triangular(factor, own, lower=True, check_finite=False)
        likelihood -= 0.5 * float(seen @ seen) + float(np.sum(np.log(np.diag(factor))))
    return likelihood, noise


def _positive(
    between: Float[np.ndarray, "coordinate coordinate"], whole: Float[np.ndarray, " coordinate"]
) -> Float[np.ndarray, "coordinate coordinate"]:
    """Keep a covariance positive, and every coordinate's share of its whole variance."""
    scale = np.sqrt(whole)
    values, vectors = np.linalg.eigh(between / np.outer(scale, scale))
    kept = (vectors * np.maximum(values, _LEAST_NOISE)) @ vectors.T
    return np.asarray(kept * np.outer(scale, scale))


def _kernel(phases: int, width: float) -> Float[np.ndarray, "phase phase"]:
    return (1.0 - _WHITE) * periodic_kernel(phases, width) + _WHITE * np.eye(phases)
