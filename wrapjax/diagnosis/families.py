"""Families of effects: what is named where a recording shows a kind of cause, but not which cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.family import FAMILIES


def family_of(effect: str) -> str:
    """Return the identifier of an effect's family.

    Raises
    ------
    KeyError
        If there is no such effect.
    """
    return CATALOGUE[effect].family


def family_members(family: str) -> tuple[str, ...]:
    """List the effects of a family that can be named, in the order of the catalogue.

    Raises
    ------
    KeyError
        If there is no such family.
    """
    if family not in FAMILIES:
        raise KeyError(family)
    return tuple(id for id, one in CATALOGUE.items() if one.family == family and not one.nuisance)


def family_probabilities(effects: Mapping[str, float]) -> dict[str, float]:
    """Sum the probabilities of the effects of each family; families without a testable effect are omitted."""
    total: dict[str, float] = {}
    for id, probability in effects.items():
        family = family_of(id)
        total[family] = total.get(family, 0.0) + probability
    return total


def same_family(effects: Sequence[str]) -> bool:
    """Return whether all effects are of one family."""
    return len({family_of(id) for id in effects}) == 1
