"""What an effect of the generator is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from validation.blind.world import World

Variant = tuple[str, ...]


def _only(world: World) -> tuple[Variant, ...]:
    return ((),)


def _parameter(amount: float, variant: Variant) -> dict[str, float]:
    return {}


@dataclass(frozen=True)
class Effect:
    """A cause that a case can have.

    ``apply`` puts it into a world in some amount, in ``unit``; ``most`` is the largest amount that is still
    human. A variant says where it acts. ``own_form`` and ``catalogue_form`` stand side by side in
    `EFFECTS.md`. ``parameters`` gives the numbers that a diagnosis is scored on.
    """

    id: str
    family: str
    unit: str
    most: float
    apply: Callable[[World, float, Variant], World]
    own_form: str
    catalogue_form: str
    variants: Callable[[World], tuple[Variant, ...]] = _only
    two_sided: bool = False
    paretic_only: bool = False
    parameters: Callable[[float, Variant], dict[str, float]] = field(default=_parameter)
