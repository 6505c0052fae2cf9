"""What effects do to the predicted moments, and how fast."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.effect import Effects, Form
from wrapjax.model.alteration import Alteration
from wrapjax.model.forward import Recording, apply_recording_alterations, joint_moments
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves

Forms = tuple[Form, ...]
#: One vector an effect.
EffectSizes = tuple[Float[Array, " _"], ...]
#: What `joint_moments` takes in, where EMG, paths and moments are as effects make them.
Inputs = tuple[Recording, tuple[Alteration, ...]]


def predicted_moments(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    effects: Effects,
    effect_sizes: Float[Array | np.ndarray, " parameter"],
) -> Float[Array, "trial coordinate frame"]:
    """Predict what is measured of all cycles, N m, with effects at these amounts.

    Parameters
    ----------
    curves, parameters, recording
        Of the plain model.
    effects, amounts
        What it leaves out, and how much of it.
    """
    own = effects.split(jnp.asarray(effect_sizes))
    return _moments(curves, parameters, carry_out(recording, parameters, effects.forms, own))


def signatures(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    effects: Effects,
    effect_sizes: Float[Array | np.ndarray, " parameter"] | None = None,
) -> Float[np.ndarray, "parameter trial coordinate frame"]:
    """Differentiate the predicted moments by each amount, at zero or at these amounts.

    In N m a unit of the amount; one pass in forward mode each.

    Parameters
    ----------
    curves, parameters, recording
        Of the plain model.
    effects, amounts
        What it leaves out, and how much of it; none of it if not given.
    """
    at = effects.split(effects.zero if effect_sizes is None else jnp.asarray(effect_sizes))
    inputs = carry_out(recording, parameters, effects.forms, at)
    found = np.zeros((effects.count, *inputs[0].path.nominal.moment_arm.shape[1:]))
    # One after the other: all at once would fill memory with muscles times frames times amounts.
    for number, direction in enumerate(np.eye(effects.count)):
        moved = _moved(recording, parameters, effects.forms, at, effects.split(jnp.asarray(direction)))
        found[number] = _slope(curves, parameters, inputs, moved)
    return found


def finite_difference_signatures(
    curves: AbstractCurves, parameters: ModelParameters, recording: Recording, effects: Effects
) -> Float[np.ndarray, "parameter trial coordinate frame"]:
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
    low, high = (
        np.stack([predicted_moments(curves, parameters, recording, effects, row) for row in rows])
        for rows in (first, last)
    )
    return (high - low) / (sizes * np.where(two_sided, 2.0, 1.0))[:, None, None, None]


# Programs that take long to compile see what amounts have made of EMG, paths and moments, not how: most
# effects then share them, and so do shapes of one effect, and subjects.


@eqx.filter_jit
def carry_out(
    recording: Recording, parameters: ModelParameters, forms: Forms, effect_sizes: EffectSizes
) -> Inputs:
    """Give what the model takes in with effects at these amounts; see `apply_recording_alterations`.

    Parameters
    ----------
    recording, parameters
        Of the plain model; of the parameters only how paths are held.
    forms, amounts
        Of effects, one of each an effect.
    """
    alterations = tuple(form(own) for form, own in zip(forms, effect_sizes, strict=True))
    return apply_recording_alterations(recording, parameters, alterations)


@eqx.filter_jit
def _moments(
    curves: AbstractCurves, parameters: ModelParameters, inputs: Inputs
) -> Float[Array, "trial coordinate frame"]:
    return joint_moments(curves, parameters, *inputs)


@eqx.filter_jit
def _moved(
    recording: Recording,
    parameters: ModelParameters,
    forms: Forms,
    effect_sizes: EffectSizes,
    direction: EffectSizes,
) -> Any:
    """Slope, along a direction, of all numbers that the model takes in."""

    def numbers(effect_sizes: EffectSizes) -> Any:
        return eqx.filter(carry_out(recording, parameters, forms, effect_sizes), eqx.is_inexact_array)

    return jax.jvp(numbers, (effect_sizes,), (direction,))[1]


@eqx.filter_jit
def _slope(
    curves: AbstractCurves, parameters: ModelParameters, inputs: Inputs, moved: Any
) -> Float[Array, "trial coordinate frame"]:
    numbers, rest = eqx.partition(inputs, eqx.is_inexact_array)

    def moments(numbers: Any) -> Float[Array, "trial coordinate frame"]:
        return joint_moments(curves, parameters, *eqx.combine(numbers, rest))

    return jax.jvp(moments, (numbers,), (moved,))[1]
