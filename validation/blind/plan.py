"""Plan of a bank: person, cause, strength and noise of every case, fixed by the bank's seed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from validation.blind.effects import EFFECTS
from validation.blind.effects.effect import Variant
from validation.blind.families import BANKS
from validation.blind.library import Library
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.worlds import WORLDS, WorldSettings, default_world

#: d* range of the strata, and the share of single effects in each. Below d* = 3 every effect is tied with
#: every other and any name is correct, so the middle stratum begins above.
STRATA = {"below_2": (0.5, 1.8, 0.2), "2_to_5": (3.5, 4.6, 0.3), "above_5": (5.6, 16.0, 0.5)}
#: The same of the bank `worlds`.
WORLD_STRATA = {"2_to_5": (3.5, 4.6, 0.3), "above_5": (5.6, 16.0, 0.7)}
#: Largest d* of an effect, relative to the least d* of a stratum, that is required for this stratum.
ROOM = 1.5
#: Name of the bank whose parts are worlds, its usual size, and the seed of what its worlds share.
WORLD_BANK, WORLD_CASES, _SHARED_SEED = "worlds", 320, 70_000


@dataclass(frozen=True)
class Bank:
    """Size of a bank, or of one world of the bank `worlds`: persons, and cases of each tier."""

    name: str
    seed: int
    people: int
    single: int
    none: int
    outside: int
    pair: int
    world: str = ""
    #: Number of the first person; even.
    first_person: int = 0

    def __len__(self) -> int:
        return self.single + self.none + self.outside + self.pair

    @property
    def persons(self) -> range:
        return range(self.first_person, self.first_person + self.people)

    @property
    def strata(self) -> dict[str, tuple[float, float, float]]:
        return WORLD_STRATA if self.world else STRATA


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


def banks_of(name: str, cases: int | None = None, world: str | None = None) -> tuple[Bank, ...]:
    """Return the parts of a bank: all or one of the worlds, for `worlds`; otherwise the bank itself.

    Parameters
    ----------
    name
        Name of the bank.
    cases
        Number of cases of the whole bank, with the same proportions.
    world
        One world of the bank `worlds`. Its cases do not depend on whether others are made.

    Raises
    ------
    ValueError
        If another bank has no worlds, or the bank `worlds` would have too few cases for all tiers.
    """
    if name != WORLD_BANK:
        if world is not None:
            raise ValueError(f"bank {name} has no worlds")
        return (bank_of(name, cases),)
    count, parts = WORLD_CASES if cases is None else cases, len(WORLDS)
    if count < 5 * parts:
        raise ValueError(f"bank {name} needs {5 * parts} cases or more")
    banks = (
        _world_bank(settings, number, count // parts + (number < count % parts))
        for number, settings in enumerate(WORLDS.values())
    )
    return tuple(bank for bank in banks if world in (None, bank.world))


def _world_bank(settings: WorldSettings, number: int, cases: int) -> Bank:
    tenth = max(1, round(0.1 * cases))
    none = round(0.35 * cases)
    people = min(2 * (cases // 2), max(4, 2 * round(0.15 * cases)))
    first = 100 * number
    single = cases - none - 2 * tenth
    return Bank(WORLD_BANK, settings.seed, people, single, none, tenth, tenth, settings.name, first)


def paretic(person: int) -> bool:
    return person % 2 == 1


def settings_of(bank: Bank, person: int) -> WorldSettings:
    """Return the settings of a person's world."""
    if bank.world:
        return WORLDS[bank.world]
    families = BANKS[bank.name]
    return default_world(families[(person // 2) % len(families)])


def plan_cases(bank: Bank, variants: dict[str, tuple[Variant, ...]]) -> list[PlannedCase]:
    """Distribute causes, persons and noise levels evenly, with ids in random order."""
    rng = np.random.default_rng((bank.seed, 1))
    names = list(EFFECTS)
    causes: list[tuple[str, tuple[str, ...]]] = []
    causes += [("single", (name,)) for name in _dealt(bank, rng, 0, names, bank.single)]
    causes += [("none", ())] * bank.none
    causes += [("outside", (name,)) for name in _dealt(bank, rng, 1, list(OUTSIDE), bank.outside)]
    first, second = (_dealt(bank, rng, kind, names, bank.pair) for kind in (2, 3))
    for one, other in zip(first, second, strict=True):
        while other == one:
            other = names[int(rng.integers(len(names)))]
        causes.append(("pair", (one, other)))
    people = _evenly(rng, list(bank.persons), len(causes))
    levels = _evenly(rng, list(settings_of(bank, bank.first_person).emg.levels), len(causes))
    planned = []
    for order, ((tier, effects), person, level) in enumerate(zip(causes, people, levels, strict=True)):
        if any(EFFECTS[name].paretic_only for name in effects if name in EFFECTS) and not paretic(person):
            person = bank.first_person + (person - bank.first_person + 1) % bank.people
        known = {**EFFECTS, **OUTSIDE}
        chosen = tuple((name, variants[name][int(rng.integers(len(variants[name])))]) for name in effects)
        signs = tuple(int(rng.choice((-1, 1))) if known[name].two_sided else 1 for name in effects)
        identity = hashlib.sha256(f"{bank.name}/{bank.seed}/{order}".encode()).hexdigest()[:12]
        planned.append(PlannedCase(order, identity, person, tier, float(level), chosen, signs))
    return planned


def _evenly(rng: np.random.Generator, choices: list, count: int) -> list:
    rounds = [rng.permutation(len(choices)) for _ in range(-(-count // len(choices)))]
    return [choices[index] for index in np.concatenate(rounds)[:count]] if count else []


def _dealt(bank: Bank, rng: np.random.Generator, kind: int, choices: list, count: int) -> list:
    """Choose evenly; the worlds of the bank `worlds` take successive parts of one even choice."""
    if not bank.world:
        return _evenly(rng, choices, count)
    number = list(WORLDS).index(bank.world)
    shared = _evenly(np.random.default_rng((_SHARED_SEED, kind)), choices, len(WORLDS) * count)
    return shared[number * count : (number + 1) * count]


def with_targets(bank: Bank, planned: list[PlannedCase], libraries: dict[int, Library]) -> list[PlannedCase]:
    """Draw target d*: single effects by stratum in the bank's shares, as far as their largest d* allow."""
    rng = np.random.default_rng((bank.seed, 2))
    levels = settings_of(bank, bank.first_person).emg.levels
    if bank.world:
        planned = [
            _with_strong_cause(rng, case, libraries[case.person], levels) if case.tier == "single" else case
            for case in planned
        ]
    reaches = {
        case.order: _reach(case, libraries[case.person], levels) for case in planned if case.tier == "single"
    }
    strata = _strata(rng, reaches, bank.strata)
    out = []
    for case in planned:
        draw = rng.random(max(1, len(case.causes)))
        if case.tier == "single":
            stratum = strata[case.order]
            low, high, _ = bank.strata[stratum]
            high = max(low, min(high, 0.7 * reaches[case.order]))
            target = low * (high / low) ** draw[0]
            case = replace(case, targets=(float(target),), stratum=stratum)
        elif case.causes:
            case = replace(case, targets=tuple(float(5.5 * (14.0 / 5.5) ** u) for u in draw))
        out.append(case)
    return out


def _with_strong_cause(
    rng: np.random.Generator, case: PlannedCase, library: Library, levels: tuple[float, ...]
) -> PlannedCase:
    """Choose another variant, or else another effect, where the largest d* is too small for every stratum."""
    reach = library.reach[levels.index(case.level)]
    least = ROOM * min(low for low, _, _ in WORLD_STRATA.values())
    enough = ROOM * max(low for low, _, _ in WORLD_STRATA.values())
    if _reach(case, library, levels) > enough:
        return case
    ((cause, _),) = case.causes
    best = max(library.of(cause), key=lambda entry: reach[entry])
    if reach[best] <= least:
        able = [
            entry
            for entry, (name, _) in enumerate(library.entries)
            if reach[entry] > enough and (paretic(case.person) or not EFFECTS[name].paretic_only)
        ]
        best = able[int(rng.integers(len(able)))] if able else best
    name, variant = library.entries[best]
    sign = int(rng.choice((-1, 1))) if EFFECTS[name].two_sided else 1
    return replace(case, causes=((name, variant),), signs=(sign,))


def _reach(case: PlannedCase, library: Library, levels: tuple[float, ...]) -> float:
    ((cause, variant),) = case.causes
    entry = library.entries.index((cause, variant))
    return float(library.reach[levels.index(case.level), entry])


def _strata(
    rng: np.random.Generator, reaches: dict[int, float], strata: dict[str, tuple[float, float, float]]
) -> dict[int, str]:
    """Assign cases with a large enough d* to the strong stratum, then to the middle one."""
    remaining = [int(order) for order in rng.permutation(list(reaches))]
    out: dict[int, str] = {}
    for name in ("above_5", "2_to_5"):
        low, _, share = strata[name]
        count = round(share * len(reaches))
        able = [order for order in remaining if reaches[order] > ROOM * low][:count]
        out |= dict.fromkeys(able, name)
        remaining = [order for order in remaining if order not in out]
    return out | dict.fromkeys(remaining, next(iter(strata)))
