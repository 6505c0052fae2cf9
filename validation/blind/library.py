"""All catalogued signatures of one person: how strong each effect can get, and what it looks like."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from validation.blind.effects import EFFECTS
from validation.blind.effects.effect import Effect, Variant
from validation.blind.noise import EMG_LEVELS
from validation.blind.oracle import TIE, Oracle, difference, flat
from validation.blind.world import World

#: Signatures are taken at this share of an effect's largest amount.
SHARE = 0.4
#: Directions weaker than this, relative to an effect's strongest, are not used to imitate.
_RANK = 1e-6


@dataclass(frozen=True)
class Library:
    """``signals`` is (sample, entry); ``reach`` the largest d* of each entry, (level, entry)."""

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
        return np.array([index for index, (own, _) in enumerate(self.entries) if own == name], int)


def library_file(bank: Path, person: int) -> Path:
    """Where a bank keeps the library of a person, by number."""
    return bank / "library" / f"{person:02d}.npz"


def library_of(bank: Path, name: str) -> Library:
    """The library of a person, by the name that truths have."""
    return Library.load(library_file(bank, int(name.rsplit("_", 1)[-1])))


def entries_of(world: World) -> list[tuple[Effect, Variant]]:
    return [(effect, variant) for effect in EFFECTS.values() for variant in effect.variants(world)]


def build_library(world: World, oracles: dict[float, Oracle]) -> Library:
    entries = entries_of(world)
    columns = [
        flat(world, difference(world, effect, SHARE * effect.most, variant)[1]) for effect, variant in entries
    ]
    signals = np.stack(columns, axis=1)
    reach = np.stack(
        [
            np.sqrt(np.maximum(np.einsum("ij,ij->j", signals, oracles[level].whiten(signals)), 0.0)) / SHARE
            for level in EMG_LEVELS
        ]
    )
    return Library(tuple((effect.id, variant) for effect, variant in entries), signals, reach)


def imitations(
    library: Library, oracle: Oracle, own: str, seen: np.ndarray
) -> dict[str, tuple[float, float]]:
    """For each catalogued effect but ``own``: what it cannot imitate of a signal, and what ``own`` (its
    library entries and the signal itself) cannot imitate of its best imitation; in squared standard
    deviations.
    """
    whitened = oracle.whiten(library.signals)
    gram = library.signals.T @ whitened
    cross = whitened.T @ seen
    strength = float(seen @ oracle.whiten(seen))
    mine = library.of(own) if own in EFFECTS else np.array([], int)
    found = {}
    for name in EFFECTS:
        if name == own:
            continue
        index = library.of(name)
        inner = _pseudo_inverse(gram[np.ix_(index, index)])
        mix = inner @ cross[index]
        explained = float(mix @ cross[index])
        # The other way: the best imitation, less what my own entries and the signal give of it.
        best = library.signals[:, index] @ mix
        back = np.concatenate([whitened[:, mine].T @ best, [float(seen @ (whitened[:, index] @ mix))]])
        own_gram = np.block(
            [[gram[np.ix_(mine, mine)], cross[mine][:, None]], [cross[mine][None], np.array([[strength]])]]
        )
        given = float(back @ _pseudo_inverse(own_gram) @ back)
        found[name] = (max(strength - explained, 0.0), max(explained - given, 0.0))
    return found


def ties(imitated: dict[str, tuple[float, float]]) -> list[str]:
    return sorted(name for name, both in imitated.items() if max(both) < TIE)


def likeness(imitated: dict[str, tuple[float, float]], strength: float) -> tuple[str, float]:
    """The effect that a signal looks like most, and the cosine with its best imitation."""
    name = min(imitated, key=lambda key: imitated[key][0])
    return name, float(np.sqrt(max(0.0, 1.0 - imitated[name][0] / strength)))


def _pseudo_inverse(gram: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    return np.linalg.pinv(gram / np.outer(scale, scale), rcond=_RANK, hermitian=True) / np.outer(scale, scale)
