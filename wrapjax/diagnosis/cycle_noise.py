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

from wrapjax.diagnosis.null_covariance import InputErrors, Matrix, input_blocks, within_cycles

#: Sizes of the errors of inputs that are tried, in what is expected of them.
INPUT_SHARES = (0.0, 0.35, 0.7, 1.0, 1.5, 2.2)
# Deviations weigh so many cycles against coordinates that are independent: few cycles say little of
# correlations.
_PRIOR_CYCLES = 2.0
# Of the variance of a coordinate or a harmonic, at least so much is left for noise that no input makes; and
# so much of the mean power for every harmonic: filters leave nothing of some, and no model is as exact.
_LEAST_NOISE, _LEAST_POWER = 0.05, 0.02
# Covariance and spectrum are found in turn: they settle in two or three.
_TURNS = 4


@dataclass(frozen=True)
class CycleNoise:
    """Noise that is new in each cycle, alike at all its phases.

    Parameters
    ----------
    between
        Covariance of coordinates at one phase, (N m)^2, of what no input makes.
    spectrum
        Power of each harmonic of the gait cycle, from its mean up; only their ratios count. The kernel of no
        one width fits what a laboratory's filters and a person's steps leave, and where it is wrong, slow
        noise is taken for more than it is and fast noise for an effect.
    input_shares
        How large errors of each input are, in what is expected of them.
    """

    between: Float[np.ndarray, "coordinate coordinate"]
    spectrum: Float[np.ndarray, " harmonic"]
    input_shares: tuple[float, ...] = ()

    @property
    def independent_phases(self) -> float:
        """Number of independent values in a cycle that tell as much of its variance."""
        power = _both_ways(self.spectrum)
        return float(power.sum() ** 2 / (power**2).sum())

    @property
    def independent_values(self) -> float:
        """The same over all coordinates."""
        return self.independent_phases * len(self.between)

    def block(self, phases: int) -> Float[np.ndarray, "own own"]:
        """Give the covariance within one cycle, without errors of inputs."""
        return np.kron(self.between, _kernel(phases, self.spectrum))

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
    found = [_at(deviations, blocks, shares) for shares in product(INPUT_SHARES, repeat=len(blocks))]
    return max(found, key=lambda one: one[0])[1]


def _at(
    deviations: Float[np.ndarray, "cycle coordinate phase"],
    blocks: Sequence[Float[np.ndarray, "cycle own own"]],
    shares: tuple[float, ...],
) -> tuple[float, CycleNoise]:
    """Give the likelihood of sizes of input errors, with the noise that they leave."""
    cycles, coordinates, phases = deviations.shape
    made = np.zeros((cycles, coordinates * phases, coordinates * phases))
    for share, block in zip(shares, blocks, strict=True):
        made += share**2 * block
    waves = np.fft.rfft(deviations)
    whole = np.einsum("ckh,clh->hkl", waves, waves.conj()).real / (cycles * phases)
    least = _LEAST_NOISE * whole
    between, spectrum = _settled(
        _no_less(whole - _by_harmonic(made.mean(axis=0), coordinates), least), phases
    )
    rows = deviations.reshape(cycles, -1)
    for _ in range(_TURNS if blocks else 0):
        # What is expected of the noise, given deviations and this guess, is a better guess (Dempster, Laird &
        # Rubin 1977).
        alone = np.kron(between, _kernel(phases, spectrum))
        precision = np.stack([_inverse(alone + block) for block in made])
        expected = np.einsum("cij,cj->ci", precision, rows) @ alone
        spread = alone - alone @ precision.mean(axis=0) @ alone
        again = _by_harmonic(spread + expected.T @ expected / cycles, coordinates)
        between, spectrum = _settled(_no_less(again, least), phases)
    independent = np.diag(np.diag(between))
    noise = CycleNoise(
        (cycles * between + _PRIOR_CYCLES * independent) / (cycles + _PRIOR_CYCLES), spectrum, shares
    )
    alone = np.kron(between, _kernel(phases, spectrum))
    likelihood = 0.0
    for own, block in zip(rows, made, strict=True):
        factor = scipy.linalg.cholesky(alone + block, lower=True, check_finite=False)
        seen = scipy.linalg.solve_triangular(factor, own, lower=True, check_finite=False)
        likelihood -= 0.5 * float(seen @ seen) + float(np.sum(np.log(np.diag(factor))))
    return likelihood, noise


