"""Signatures of all catalogued effects for one person, with their largest d*."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from validation.blind.effects import EFFECTS
from validation.blind.effects.effect import Effect, Variant
from validation.blind.oracle import TIE, Oracle, difference, flat
from validation.blind.world import World
from validation.blind.worlds import WorldSettings

#: Share of an effect's largest amount at which its signature is computed.
SHARE = 0.4
#: Relative cutoff of the pseudo-inverse.
_RANK = 1e-6


@dataclass(frozen=True)
class Library:
    """Signatures of one person.

    ``signals`` are the signatures, (sample, entry) in N m; ``reach`` is the largest d* of each entry, (level,
    entry).
    """

    entries: tuple[tuple[str, Variant], ...]
    signals: np.ndarray
    reach: np.ndarray

    def save(self, path: Path) -> None:
        words = np.array(["/".join((name, *variant)) for name, variant in self.entries])
        np.savez(path, entries=words, signals=self.signals.astype(np.float32), reach=self.reach)

    @staticmethod
    def load(path: Path) -> Library:
        with np.load(path) as data:
            entries = tuple((w.split("/")[0], tuple(w.split("/")[1:])) for w in data["entries"].tolist())
            return Library(entries, data["signals"].astype(float), data["reach"])

    def of(self, name: str) -> np.ndarray:
        return np.array([index for index, (entry, _) in enumerate(self.entries) if entry == name], int)


def library_file(bank: Path, person: int) -> Path:
    """Return the library file of a person, by number."""
    return bank / "library" / f"{person:02d}.npz"


def library_of(bank: Path, name: str) -> Library:
    """Load the library of a person, by the name in the truth of a case."""
    return Library.load(library_file(bank, int(name.rsplit("_", 1)[-1])))


def variants_in(effect: Effect, settings: WorldSettings) -> tuple[Variant, ...]:
    """Return the variants of an effect that are not about a channel that is not recorded."""
    # Variants do not depend on the person.
    every = effect.variants(None)  # type: ignore[arg-type]
    return tuple(variant for variant in every if not set(variant) & set(settings.emg.unrecorded))


def entries_of(world: World) -> list[tuple[Effect, Variant]]:
    return [
        (effect, variant) for effect in EFFECTS.values() for variant in variants_in(effect, world.settings)
    ]


def build_library(world: World, oracles: dict[float, Oracle]) -> Library:
    entries = entries_of(world)
    columns = [
        flat(world, difference(world, effect, SHARE * effect.most, variant)[1]) for effect, variant in entries
    ]
    signals = np.stack(columns, axis=1)
    reach = np.stack(
        [
            np.sqrt(np.maximum(np.einsum("ij,ij->j", signals, oracles[level].whiten(signals)), 0.0)) / SHARE
            for level in world.settings.emg.levels
        ]
    )
    return Library(tuple((effect.id, variant) for effect, variant in entries), signals, reach)


def imitations(
    library: Library, oracle: Oracle, own: str, signal: np.ndarray
) -> dict[str, tuple[float, float]]:
    """Compute how well each other effect can imitate a signal, and the reverse.

    Parameters
    ----------
    library
        Signatures of the person.
    oracle
        Covariance of everything that is not an effect.
    own
        Effect that causes the signal; it is omitted.
    signal
        Signal, (sample,).

    Returns
    -------
    dict
        For each other effect: the squared standard deviations of the signal that its signatures cannot fit,
        and those of its best fit that ``own`` (its signatures and the signal itself) cannot fit.
    """
    whitened = oracle.whiten(library.signals)
    gram = library.signals.T @ whitened
    cross = whitened.T @ signal
    strength = float(signal @ oracle.whiten(signal))
    own_entries = library.of(own) if own in EFFECTS else np.array([], int)
    residuals = {}
    for name in EFFECTS:
        if name == own:
            continue
        index = library.of(name)
        inner = _pseudo_inverse(gram[np.ix_(index, index)])
        mix = inner @ cross[index]
        explained = float(mix @ cross[index])
        # The reverse: the best imitation minus its fit by the own signatures and the signal.
        best = library.signals[:, index] @ mix
        back = np.concatenate(
            [whitened[:, own_entries].T @ best, [float(signal @ (whitened[:, index] @ mix))]]
        )
        own_gram = np.block(
            [
                [gram[np.ix_(own_entries, own_entries)], cross[own_entries][:, None]],
                [cross[own_entries][None], np.array([[strength]])],
            ]
        )
        fitted = float(back @ _pseudo_inverse(own_gram) @ back)
        residuals[name] = (max(strength - explained, 0.0), max(explained - fitted, 0.0))
    return residuals


def ties(imitated: dict[str, tuple[float, float]]) -> list[str]:
    """Return the effects that are tied: each imitates the other within `TIE`."""
    return sorted(name for name, both in imitated.items() if max(both) < TIE)


def likeness(imitated: dict[str, tuple[float, float]], strength: float) -> tuple[str, float]:
    """Return the effect most similar to a signal, and the cosine with its best imitation."""
    name = min(imitated, key=lambda key: imitated[key][0])
    return name, float(np.sqrt(max(0.0, 1.0 - imitated[name][0] / strength)))


def _pseudo_inverse(gram: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    return np.linalg.pinv(gram / np.outer(scale, scale), rcond=_RANK, hermitian=True) / np.outer(scale, scale)
