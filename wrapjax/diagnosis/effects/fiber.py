"""Effects on muscle fibers: maximum velocity, optimal length, history dependence, short-range stiffness."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant
from wrapjax.diagnosis.effects.experiments import ISOMETRIC_RAMPS, STRETCH_AND_HOLD, THIRD_WALKING_SPEED
from wrapjax.diagnosis.effects.periodic import periodic_scan
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs
from wrapjax.muscle.hill import FiberState


def _fiber_velocity(fiber: FiberState, inputs: MuscleInputs) -> Float[Array, "trial frame"]:
    """Compute the fiber velocity in optimal fiber lengths per second."""
    return fiber.normalized_velocity * inputs.parameters.max_fiber_velocity


# ---- Maximum fiber velocity


class SlowerFibers(MuscleAlteration):
    """Reduce the maximum fiber velocity."""

    #: Negative natural logarithm of the factor on the maximum fiber velocity.
    slowing: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        slower = inputs.parameters.max_fiber_velocity * jnp.exp(-self.slowing)
        return eqx.tree_at(lambda tree: tree.parameters.max_fiber_velocity, inputs, slower)


def _slow_fibers(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_slow_down, jnp.ones(len(context.muscles)))),)


def _slow_down(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=SlowerFibers(effect_sizes[0] * each))


def _velocity_factor(effect_sizes: EffectSizes) -> EffectSizes:
    return jnp.exp(-effect_sizes)


SLOW_FIBERS = EffectDefinition(
    id="slow_fibers",
    meaning="muscle fibers shorten more slowly than assumed",
    family="activation_and_muscle",
    parameters=(
        EffectParameter(
            name="slowing",
            unit="1",
            prior_sd=0.35,
            sign=1,
            meaning="negative natural logarithm of the factor on maximum fiber velocity",
            source="generic 10 optimal fiber lengths a second: Zajac 1989, Crit Rev Biomed Eng 17:359",
            limit=1.6,
        ),
    ),
    variants=_slow_fibers,
    reported=(("max_velocity_factor", "1"),),
    to_reported=lambda context: Partial(_velocity_factor),
    experiment=THIRD_WALKING_SPEED,
)


# ---- Optimal fiber length


class ActivationDependentLength(MuscleAlteration):
    """Lengthen the optimal fiber length of a muscle the more, the less active it is."""

    #: Share by which the optimal fiber length at zero activation exceeds that at full activation.
    gain: Float[Array, "*muscle"]

    def fibers(self, inputs: MuscleInputs, activation: Float[Array, "trial frame"]) -> MuscleInputs:
        """See `MuscleAlteration`."""
        factor = 1.0 + self.gain * (1.0 - activation)
        before = inputs.length_factor
        return replace(inputs, length_factor=factor if before is None else before * factor)


def _activation_dependent_fiber_length(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_lengthen_by_activation, jnp.ones(len(context.muscles)))),)


def _lengthen_by_activation(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=ActivationDependentLength(effect_sizes[0] * each))


ACTIVATION_DEPENDENT_FIBER_LENGTH = EffectDefinition(
    id="activation_dependent_fiber_length",
    meaning="muscles at low activation are strongest at a greater length",
    family="activation_and_muscle",
    parameters=(
        EffectParameter(
            name="length_gain",
            unit="1",
            prior_sd=0.15,
            sign=1,
            meaning="share by which optimal fiber length at no activation exceeds that at full activation",
            source="Lloyd & Besier 2003, doi:10.1016/S0021-9290(03)00010-1",
            limit=0.6,
        ),
    ),
    variants=_activation_dependent_fiber_length,
    experiment=ISOMETRIC_RAMPS,
)


# ---- History dependence

#: Time constants with which the history of stretch decays, s.
_MEMORIES = (0.25, 0.5)
_ENHANCEMENT_SOURCE = "up to 24.8 +- 32.5 % of force at 30 % of maximum, in 8 of 13 people"


class ForceHistory(MuscleAlteration):
    """Enhance active force after active stretch and depress it after active shortening."""

    #: Shares of active force per optimal fiber length of active stretch and of active shortening.
    enhancement: Float[Array, "*muscle"]
    depression: Float[Array, "*muscle"]
    #: Time constant, s.
    memory: Float[Array, "*muscle"]

    def force(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """See `MuscleAlteration`. The history of active stretch decays exponentially."""
        velocity = _fiber_velocity(fiber, inputs)
        step = inputs.emg.step
        decay = jnp.exp(-step / self.memory)

        def advance(state, inputs):
            state = decay * state + step * inputs
            return state, state

        stretched, shortened = (
            periodic_scan(advance, jnp.zeros_like(step), activation * jnp.maximum(sign * velocity, 0.0))
            for sign in (1.0, -1.0)
        )
        factor = 1.0 + self.enhancement * stretched - self.depression * shortened
        return replace(fiber, active_force=fiber.active_force * factor)


def _force_enhancement(context: Context) -> tuple[Variant, ...]:
    ones = jnp.ones(len(context.muscles))
    return tuple(
        Variant(Partial(_apply_history, memory * ones), f"memory of {memory:g} s") for memory in _MEMORIES
    )


def _apply_history(memory: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    each = jnp.ones_like(memory)
    return Alteration(muscle=ForceHistory(effect_sizes[0] * each, effect_sizes[1] * each, memory))


# The variants are the time constants.
FORCE_ENHANCEMENT = EffectDefinition(
    id="force_enhancement",
    meaning="force depends on whether the muscle was stretched or shortened just before",
    family="activation_and_muscle",
    parameters=(
        EffectParameter(
            name="enhancement",
            unit="1",
            prior_sd=1.0,
            sign=1,
            meaning="share of active force gained for each optimal fiber length of active stretch",
            source=_ENHANCEMENT_SOURCE,
            limit=5.0,
        ),
        EffectParameter(
            name="depression",
            unit="1",
            prior_sd=0.5,
            sign=1,
            meaning="share of active force lost for each optimal fiber length of active shortening",
            source=_ENHANCEMENT_SOURCE,
            limit=3.0,
        ),
    ),
    variants=_force_enhancement,
    experiment=STRETCH_AND_HOLD,
)


# ---- Short-range stiffness

#: Stretch over which short-range stiffness acts, in optimal fiber lengths.
_SHORT_RANGE = 0.01
#: Fiber velocity below which a muscle counts as held, in optimal fiber lengths per second.
_HELD_VELOCITY = 0.05
#: Time constant with which a held muscle becomes stiff, s.
_HOLD_TIME = 0.2


class ShortRangeStiffness(MuscleAlteration):
    """Stiffen a muscle that was held at constant length, until it has moved by the short range."""

    #: Active forces per optimal fiber length.
    stiffness: Float[Array, "*muscle"]

    def force(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """See `MuscleAlteration`."""
        velocity = _fiber_velocity(fiber, inputs)
        step = inputs.emg.step
        decay = jnp.exp(-step / _HOLD_TIME)

        def advance(state, velocity):
            held, moved = state
            yielding = jnp.exp(-step * jnp.abs(velocity) / _SHORT_RANGE)
            moved = yielding * (moved + step * velocity)
            still = jnp.exp(-((velocity / _HELD_VELOCITY) ** 2))
            out = held * moved
            return (decay * held + (1.0 - decay) * still, moved), out

        zero = jnp.zeros_like(step)
        stretch = periodic_scan(advance, (zero, zero), velocity)
        return replace(fiber, active_force=fiber.active_force * (1.0 + self.stiffness * stretch))


def _short_range_stiffness(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_stiffen, jnp.ones(len(context.muscles)))),)


def _stiffen(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=ShortRangeStiffness(effect_sizes[0] * each))


# A negative control: muscles are never held at constant length in gait.
SHORT_RANGE_STIFFNESS = EffectDefinition(
    id="short_range_stiffness",
    meaning="muscles at rest are stiff when they begin to move",
    family="activation_and_muscle",
    parameters=(
        EffectParameter(
            name="stiffness",
            unit="1",
            prior_sd=22.0,
            sign=1,
            meaning="short-range stiffness in active forces for each optimal fiber length",
            source="20 to 25 forces an optimal fiber length",
            limit=100.0,
        ),
    ),
    variants=_short_range_stiffness,
    negative_control=True,
    experiment=STRETCH_AND_HOLD,
)
