"""What effects do to the predicted moments, and how fast."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.gap.effect import Effects
from wrapjax.model import ModelParameters, Recording, joint_moments
from wrapjax.muscle import HillCurves


@eqx.filter_jit
def predicted_moments(
    curves: HillCurves,
    parameters: ModelParameters,
    recording: Recording,
    effects: Effects,
    amounts: Float[Array, " parameter"],
) -> Float[Array, "trial coordinate frame"]:
    """Predict what is measured of all cycles, N m, with effects at these amounts.

    Parameters
    ----------
    curves, parameters, recording
        Of the plain model.
    effects, amounts
        What it leaves out, and how much of it.
    """
    return joint_moments(curves, parameters, recording, effects.alterations(amounts))


@eqx.filter_jit
def signatures(
    curves: HillCurves,
    parameters: ModelParameters,
    recording: Recording,
    effects: Effects,
    amounts: Float[Array, " parameter"] | None = None,
) -> Float[Array, "parameter trial coordinate frame"]:
    """Differentiate the predicted moments by each amount, at zero or at these amounts.

    In N m a unit of the amount; one pass in forward mode each.

    Parameters
    ----------
    curves, parameters, recording
        Of the plain model.
    effects, amounts
        What it leaves out, and how much of it; none of it if not given.
    """
    at = effects.zero if amounts is None else amounts

    def along(direction: Float[Array, " parameter"]) -> Float[Array, "trial coordinate frame"]:
        def moments(amounts: Float[Array, " parameter"]) -> Float[Array, "trial coordinate frame"]:
            return joint_moments(curves, parameters, recording, effects.alterations(amounts))

        return jax.jvp(moments, (at,), (direction,))[1]

    # One after the other: all at once would fill memory with muscles times frames times amounts.
    return jax.lax.map(along, jnp.eye(effects.count))
