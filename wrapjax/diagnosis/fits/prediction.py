"""Joint moments predicted with effects, and signatures: their change per unit of an effect size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.diagnosis.effects.effect import AlterationFunction, Effects
from wrapjax.model.alteration import Alteration
from wrapjax.model.forward import Recording, apply_recording_alterations, joint_moments, muscle_states
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves

#: Largest number of altered inputs that are kept while an effect is evaluated, each some megabytes.
_MOST_GROUPS = 6
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
    high = _changes(curves, parameters, recording, effects, sizes)
    low = np.zeros_like(high)
    if two_sided.any():
        low[two_sided] = _changes(curves, parameters, recording, effects, np.where(two_sided, -sizes, 0.0))[
            two_sided
        ]
    return (high - low) / (sizes * np.where(two_sided, 2.0, 1.0))[:, None, None, None]


def _changes(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    effects: Effects,
    sizes: Float[np.ndarray, " parameter"],
) -> Float[np.ndarray, "parameter trial coordinate frame"]:
    """Compute the change of the moments by each effect size alone, N m.

    Most parameters change few muscles, and a muscle's moment depends on its own inputs only. Parameters that
    change different muscles are therefore evaluated together, and those that change none, not at all.
    """

    def inputs_at(number: int | None) -> Inputs:
        vector = np.zeros(effects.count)
        if number is not None:
            vector[number] = sizes[number]
        split = effects.split(jnp.asarray(vector))
        return altered_inputs(recording, parameters, effects.alteration_functions, split)

    plain = inputs_at(None)
    plain_moments, plain_sum = _muscle_moments(curves, parameters, plain)
    result = np.zeros((effects.count, *plain_sum.shape))

    def evaluate(group: _Group) -> None:
        difference = np.asarray(_muscle_moments(curves, parameters, group.inputs)[0] - plain_moments)
        for number, muscles in group.changed.items():
            result[number] += difference[muscles].sum(axis=0)

    groups: list[_Group] = []
    for number in np.flatnonzero(sizes).tolist():
        own = inputs_at(number)
        result[number] = _added_moment(own) - _added_moment(plain)
        muscles = np.asarray(_changed_muscles(plain, own))
        if not muscles.any():
            continue
        place = next((place for place, one in enumerate(groups) if not (one.taken & muscles).any()), None)
        if place is not None:
            groups[place] = groups[place].joined(number, own, muscles)
        else:
            groups.append(_Group(own, {number: muscles}))
            if len(groups) > _MOST_GROUPS:
                evaluate(groups.pop(int(np.argmax([one.taken.sum() for one in groups]))))
    for group in groups:
        evaluate(group)
    return result


@dataclass(frozen=True)
class _Group:
    """Parameters that change different muscles, which are evaluated together.

    Parameters
    ----------
    inputs
        Inputs of the forward model with all of them.
    changed
        Whether each muscle's inputs are changed, by the number of the parameter.
    """

    inputs: Inputs
    changed: dict[int, Bool[np.ndarray, " muscle"]]

    @property
    def taken(self) -> Bool[np.ndarray, " muscle"]:
        """Whether any of the parameters changes a muscle."""
        return np.any(list(self.changed.values()), axis=0)

    def joined(self, number: int, inputs: Inputs, muscles: Bool[np.ndarray, " muscle"]) -> _Group:
        """Add a parameter that changes other muscles, which have these inputs with it."""
        return _Group(_with_muscles_of(self.inputs, inputs, muscles), {**self.changed, number: muscles})


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
def _muscle_moments(
    curves: AbstractCurves, parameters: ModelParameters, inputs: Inputs
) -> tuple[Float[Array, "muscle trial coordinate frame"], Float[Array, "trial coordinate frame"]]:
    """Compute the moment of each muscle, and their sum."""
    moments = muscle_states(curves, parameters, *inputs).moment
    return moments, moments.sum(axis=0)


def _added_moment(inputs: Inputs) -> Float[Array, "trial coordinate frame"]:
    """Return the moment that is added to that of the muscles, N m."""
    moment = inputs[1][0].moment
    assert moment is not None, "altered inputs have one"
    return moment


def _by_muscle(inputs: Inputs) -> Any:
    """Return what the moments of single muscles depend on: the leading axis of all arrays is ``muscle``."""
    recording, (_, *alterations) = inputs
    return recording, alterations


@eqx.filter_jit
def _changed_muscles(plain: Inputs, changed: Inputs) -> Bool[Array, " muscle"]:
    """Find the muscles whose inputs differ."""
    first, second = (jax.tree.leaves(eqx.filter(_by_muscle(one), eqx.is_array)) for one in (plain, changed))
    differs = [
        jnp.any((one != other).reshape(len(one), -1), axis=1)
        for one, other in zip(first, second, strict=True)
    ]
    return jnp.stack(differs).any(axis=0)


@eqx.filter_jit
def _with_muscles_of(inputs: Inputs, others: Inputs, muscles: Bool[Array | np.ndarray, " muscle"]) -> Inputs:
    """Take the inputs of some muscles from others."""

    def chosen(one: Array, other: Array) -> Array:
        return jnp.where(jnp.reshape(muscles, (-1, *(1,) * (one.ndim - 1))), other, one)

    own, rest = eqx.partition(_by_muscle(inputs), eqx.is_array)
    mixed = jax.tree.map(chosen, own, eqx.filter(_by_muscle(others), eqx.is_array))
    recording, alterations = eqx.combine(mixed, rest)
    return recording, (inputs[1][0], *alterations)


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
