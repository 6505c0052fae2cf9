"""All causes by id."""

from __future__ import annotations

from . import effects_emg, effects_joint, effects_measure, effects_muscle
from .effect import Effect

_MODULES = (effects_emg, effects_muscle, effects_joint, effects_measure)


def _all(base: type[Effect]) -> list[type[Effect]]:
    """Return all direct subclasses in the order of definition."""
    return [c for c in base.__subclasses__() if c.__module__ in {m.__name__ for m in _MODULES}]


EFFECTS: dict[str, type[Effect]] = {c.id: c for c in _all(Effect)}
CATALOGUE = tuple(i for i in EFFECTS if not i.startswith("outside_"))
OUTSIDE = tuple(i for i in EFFECTS if i.startswith("outside_"))
