"""Muscle synergies of measured EMG, from which the excitations of muscles without an electrode are estimated.

The scores of the first principal components of all measured channels are the synergy commands; the excitation
of a muscle without an electrode is a weighted sum of them (Ao et al. 2020, doi:10.3389/fncom.2020.588943).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

#: Default number of synergies, as in the NMSM Pipeline.
DEFAULT_SYNERGIES = 5


@dataclass(frozen=True)
class SynergyBasis:
    """Principal components of a subject's EMG.

    Parameters
    ----------
    channels
        Measured channels.
    largest
        Maximum of each channel over the cycles of the fit, by which EMG is divided.
    mean
        Mean of each channel after the division.
    components
        Unit vectors over channels, in decreasing order of variance.
    explained
        Share of the variance that each component explains.
    """

    channels: tuple[str, ...]
    largest: Float[np.ndarray, " channel"]
    mean: Float[np.ndarray, " channel"]
    components: Float[np.ndarray, "component channel"]
    explained: Float[np.ndarray, " component"]

    @property
    def count(self) -> int:
        """Number of weights of an estimated excitation: one for each component, and one for the constant."""
        return len(self.components) + 1

    def commands(
        self, emg: Float[np.ndarray, "trial channel frame"], channels: tuple[str, ...]
    ) -> Float[np.ndarray, "trial command frame"]:
        """Compute the synergy commands of EMG: the scores of the components, then a constant 1.

        Cycles that were not part of the fit are projected on the same components, so that weights have the
        same meaning in all cycles.

        Parameters
        ----------
        emg
            Envelopes, dimensionless.
        channels
            Names of the channels of ``emg``, which must include those of the basis.
        """
        selected = emg[:, [channels.index(name) for name in self.channels]]
        centered = selected / self.largest[:, None] - self.mean[:, None]
        scores = np.einsum("kc,tcf->tkf", self.components, centered)
        return np.concatenate([scores, np.ones_like(scores[:, :1])], axis=1)


@dataclass(frozen=True)
class Synergies:
    """Excitation of muscles without an electrode by synergies.

    Parameters
    ----------
    basis
        Principal components that give the synergy commands.
    groups
        Muscles that share each estimated excitation, by its name; each muscle has its own delay and scale.
    """

    basis: SynergyBasis
    groups: dict[str, tuple[str, ...]]

    @property
    def muscles(self) -> tuple[str, ...]:
        """All muscles, group by group."""
        return tuple(muscle for members in self.groups.values() for muscle in members)


def fit_synergies(
    emg: Float[np.ndarray, "trial channel frame"], channels: tuple[str, ...], count: int
) -> SynergyBasis:
    """Compute the principal components of EMG over all frames of all cycles.

    Channels are divided by their maximum and centered, and the entry of largest magnitude of each component
    is positive, as in the NMSM Pipeline (MATLAB's ``pca``).

    Parameters
    ----------
    emg
        Envelopes of the calibration cycles, dimensionless.
    channels
        Names of the channels.
    count
        Number of components, at most the number of channels.

    Raises
    ------
    ValueError
        If the number of components is out of range.
    """
    if not 1 <= count <= len(channels):
        raise ValueError(
            f"expected 1 to {len(channels)} synergies of {len(channels)} channels, found {count}"
        )
    largest = emg.max(axis=(0, 2))
    largest = np.where(largest > 0.0, largest, 1.0)
    rows = np.moveaxis(emg / largest[:, None], 1, 2).reshape(-1, len(channels))
    mean = rows.mean(axis=0)
    _, sizes, components = np.linalg.svd(rows - mean, full_matrices=False)
    strongest = components[np.arange(len(components)), np.abs(components).argmax(axis=1)]
    components = components * np.where(strongest < 0.0, -1.0, 1.0)[:, None]
    total = np.square(sizes).sum()
    explained = np.square(sizes) / total if total > 0.0 else np.zeros_like(sizes)
    return SynergyBasis(channels, largest, mean, components[:count], explained[:count])
