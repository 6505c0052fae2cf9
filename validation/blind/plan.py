"""Plan of a bank: person, cause, strength and noise of every case, fixed by the bank's seed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from validation.blind.effects import EFFECTS
from validation.blind.effects.effect import Variant
from validation.blind.families import BANKS
from validation.blind.library import Library
from validation.blind.noise import EMG_LEVELS
from validation.blind.outside_catalogue import OUTSIDE

#: d* range of the strata, and the share of single effects in each. Below d* = 3 every effect is tied with
#: every other and any name is correct, so the middle stratum begins above.
STRATA = {"below_2": (0.5, 1.8, 0.2), "2_to_5": (3.5, 4.6, 0.3), "above_5": (5.6, 16.0, 0.5)}


@dataclass(frozen=True)
class Bank:
    """Size of a bank: persons, and cases of each tier."""

    name: str
    seed: int
    people: int
    single: int
    none: int
    outside: int
    pair: int

    def __len__(self) -> int:
        return self.single + self.none + self.outside + self.pair


BANK_SIZES = {
    "test": Bank("test", 81_047, 40, 360, 120, 120, 120),
    # Other persons, for versions after all cases of the first bank were scored.
    "second_test": Bank("second_test", 26_711, 40, 360, 120, 120, 120),
    "development": Bank("development", 52_360, 40, 240, 60, 60, 40),
}


@dataclass(frozen=True)
class PlannedCase:
    """Case to make, with causes (effect, variant) and target d*; strata are set once largest d* are known."""

    order: int
    id: str
    person: int
    tier: str
    level: float
    causes: tuple[tuple[str, Variant], ...]
    signs: tuple[int, ...]
    targets: tuple[float, ...] = ()
    stratum: str = ""


def stratum_of(d_star: float) -> str:
    return "above_5" if d_star > 5.0 else "2_to_5" if d_star > 2.0 else "below_2"


def bank_of(name: str, cases: int | None = None) -> Bank:
    """Return a bank, or a smaller one with the same proportions."""
    bank = BANK_SIZES[name]
    if cases is None or cases >= len(bank):
        return bank
    share = cases / len(bank)
    parts = {kind: max(1, round(share * getattr(bank, kind))) for kind in ("none", "outside", "pair")}
    people = int(np.clip(round(share * bank.people), 4, bank.people))
    return replace(bank, people=people + people % 2, single=max(1, cases - sum(parts.values())), **parts)


def paretic(person: int) -> bool:
    return person % 2 == 1


def family_of(bank: Bank, person: int) -> str:
    families = BANKS[bank.name]
    return families[(person // 2) % len(families)]


def plan_cases(bank: Bank, variants: dict[str, tuple[Variant, ...]]) -> list[PlannedCase]:
    """Distribute causes, persons and noise levels evenly, with ids in random order."""
    rng = np.random.default_rng((bank.seed, 1))
    names = list(EFFECTS)
    causes: list[tuple[str, tuple[str, ...]]] = []
    causes += [("single", (name,)) for name in _evenly(rng, names, bank.single)]
    causes += [("none", ())] * bank.none
    causes += [("outside", (name,)) for name in _evenly(rng, list(OUTSIDE), bank.outside)]
    first, second = _evenly(rng, names, bank.pair), _evenly(rng, names, bank.pair)
    for one, other in zip(first, second, strict=True):
        while other == one:
            other = names[int(rng.integers(len(names)))]
        causes.append(("pair", (one, other)))
    people = _evenly(rng, list(range(bank.people)), len(causes))
    levels = _evenly(rng, list(EMG_LEVELS), len(causes))
    planned = []
    for order, ((tier, effects), person, level) in enumerate(zip(causes, people, levels, strict=True)):
        if any(EFFECTS[name].paretic_only for name in effects if name in EFFECTS) and not paretic(person):
            person = (person + 1) % bank.people
        known = {**EFFECTS, **OUTSIDE}
        chosen = tuple((name, variants[name][int(rng.integers(len(variants[name])))]) for name in effects)
        signs = tuple(int(rng.choice((-1, 1))) if known[name].two_sided else 1 for name in effects)
        identity = hashlib.sha256(f"{bank.name}/{bank.seed}/{order}".encode()).hexdigest()[:12]
        planned.append(PlannedCase(order, identity, person, tier, float(level), chosen, signs))
    return planned


def _evenly(rng: np.random.Generator, choices: list, count: int) -> list:
    rounds = [rng.permutation(len(choices)) for _ in range(-(-count // len(choices)))]
    return [choices[index] for index in np.concatenate(rounds)[:count]] if count else []


def with_targets(bank: Bank, planned: list[PlannedCase], libraries: dict[int, Library]) -> list[PlannedCase]:
    """Draw target d*: 20, 30 and 50 % of single effects by stratum, as far as their largest d* allow."""
    rng = np.random.default_rng((bank.seed, 2))
    reaches = {case.order: _reach(case, libraries[case.person]) for case in planned if case.tier == "single"}
    strata = _strata(rng, reaches)
    out = []
    for case in planned:
        draw = rng.random(max(1, len(case.causes)))
        if case.tier == "single":
            stratum = strata[case.order]
            low, high, _ = STRATA[stratum]
            high = max(low, min(high, 0.7 * reaches[case.order]))
            target = low * (high / low) ** draw[0]
            case = replace(case, targets=(float(target),), stratum=stratum)
        elif case.causes:
            case = replace(case, targets=tuple(float(5.5 * (14.0 / 5.5) ** u) for u in draw))
        out.append(case)
    return out


def _reach(case: PlannedCase, library: Library) -> float:
    ((cause, variant),) = case.causes
    entry = library.entries.index((cause, variant))
    return float(library.reach[EMG_LEVELS.index(case.level), entry])


def _strata(rng: np.random.Generator, reaches: dict[int, float]) -> dict[int, str]:
    """Assign cases with a large enough d* to the strong stratum, then to the middle one."""
    remaining = [int(order) for order in rng.permutation(list(reaches))]
    out: dict[int, str] = {}
    for name in ("above_5", "2_to_5"):
        low, _, share = STRATA[name]
        count = round(share * len(reaches))
        able = [order for order in remaining if reaches[order] > 1.5 * low][:count]
        out |= dict.fromkeys(able, name)
        remaining = [order for order in remaining if order not in out]
    return out | dict.fromkeys(remaining, "below_2")
