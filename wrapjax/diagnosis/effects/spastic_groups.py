"""Muscles that are often spastic or shortened after a stroke, among those with EMG."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.effects.definition import Requirement
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.subject.muscle_groups import SPASTIC_GROUPS

PARETIC_LEG = Requirement(
    "a leg that is paretic, or not known to be otherwise",
    lambda context: "this leg is not the paretic one" if context.paretic is False else "",
)


def recorded_spastic_groups(context: Context) -> dict[str, list[int]]:
    """Find the rows of the muscles with EMG that are often spastic, by the name of their group."""
    groups = {name: context.muscle_rows(members) for name, members in SPASTIC_GROUPS.items()}
    return {name: rows for name, rows in groups.items() if rows}


def each_spastic_group(context: Context) -> Iterable[dict[str, str]]:
    """Give the placeholders of parameters that are repeated for each recorded spastic group."""
    return [{"group": name, "muscles": name.replace("_", " ")} for name in recorded_spastic_groups(context)]


def muscles_of_spastic_groups(context: Context) -> Float[np.ndarray, "group muscle"]:
    """Mark with 1 the muscles of each recorded spastic group."""
    groups = recorded_spastic_groups(context)
    belongs = np.zeros((len(groups), len(context.muscles)))
    for number, rows in enumerate(groups.values()):
        belongs[number, rows] = 1.0
    return belongs
