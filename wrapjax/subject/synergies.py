"""Synergies of measured EMG: what muscles without an electrode are taken to be driven by.

The first principal components of all measured channels are *commands*; EMG that nobody measured is sought as
their weighted sum (Ao et al. 2020, doi:10.3389/fncom.2020.588943).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

#: Commands where nobody asks for another number: the NMSM Pipeline's.
COMMANDS = 5


@dataclass(frozen=True)
class SynergyBasis:
    """Principal components of a person's EMG.

    Parameters
    ----------
    channels
        Measured ones.
    largest
        Of each channel in the cycles that the components are of: EMG is divided by it.
    mean
        Of each channel after that.
    components
        Unit vectors over channels, those of most variance first.
    explained
        Part of the variance that each component has.
    """

    channels: tuple[str, ...]
    largest: Float[np.ndarray, " channel"]
    mean: Float[np.ndarray, " channel"]
    components: Float[np.ndarray, "component channel"]
    explained: Float[np.ndarray, " component"]

    @property
    def count(self) -> int:
        """How many weights say what an unmeasured muscle gets: one a component, and one of the constant."""
        return len(self.components) + 1

    def commands(
        self, emg: Float[np.ndarray, "trial channel frame"], channels: tuple[str, ...]
    ) -> Float[np.ndarray, "trial command frame"]:
        """Read the commands off EMG: scores of the components, then 1 throughout.

        Cycles that the components were not found in are read by the same ones, so that weights mean the
        same in all of them.

        Parameters
        ----------
        emg
            Envelopes, without unit.
        channels
            Their names; among them all that the components are of.
        """
        own = emg[:, [channels.index(name) for name in self.channels]]
        centered = own / self.largest[:, None] - self.mean[:, None]
        scores = np.einsum("kc,tcf->tkf", self.components, centered)
        return np.concatenate([scores, np.ones_like(scores[:, :1])], axis=1)


@dataclass(frozen=True)
class Synergies:
    """How muscles without an electrode are driven.

    Parameters
    ----------
    basis
        Of the commands.
    groups
        By the name of an excitation, the muscles that have it. Every one has its own delay and scale.
    """

    basis: SynergyBasis
    groups: dict[str, tuple[str, ...]]

    @property
    def muscles(self) -> tuple[str, ...]:
        """All of them, group by group."""
        return tuple(muscle for members in self.groups.values() for muscle in members)


def fit_synergies(
    emg: Float[np.ndarray, "trial channel frame"], channels: tuple[str, ...], count: int
) -> SynergyBasis:
    """Find the principal components of EMG over all frames of all cycles.

    Channels are divided by their largest value and freed of their mean, as the NMSM Pipeline does (MATLAB's
    ``pca``). Of each component's two signs that one is taken whose largest entry is positive, as there.

    Parameters
    ----------
    emg
        Envelopes, without unit, of the cycles to calibrate on.
    channels
        Their names.
    count
        How many components; at most as many as there are channels.
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
