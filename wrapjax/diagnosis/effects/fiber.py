"""Force curves bent a little: each wraps other curves, and amount zero gives those, bit for bit.

How fibers make force: speed, length, history, and the curves themselves.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.diagnosis.effects.periodic import round_the_cycle
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs
from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.hill import FiberState
from wrapjax.subject.muscle_groups import SPASTIC_GROUPS


class _Bent(AbstractCurves):
    """Curves made of others."""

    plain: AbstractCurves

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """See `AbstractCurves`."""
        return self.plain.active_force(length)

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """See `AbstractCurves`."""
        return self.plain.force_velocity(velocity)

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """See `AbstractCurves`."""
        return self.plain.passive_force(length)


class Widths(_Bent):
    """Active force over a wider range of lengths, passive force over a longer strain."""

    #: Logarithms of both factors.
    active: Float[Array, ""]
    passive_strain: Float[Array, ""]

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Active force, its width about optimal length multiplied."""
        return self.plain.active_force(length + (length - 1.0) * jnp.expm1(-self.active))

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Passive force, its strain beyond optimal length multiplied."""
        return self.plain.passive_force(length + (length - 1.0) * jnp.expm1(-self.passive_strain))


class Curvature(_Bent):
    """Force that falls otherwise with shortening, and rises otherwise with lengthening."""

    #: Logarithms of both factors.
    shortening: Float[Array, ""]
    plateau: Float[Array, ""]

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Force factor; at rest and at the fastest shortening it stays what it is.

        While shortening, velocity is stretched as Hill's hyperbola is by another curvature; while
        lengthening, what exceeds the force at rest is multiplied.
        """
        slow = jnp.clip(1.0 + velocity, 0.0, 1.0)
        inside = (velocity > -1.0) & (velocity < 0.0)
        slower = velocity / (1.0 + jnp.expm1(-self.shortening) * slow)
        force = self.plain.force_velocity(jnp.where(inside, slower, velocity))
        at_rest = self.plain.force_velocity(jnp.zeros_like(velocity))
        more = jnp.where(velocity > 0.0, force - at_rest, 0.0)
        return force + more * jnp.expm1(self.plateau)


class PassiveShift(_Bent):
    """Passive force that begins at a shorter length."""

    #: In optimal fiber lengths.
    shift: Float[Array, ""]

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Passive force at the shorter length."""
        return self.plain.passive_force(length + self.shift)


EffectSizes = Float[Array, " parameter"]

#: Memories of residual force enhancement, s.
_MEMORIES = (0.25, 0.5)
#: Optimal fiber lengths over which short-range stiffness acts, and at which a muscle yields.
_SHORT_RANGE = 0.01
#: Optimal fiber lengths a second below which a muscle counts as held.
_HELD_VELOCITY = 0.05
#: How long it must be held, s.
_HOLD_TIME = 0.2


class SlowFibers(MuscleAlteration):
    """Make fibers slower."""

    slowing: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        slower = inputs.parameters.max_fiber_velocity * jnp.exp(-self.slowing)
        return eqx.tree_at(lambda tree: tree.parameters.max_fiber_velocity, inputs, slower)


def slow_fibers(context: Context) -> Effect:
    """Make all fibers slower than the generic ten optimal lengths a second."""
    parameter = EffectParameter(
        name="slowing",
        unit="1",
        prior_sd=0.35,
        sign=1,
        meaning="less the natural logarithm of the factor on maximum fiber velocity",
        source="generic 10 optimal fiber lengths a second: Zajac 1989, Crit Rev Biomed Eng 17:359",
        limit=1.6,
    )
    return Effect(
        id="slow_fibers",
        family="fiber",
        parameters=(parameter,),
        variants=(Variant(Partial(_slow, jnp.ones(len(context.muscles)))),),
        reported=(("max_velocity_factor", "1"),),
        reading=Partial(_factor),
    )


def _factor(effect_sizes: EffectSizes) -> EffectSizes:
    return jnp.exp(-effect_sizes)


def _slow(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=SlowFibers(effect_sizes[0] * each))


class LengthByActivation(MuscleAlteration):
    """Make optimal fiber length longer the less active a muscle is."""

    gain: Float[Array, "*muscle"]

    def fibers(self, inputs: MuscleInputs, activation: Float[Array, "trial frame"]) -> MuscleInputs:
        """See `MuscleAlteration`."""
        factor = 1.0 + self.gain * (1.0 - activation)
        before = inputs.length_factor
        return replace(inputs, length_factor=factor if before is None else before * factor)


def activation_dependent_fiber_length(context: Context) -> Effect:
    """Let fibers be strongest at a greater length the less active they are."""
    parameter = EffectParameter(
        name="length_gain",
        unit="1",
        prior_sd=0.15,
        sign=1,
        meaning="share by which optimal fiber length at no activation exceeds that at full activation",
        source="Lloyd & Besier 2003, doi:10.1016/S0021-9290(03)00010-1",
        limit=0.6,
    )
    form = Partial(_by_activation, jnp.ones(len(context.muscles)))
    return Effect("activation_dependent_fiber_length", "fiber", (parameter,), (Variant(form),))


def _by_activation(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=LengthByActivation(effect_sizes[0] * each))


class OtherCurves(MuscleAlteration):
    """Bend a muscle's force curves."""

    active_width: Float[Array, "*muscle"]
    passive_strain: Float[Array, "*muscle"]
    curvature: Float[Array, "*muscle"]
    plateau: Float[Array, "*muscle"]
    passive_shift: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        shifted = PassiveShift(inputs.curves, self.passive_shift)
        curves = Widths(shifted, self.active_width, self.passive_strain)
        return replace(inputs, curves=Curvature(curves, self.curvature, self.plateau))


