"""What effects do to the predicted moments, and how fast."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.gap.effect import Effects, Form, split_amounts
from wrapjax.model import ModelParameters, Recording, joint_moments
from wrapjax.muscle import AbstractCurves

Forms = tuple[Form, ...]
#: One vector an effect.
Amounts = tuple[Float[Array, " _"], ...]


def predicted_moments(
    curves: AbstractCurves,
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
    return _moments(curves, parameters, recording, effects.forms, effects.split(jnp.asarray(amounts)))


def signatures(
    curves: AbstractCurves,
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
    at = effects.split(effects.zero if amounts is None else jnp.asarray(amounts))
    every = split_amounts(jnp.eye(effects.count), effects.counts)
    return _slopes(curves, parameters, recording, effects.forms, at, every)


def secants(
    curves: AbstractCurves, parameters: ModelParameters, recording: Recording, effects: Effects
) -> Float[Array, "parameter trial coordinate frame"]:
    """Divide what each amount changes, when it is as large as expected, by its size: N m a unit.

    Tendons, passive fibers and thresholds do little at first and much later: a tangent at zero says neither
    how large their traces are nor what they look like. Amounts of either sign are taken half from each.

    Parameters
    ----------
    curves, parameters, recording
        Of the plain model.
    effects
        What it leaves out.
    """
    sizes, two_sided = effects.prior_sd, np.array([entry.sign == 0 for entry in effects.parameters])
    first, last = (np.diag(sign * sizes) for sign in (np.where(two_sided, -1.0, 0.0), np.ones(len(sizes))))
    ends = (split_amounts(jnp.asarray(rows), effects.counts) for rows in (first, last))
    low, high = (_each_moment(curves, parameters, recording, effects.forms, rows) for rows in ends)
    return (high - low) / jnp.asarray(sizes * np.where(two_sided, 2.0, 1.0))[:, None, None, None]


# What is compiled knows forms, not names: shapes of one effect, and subjects, then share it.


@eqx.filter_jit
def _moments(
    curves: AbstractCurves, parameters: ModelParameters, recording: Recording, forms: Forms, amounts: Amounts
) -> Float[Array, "trial coordinate frame"]:
    alterations = tuple(form(own) for form, own in zip(forms, amounts, strict=True))
    return joint_moments(curves, parameters, recording, alterations)


@eqx.filter_jit
def _slopes(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    forms: Forms,
    amounts: Amounts,
    directions: tuple[Float[Array, "parameter _"], ...],
) -> Float[Array, "parameter trial coordinate frame"]:
    def along(direction: Amounts) -> Float[Array, "trial coordinate frame"]:
        def moments(amounts: Amounts) -> Float[Array, "trial coordinate frame"]:
            return _moments(curves, parameters, recording, forms, amounts)

        return jax.jvp(moments, (amounts,), (direction,))[1]

    # One after the other: all at once would fill memory with muscles times frames times amounts.
    return jax.lax.map(along, directions)


@eqx.filter_jit
def _each_moment(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    forms: Forms,
    amounts: tuple[Float[Array, "row _"], ...],
) -> Float[Array, "row trial coordinate frame"]:
    def moments(own: Amounts) -> Float[Array, "trial coordinate frame"]:
        return _moments(curves, parameters, recording, forms, own)

    return jax.lax.map(moments, amounts)
