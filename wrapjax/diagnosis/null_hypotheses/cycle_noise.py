"""Noise that differs from cycle to cycle: its covariance, estimated from deviations within each speed.

A part of the deviations comes from errors of the recorded inputs through the model, which correlate joint
moments as muscles do. The sizes of these errors are estimated from the deviations as well, so that what they
explain is not counted twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from wrapjax.diagnosis.null_hypotheses.error_sources import InputErrors, Matrix, block_diagonal, input_blocks
from wrapjax.threads import map_in_threads

#: Sizes of the input errors that are tried, relative to the expected size.
INPUT_SHARES = (0.0, 0.35, 0.7, 1.0, 1.5, 2.2)
# Weight, in cycles, of a prior without correlation between coordinates: few cycles hold little information on
# correlations.
_PRIOR_CYCLES = 2.0
# Smallest share of the variance of a coordinate or harmonic that is left for noise that no input causes; and
# smallest power of a harmonic, relative to the mean: filters remove some harmonics completely, but no model
# is as exact.
_LEAST_NOISE, _LEAST_POWER = 0.05, 0.02
# Covariance and spectrum are estimated in alternation, which converges in two or three iterations.
_ITERATIONS = 4


@dataclass(frozen=True)
class CycleNoise:
    """Noise that is independent between cycles and stationary over the gait cycle.

    Parameters
    ----------
    between
        Covariance between coordinates at one phase, (N m)^2, of noise that no input causes.
    spectrum
        Power of each harmonic of the gait cycle, from the mean up; only ratios count. A kernel of one width
        does not fit what filters and a person's steps leave; where it is wrong, slow noise is overestimated
        and fast noise passes for an effect.
    input_shares
        Size of the errors of each input, relative to the expected size.
    """

    between: Float[np.ndarray, "coordinate coordinate"]
    spectrum: Float[np.ndarray, " harmonic"]
    input_shares: tuple[float, ...] = ()

    @property
    def independent_phases(self) -> float:
        """Number of independent values in a cycle with the same information on the variance."""
        power = _sine_and_cosine(self.spectrum)
        return float(power.sum() ** 2 / (power**2).sum())

    @property
    def independent_values(self) -> float:
        """Number of independent values in a cycle over all coordinates."""
        return self.independent_phases * len(self.between)

    def of_coordinates(self, coordinates: Int[np.ndarray, " kept"]) -> CycleNoise:
        """Select coordinates."""
        return replace(self, between=self.between[np.ix_(coordinates, coordinates)])

    def block(self, phases: int) -> Float[np.ndarray, "own own"]:
        """Compute the covariance within one cycle, without errors of inputs, (N m)^2."""
        return np.kron(self.between, _stationary_kernel(phases, self.spectrum))

    def covariance(self, cycles: int, phases: int) -> Matrix:
        """Compute the covariance of the moment noise of several cycles, without errors of inputs, (N m)^2."""
        block = self.block(phases)
        return block_diagonal(np.broadcast_to(block, (cycles, *block.shape)))


def cycle_noise(
    residuals: Float[np.ndarray, "cycle coordinate phase"],
    speeds: Int[np.ndarray, " cycle"],
    inputs: Sequence[InputErrors] = (),
) -> CycleNoise:
    """Estimate the noise from the deviations of cycles from the mean of their speed, by maximum likelihood.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    speeds
        Speed number of each cycle, counted from 0; at least one speed has two cycles.
    inputs
        Errors of recorded inputs, at their expected sizes.

    Raises
    ------
    ValueError
        If no speed has two cycles.
    """
    counts = np.bincount(speeds)
    # A deviation from the sample mean is smaller than that from the true mean.
    scale = np.sqrt(counts / np.maximum(counts - 1.0, 1.0))[speeds]
    means = np.stack([residuals[speeds == speed].mean(axis=0) for speed in range(len(counts))])
    repeated = counts[speeds] > 1
    deviations = ((residuals - means[speeds]) * scale[:, None, None])[repeated]
    if not len(deviations):
        raise ValueError(f"cycles at each speed: {counts.tolist()}; noise needs two cycles at one speed")
    blocks = [input_blocks(errors)[repeated] for errors in inputs]
    fits = map_in_threads(
        lambda shares: _fit(deviations, blocks, shares), list(product(INPUT_SHARES, repeat=len(blocks)))
    )
    return max(fits, key=lambda one: one[0])[1]


def _fit(
    deviations: Float[np.ndarray, "cycle coordinate phase"],
    blocks: Sequence[Float[np.ndarray, "cycle own own"]],
    shares: tuple[float, ...],
) -> tuple[float, CycleNoise]:
    """Fit the noise beside input errors of given sizes; return the log likelihood and the noise."""
    cycles, coordinates, phases = deviations.shape
    by_inputs = np.zeros((cycles, coordinates * phases, coordinates * phases))
    for share, block in zip(shares, blocks, strict=True):
        by_inputs += share**2 * block
    waves = np.fft.rfft(deviations)
    total = np.einsum("ckh,clh->hkl", waves, waves.conj()).real / (cycles * phases)
    least = _LEAST_NOISE * total
    between, spectrum = _separate(
        _at_least(total - _by_harmonic(by_inputs.mean(axis=0), coordinates), least), phases
    )
    rows = deviations.reshape(cycles, -1)
    for _ in range(_ITERATIONS if blocks else 0):
        # Expectation maximisation: the expected noise, given the deviations and this estimate, gives a better
        # estimate (Dempster, Laird & Rubin 1977).
        noise = np.kron(between, _stationary_kernel(phases, spectrum))
        precision = np.stack([_inverse(noise + block) for block in by_inputs])
        expected = np.einsum("cij,cj->ci", precision, rows) @ noise
        posterior = noise - noise @ precision.mean(axis=0) @ noise
        updated = _by_harmonic(posterior + expected.T @ expected / cycles, coordinates)
        between, spectrum = _separate(_at_least(updated, least), phases)
    independent = np.diag(np.diag(between))
    estimate = CycleNoise(
        (cycles * between + _PRIOR_CYCLES * independent) / (cycles + _PRIOR_CYCLES), spectrum, shares
    )
    noise = np.kron(between, _stationary_kernel(phases, spectrum))
    likelihood = 0.0
    for row, block in zip(rows, by_inputs, strict=True):
        factor = scipy.linalg.cholesky(noise + block, lower=True, check_finite=False)
        white = scipy.linalg.solve_triangular(factor, row, lower=True, check_finite=False)
        likelihood -= 0.5 * float(white @ white) + float(np.sum(np.log(np.diag(factor))))
    return likelihood, estimate


def _inverse(covariance: Float[np.ndarray, "own own"]) -> Float[np.ndarray, "own own"]:
    """Invert a covariance by its Cholesky factor, at a third of the cost of a general inverse."""
    factor = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    lower, _ = scipy.linalg.lapack.dpotri(factor, lower=True)
    return np.asarray(lower + np.tril(lower, -1).T)


def _by_harmonic(
    covariance: Float[np.ndarray, "own own"], coordinates: int
) -> Float[np.ndarray, "harmonic coordinate coordinate"]:
    """Compute the covariance between coordinates of each harmonic from the covariance within a cycle."""
    phases = len(covariance) // coordinates
    wave = np.fft.rfft(np.eye(phases))
    apart = covariance.reshape(coordinates, phases, coordinates, phases)
    return np.asarray(np.einsum("ph,kplq,qh->hkl", wave, apart, wave.conj(), optimize=True).real / phases)


def _separate(
    powers: Float[np.ndarray, "harmonic coordinate coordinate"], phases: int
) -> tuple[Float[np.ndarray, "coordinate coordinate"], Float[np.ndarray, " harmonic"]]:
    """Separate the powers of all harmonics into a covariance of coordinates and one spectrum.

    The likelihood is greatest where each is the mean of what the other leaves. A harmonic has the weight of
    its number of waves: two, but one for the mean and for the highest harmonic of an even number of phases.
    """
    waves = np.where((np.arange(len(powers)) == 0) | (2 * np.arange(len(powers)) == phases), 1.0, 2.0)
    spectrum = np.ones(len(powers))
    for _ in range(_ITERATIONS):
        between = np.einsum("h,hkl->kl", waves / spectrum, powers) / waves.sum()
        power = np.einsum("kl,hlk->h", np.linalg.inv(between), powers)
        # Neighbouring harmonics have similar power, so smoothing makes the estimate more precise; of
        # logarithms, as power falls steeply.
        ends = np.log(np.maximum(np.concatenate([power[:1], power, power[-1:]]), 1e-12 * power.max()))
        power = np.exp((ends[:-2] + 2.0 * ends[1:-1] + ends[2:]) / 4.0)
        spectrum = power * waves.sum() / (waves * power).sum()
    return between, np.maximum(spectrum, _LEAST_POWER) * waves / _sine_and_cosine(np.ones(len(powers)))


def _at_least(
    powers: Float[np.ndarray, "harmonic coordinate coordinate"],
    least: Float[np.ndarray, "harmonic coordinate coordinate"],
) -> Float[np.ndarray, "harmonic coordinate coordinate"]:
    """Keep each harmonic's covariance positive definite: no eigenvalue below 1 in units of ``least``."""
    floor = np.sqrt(np.einsum("hkk->hk", least))
    scale = floor[:, :, None] * floor[:, None, :]
    values, vectors = np.linalg.eigh(powers / scale)
    return np.asarray(np.einsum("hki,hi,hli->hkl", vectors, np.maximum(values, 1.0), vectors) * scale)


def _stationary_kernel(
    phases: int, spectrum: Float[np.ndarray, " harmonic"]
) -> Float[np.ndarray, "phase phase"]:
    """Compute the correlation between phases; positive definite with as many waves as phases."""
    power = _sine_and_cosine(spectrum)
    lag = np.subtract.outer(np.arange(phases), np.arange(phases)) / phases
    waves = np.cos(2.0 * np.pi * np.arange(len(spectrum)) * lag[..., None])
    return np.asarray(waves @ power / power.sum())


def _sine_and_cosine(spectrum: Float[np.ndarray, " harmonic"]) -> Float[np.ndarray, " harmonic"]:
    """Count each harmonic twice, for its sine and its cosine, and the mean once."""
    return spectrum * np.where(np.arange(len(spectrum)) == 0, 1.0, 2.0)