def curve_family(context: Context) -> Effect:
    """Allow for other Hill curves: widths and passive strains a muscle, and all of them in common."""
    source = "spread of published curves: De Groote et al. 2016, Millard et al. 2013, Thelen 2003"

    def parameter(name: str, sd: float, meaning: str) -> EffectParameter:
        return EffectParameter(name, "1", sd, 0, f"logarithm of the factor on {meaning}", source, 1.0)

    widths = [
        parameter(f"{muscle}.active_width", 0.10, "the width of active force over length")
        for muscle in context.muscles
    ]
    strains = [
        parameter(f"{muscle}.passive_strain", 0.12, "the strain that a passive force takes")
        for muscle in context.muscles
    ]
    common = [
        parameter("shortening_curvature", 0.25, "the curvature of force over shortening velocity"),
        parameter("lengthening_plateau", 0.12, "what fast lengthening adds to force"),
        # A family's curves are the same in all muscles.
        parameter("active_width", 0.15, "the width of active force over length, of all muscles"),
        parameter("passive_strain", 0.25, "the strain that a passive force takes, of all muscles"),
        EffectParameter(
            "passive_shift", "1", 0.08, 0, "optimal fiber lengths by which passive force begins early", source
        ),
    ]
    form = Partial(_other_curves, jnp.ones(len(context.muscles)))
    return Effect(
        id="curve_family",
        family="fiber",
        parameters=(*widths, *strains, *common),
        variants=(Variant(form),),
        nuisance=True,
    )


