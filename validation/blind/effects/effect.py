"""Description of a simulated effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from validation.blind.world import World

Variant = tuple[str, ...]


def _single_variant(world: World) -> tuple[Variant, ...]:
    return ((),)


def _no_parameters(amount: float, variant: Variant) -> dict[str, float]:
    return {}


@dataclass(frozen=True)
class Effect:
    """Effect that can be the cause of a case.

    ``apply`` returns a world with the effect in a given amount (in ``unit``) and variant; ``most`` is the
    largest plausible amount. A variant states where the effect acts. ``generator_form`` and
    ``catalogue_form`` describe its form in the simulator and in the catalogue for `EFFECTS.md`.
    ``parameters`` returns the true values of the parameters that a diagnosis is scored on.
    """

    id: str
    family: str
    unit: str
    most: float
    apply: Callable[[World, float, Variant], World]
    generator_form: str
    catalogue_form: str
    variants: Callable[[World], tuple[Variant, ...]] = _single_variant
    two_sided: bool = False
    paretic_only: bool = False
    parameters: Callable[[float, Variant], dict[str, float]] = field(default=_no_parameters)