def _inverse(covariance: Float[np.ndarray, "own own"]) -> Float[np.ndarray, "own own"]:
    """Invert by Cholesky's factors: a third of the work of any other matrix."""
    factor = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    lower, _ = scipy.linalg.lapack.dpotri(factor, lower=True)
    return np.asarray(lower + np.tril(lower, -1).T)


def _by_harmonic(
    covariance: Float[np.ndarray, "own own"], coordinates: int
) -> Float[np.ndarray, "harmonic coordinate coordinate"]:
    """Say what a covariance within a cycle puts into each harmonic."""
    phases = len(covariance) // coordinates
    wave = np.fft.rfft(np.eye(phases))
    apart = covariance.reshape(coordinates, phases, coordinates, phases)
    return np.asarray(np.einsum("ph,kplq,qh->hkl", wave, apart, wave.conj(), optimize=True).real / phases)


def _settled(
    powers: Float[np.ndarray, "harmonic coordinate coordinate"], phases: int
) -> tuple[Float[np.ndarray, "coordinate coordinate"], Float[np.ndarray, " harmonic"]]:
    """Split the powers of all harmonics into a covariance of coordinates and one spectrum for all of them.

    The likelihood is greatest where each is the mean of what the other leaves. Harmonics weigh as their
    number of waves: two, of a cycle's mean and of what turns at every phase one.
    """
    waves = np.where((np.arange(len(powers)) == 0) | (2 * np.arange(len(powers)) == phases), 1.0, 2.0)
    spectrum = np.ones(len(powers))
    for _ in range(_TURNS):
        between = np.einsum("h,hkl->kl", waves / spectrum, powers) / waves.sum()
        power = np.einsum("kl,hlk->h", np.linalg.inv(between), powers)
        # Neighbours are alike, and together better known; logarithms, as power falls steeply.
        ends = np.log(np.maximum(np.concatenate([power[:1], power, power[-1:]]), 1e-12 * power.max()))
        power = np.exp((ends[:-2] + 2.0 * ends[1:-1] + ends[2:]) / 4.0)
        spectrum = power * waves.sum() / (waves * power).sum()
    return between, np.maximum(spectrum, _LEAST_POWER) * waves / _both_ways(np.ones(len(powers)))


def _no_less(
    powers: Float[np.ndarray, "harmonic coordinate coordinate"],
    least: Float[np.ndarray, "harmonic coordinate coordinate"],
) -> Float[np.ndarray, "harmonic coordinate coordinate"]:
    """Keep every harmonic's covariance positive: no coordinate of it less than the diagonal of ``least``."""
    floor = np.sqrt(np.einsum("hkk->hk", least))
    scale = floor[:, :, None] * floor[:, None, :]
    values, vectors = np.linalg.eigh(powers / scale)
    return np.asarray(np.einsum("hki,hi,hli->hkl", vectors, np.maximum(values, 1.0), vectors) * scale)


def _kernel(phases: int, spectrum: Float[np.ndarray, " harmonic"]) -> Float[np.ndarray, "phase phase"]:
    """Correlation between phases: positive definite where there are as many waves as phases."""
    power = _both_ways(spectrum)
    lag = np.subtract.outer(np.arange(phases), np.arange(phases)) / phases
    turns = np.cos(2.0 * np.pi * np.arange(len(spectrum)) * lag[..., None])
    return np.asarray(turns @ power / power.sum())


def _both_ways(spectrum: Float[np.ndarray, " harmonic"]) -> Float[np.ndarray, " harmonic"]:
    """Count each harmonic for its sine and its cosine, the mean once."""
    return spectrum * np.where(np.arange(len(spectrum)) == 0, 1.0, 2.0)
