"""Joint moments predicted with effects, and signatures: their change per unit of an effect size."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.effect import AlterationFunction, Effects
from wrapjax.model.alteration import Alteration
from wrapjax.model.forward import Recording, apply_recording_alterations, joint_moments
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves

AlterationFunctions = tuple[AlterationFunction, ...]
#: Sizes of several effects: one vector for each effect.
SizesByEffect = tuple[Float[Array, " _"], ...]
#: Inputs of `joint_moments`, with EMG, paths and moments as effects change them.
Inputs = tuple[Recording, tuple[Alteration, ...]]


def predicted_moments(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    effects: Effects,
    effect_sizes: Float[Array | np.ndarray, " parameter"],
) -> Float[Array, "trial coordinate frame"]:
    """Predict the measured moments of all cycles with effects of given sizes, N m.

    Parameters
    ----------
    curves, parameters, recording
        Curves, parameters and inputs of the plain model.
    effects, effect_sizes
        Effects, and their sizes in physical units.
    """
    sizes = effects.split(jnp.asarray(effect_sizes))
    return _moments(
        curves, parameters, altered_inputs(recording, parameters, effects.alteration_functions, sizes)
    )


def signatures(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    effects: Effects,
    effect_sizes: Float[Array | np.ndarray, " parameter"] | None = None,
) -> Float[np.ndarray, "parameter trial coordinate frame"]:
    """Differentiate the predicted moments by each effect size, in forward mode; N m per unit.

    Parameters
    ----------
    curves, parameters, recording
        Curves, parameters and inputs of the plain model.
    effects, effect_sizes
        Effects, and the sizes at which to differentiate; zero if not given.
    """
    at = effects.split(effects.zero if effect_sizes is None else jnp.asarray(effect_sizes))
    inputs = altered_inputs(recording, parameters, effects.alteration_functions, at)
    result = np.zeros((effects.count, *inputs[0].path.nominal.moment_arm.shape[1:]))
    # One after the other: all at once would need memory for muscles times frames times effect sizes.
    for number, direction in enumerate(np.eye(effects.count)):
        tangent = _input_tangent(
            recording, parameters, effects.alteration_functions, at, effects.split(jnp.asarray(direction))
        )
        result[number] = _moment_tangent(curves, parameters, inputs, tangent)
    return result


def finite_difference_signatures(
    curves: AbstractCurves, parameters: ModelParameters, recording: Recording, effects: Effects
) -> Float[np.ndarray, "parameter trial coordinate frame"]:
    """Divide the change of the moments by an effect size of one prior standard deviation by it; N m per unit.

    Tendons, passive fibers and thresholds change little at first and much later: a derivative at zero gives
    neither the size nor the shape of their signatures. For effect sizes of either sign the difference is
    central.

    Parameters
    ----------
    curves, parameters, recording
        Curves, parameters and inputs of the plain model.
    effects
        Effects whose signatures are computed.
    """
    sizes, two_sided = effects.prior_sd, np.array([entry.sign == 0 for entry in effects.parameters])
    first, last = (np.diag(sign * sizes) for sign in (np.where(two_sided, -1.0, 0.0), np.ones(len(sizes))))
    low, high = (
        np.stack([predicted_moments(curves, parameters, recording, effects, row) for row in rows])
        for rows in (first, last)
    )
    return (high - low) / (sizes * np.where(two_sided, 2.0, 1.0))[:, None, None, None]


# Programs that take long to compile receive EMG, paths and moments as changed by the effects, and not the
# effects themselves: most effects then share one compiled program, and so do variants and subjects.


@eqx.filter_jit
def altered_inputs(
    recording: Recording,
    parameters: ModelParameters,
    alteration_functions: AlterationFunctions,
    effect_sizes: SizesByEffect,
) -> Inputs:
    """Return the inputs of the forward model with effects; see `apply_recording_alterations`.

    Parameters
    ----------
    recording, parameters
        Inputs and parameters of the plain model; of the parameters only the held paths count.
    alteration_functions, effect_sizes
        Changes of the forward model, and effect sizes; one of each for each effect.
    """
    alterations = tuple(
        alteration(sizes) for alteration, sizes in zip(alteration_functions, effect_sizes, strict=True)
    )
    return apply_recording_alterations(recording, parameters, alterations)


@eqx.filter_jit
def _moments(
    curves: AbstractCurves, parameters: ModelParameters, inputs: Inputs
) -> Float[Array, "trial coordinate frame"]:
    return joint_moments(curves, parameters, *inputs)


@eqx.filter_jit
def _input_tangent(
    recording: Recording,
    parameters: ModelParameters,
    alteration_functions: AlterationFunctions,
    effect_sizes: SizesByEffect,
    direction: SizesByEffect,
) -> Any:
    """Differentiate all numbers among the inputs of the forward model along a direction of effect sizes."""

    def numbers(effect_sizes: SizesByEffect) -> Any:
        return eqx.filter(
            altered_inputs(recording, parameters, alteration_functions, effect_sizes), eqx.is_inexact_array
        )

    return jax.jvp(numbers, (effect_sizes,), (direction,))[1]


@eqx.filter_jit
def _moment_tangent(
    curves: AbstractCurves, parameters: ModelParameters, inputs: Inputs, tangent: Any
) -> Float[Array, "trial coordinate frame"]:
    """Differentiate the moments along a tangent of the inputs."""
    numbers, rest = eqx.partition(inputs, eqx.is_inexact_array)

    def moments(numbers: Any) -> Float[Array, "trial coordinate frame"]:
        return joint_moments(curves, parameters, *eqx.combine(numbers, rest))

    return jax.jvp(moments, (numbers,), (tangent,))[1]
