"""The bounds of calibration itself: a finding here says that one of them is too narrow."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs


class Beyond(MuscleAlteration):
    """Add to parameters of one number a muscle."""

    added: dict[str, Float[Array, "*muscle"]]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        names = sorted(self.added)
        moved = [getattr(inputs.parameters, name) + self.added[name] for name in names]
        return eqx.tree_at(lambda tree: [getattr(tree.parameters, name) for name in names], inputs, moved)


def bound_pressure(context: Context) -> Effect | NotTestable:
    """Let parameters that stand at a bound go beyond it, under their prior."""
    if not context.at_bounds:
        return NotTestable("bound_pressure", "no calibrated parameter is at a bound")
    parameters = tuple(
        EffectParameter(
            name=f"{entry.muscle}.{entry.parameter}",
            unit=entry.unit,
            prior_sd=entry.prior_sd,
            sign=1,
            meaning=f"how far {entry.parameter} of {entry.muscle} wants to be "
            + ("above its upper bound" if entry.outward > 0 else "below its lower bound"),
            source="prior of the calibration",
            limit=entry.limit,
            part=f"{entry.muscle}.{entry.parameter}",
        )
        for entry in context.at_bounds
    )
    outward: dict[str, Float[np.ndarray, "parameter muscle"]] = {}
    for number, entry in enumerate(context.at_bounds):
        table = outward.setdefault(entry.parameter, np.zeros((len(parameters), len(context.muscles))))
        table[number, context.muscles.index(entry.muscle)] = entry.outward
    form = Partial(_beyond, {name: jnp.asarray(table) for name, table in outward.items()})
    return Effect("bound_pressure", "calibration", parameters, (Variant(form),))


def _beyond(
    outward: dict[str, Float[Array, "parameter muscle"]], effect_sizes: Float[Array, " parameter"]
) -> Alteration:
    return Alteration(muscle=Beyond({name: effect_sizes @ table for name, table in outward.items()}))