def _other_curves(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    widths, strains, (curvature, plateau, width, strain, shift) = (
        effect_sizes[: each.size],
        effect_sizes[each.size : 2 * each.size],
        effect_sizes[2 * each.size :],
    )
    return Alteration(
        muscle=OtherCurves(
            widths + width * each, strains + strain * each, curvature * each, plateau * each, shift * each
        )
    )


class History(MuscleAlteration):
    """Enhance active force after active stretch, depress it after active shortening."""

    enhancement: Float[Array, "*muscle"]
    depression: Float[Array, "*muscle"]
    memory: Float[Array, "*muscle"]

    def force(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """See `MuscleAlteration`. What was stretched is remembered with an exponential decay."""
        velocity = _fiber_velocity(fiber, inputs)
        step = inputs.emg.step
        kept = jnp.exp(-step / self.memory)

        def advance(state, inputs):
            state = kept * state + step * inputs
            return state, state

        stretched, shortened = (
            round_the_cycle(advance, jnp.zeros_like(step), activation * jnp.maximum(sign * velocity, 0.0))
            for sign in (1.0, -1.0)
        )
        factor = 1.0 + self.enhancement * stretched - self.depression * shortened
        return replace(fiber, active_force=fiber.active_force * factor)


def force_enhancement(context: Context) -> Effect:
    """Let force depend on what a muscle did before, all muscles alike. Shapes: how long it lasts."""
    source = "up to 24.8 +- 32.5 % of force at 30 % of maximum, in 8 of 13 people"
    parameters = (
        EffectParameter(
            name="enhancement",
            unit="1",
            prior_sd=1.0,
            sign=1,
            meaning="share of active force gained for each optimal fiber length of active stretch",
            source=source,
            limit=5.0,
        ),
        EffectParameter(
            name="depression",
            unit="1",
            prior_sd=0.5,
            sign=1,
            meaning="share of active force lost for each optimal fiber length of active shortening",
            source=source,
            limit=3.0,
        ),
    )
    ones = jnp.ones(len(context.muscles))
    variants = tuple(
        Variant(Partial(_history, memory * ones), f"memory of {memory:g} s") for memory in _MEMORIES
    )
    return Effect("force_enhancement", "fiber", parameters, variants)


def _history(memory: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    each = jnp.ones_like(memory)
    return Alteration(muscle=History(effect_sizes[0] * each, effect_sizes[1] * each, memory))


class ShortRange(MuscleAlteration):
    """Stiffen a muscle that was held, until it has moved by a hundredth of its length."""

    stiffness: Float[Array, "*muscle"]

    def force(
        self, fiber: FiberState, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> FiberState:
        """See `MuscleAlteration`."""
        velocity = _fiber_velocity(fiber, inputs)
        step = inputs.emg.step
        kept = jnp.exp(-step / _HOLD_TIME)

        def advance(state, velocity):
            held, moved = state
            yielding = jnp.exp(-step * jnp.abs(velocity) / _SHORT_RANGE)
            moved = yielding * (moved + step * velocity)
            still = jnp.exp(-((velocity / _HELD_VELOCITY) ** 2))
            out = held * moved
            return (kept * held + (1.0 - kept) * still, moved), out

        nothing = jnp.zeros_like(step)
        stretch = round_the_cycle(advance, (nothing, nothing), velocity)
        return replace(fiber, active_force=fiber.active_force * (1.0 + self.stiffness * stretch))


def short_range_stiffness(context: Context) -> Effect:
    """Stiffen muscles at the onset of motion after rest: a negative control, as gait never rests."""
    parameter = EffectParameter(
        name="stiffness",
        unit="1",
        prior_sd=22.0,
        sign=1,
        meaning="short-range stiffness in active forces for each optimal fiber length",
        source="20 to 25 forces an optimal fiber length",
        limit=100.0,
    )
    form = Partial(_short_range, jnp.ones(len(context.muscles)))
    return Effect("short_range_stiffness", "fiber", (parameter,), (Variant(form),), negative_control=True)


def _short_range(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=ShortRange(effect_sizes[0] * each))


class Contracted(MuscleAlteration):
    """Let passive force begin at a shorter fiber."""

    shift: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        return replace(inputs, curves=PassiveShift(inputs.curves, self.shift))


def contracture(context: Context) -> Effect | NotTestable:
    """Shift the passive curve of muscles that shorten after a stroke, one amount a group."""
    if context.paretic is False:
        return NotTestable("contracture", "this leg is not the paretic one")
    groups = {name: context.muscle_rows(members) for name, members in SPASTIC_GROUPS.items()}
    groups = {name: rows for name, rows in groups.items() if rows}
    if not groups:
        return NotTestable("contracture", "none of the muscles that often shorten has an EMG channel")
    belongs = np.zeros((len(groups), len(context.muscles)))
    for number, rows in enumerate(groups.values()):
        belongs[number, rows] = 1.0
    parameters = tuple(
        EffectParameter(
            name=f"shift_{name}",
            unit="1",
            prior_sd=0.10,
            sign=1,
            meaning=f"optimal fiber lengths by which passive force of {name.replace('_', ' ')} begins early",
            source="ankle stiffness of 0.54 against 0.35 N m/deg at 10 degrees: Chung et al. 2004",
            limit=0.6,
            part=name,
        )
        for name in groups
    )
    form = Partial(_contracted, jnp.asarray(belongs))
    return Effect("contracture", "fiber", parameters, (Variant(form),))


def _contracted(belongs: Float[Array, "parameter muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=Contracted(effect_sizes @ belongs))


def _fiber_velocity(fiber: FiberState, inputs: MuscleInputs) -> Float[Array, "trial frame"]:
    """Optimal fiber lengths a second."""
    return fiber.normalized_velocity * inputs.parameters.max_fiber_velocity
