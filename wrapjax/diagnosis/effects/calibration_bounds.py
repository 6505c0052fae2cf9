"""Effect of the calibration's bounds: a calibrated parameter that would lie beyond its bound."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectSizes, Variant
from wrapjax.diagnosis.effects.experiments import ISOMETRIC_RAMPS
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs


class AddedParameters(MuscleAlteration):
    """Add to parameters of the muscle, by their names in `ModelParameters`."""

    added: dict[str, Float[Array, "*muscle"]]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        names = sorted(self.added)
        moved = [getattr(inputs.parameters, name) + self.added[name] for name in names]
        return eqx.tree_at(lambda tree: [getattr(tree.parameters, name) for name in names], inputs, moved)


def _parameters_at_bounds(context: Context) -> Iterable[dict[str, Any]]:
    for entry in context.at_bounds:
        yield {
            "muscle": entry.muscle,
            "parameter": entry.parameter,
            "beyond": "above its upper bound" if entry.outward > 0 else "below its lower bound",
            "unit": entry.unit,
            "prior_sd": entry.prior_sd,
            "limit": entry.limit,
        }


def _bound_pressure(context: Context) -> tuple[Variant, ...]:
    outward: dict[str, Float[np.ndarray, "parameter muscle"]] = {}
    for number, entry in enumerate(context.at_bounds):
        table = outward.setdefault(entry.parameter, np.zeros((len(context.at_bounds), len(context.muscles))))
        table[number, context.muscles.index(entry.muscle)] = entry.outward
    by_name = {name: jnp.asarray(table) for name, table in outward.items()}
    return (Variant(Partial(_move_beyond_bounds, by_name)),)


def _move_beyond_bounds(
    outward: dict[str, Float[Array, "parameter muscle"]], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(muscle=AddedParameters({name: effect_sizes @ table for name, table in outward.items()}))


BOUND_PRESSURE = EffectDefinition(
    id="bound_pressure",
    meaning="a calibrated parameter is held back by its bound",
    family="activation_and_muscle",
    requirements=(
        Requirement(
            "a calibrated muscle parameter at a bound",
            lambda context: "" if context.at_bounds else "no calibrated parameter is at a bound",
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=_parameters_at_bounds,
            name="{muscle}.{parameter}",
            sign=1,
            meaning="distance by which {parameter} of {muscle} lies {beyond}",
            source="prior of the calibration",
            part="{muscle}.{parameter}",
            prior="that of the calibration",
        ),
    ),
    variants=_bound_pressure,
    shared_by_conditions=True,
    experiment=ISOMETRIC_RAMPS,
)
