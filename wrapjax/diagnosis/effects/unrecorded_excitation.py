"""Excitation that the EMG does not show: muscles without a channel, and stretch reflexes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant
from wrapjax.diagnosis.effects.experiments import FINE_WIRE_EMG, PASSIVE_STRETCH_AT_TWO_SPEEDS
from wrapjax.diagnosis.effects.periodic import delayed, periodic_splines, with_padding
from wrapjax.diagnosis.effects.spastic_groups import (
    PARETIC_LEG,
    each_spastic_group,
    muscles_of_spastic_groups,
    recorded_spastic_groups,
)
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs, fiber_parameters
from wrapjax.muscle.hill import rigid_tendon_fiber
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles

#: Number of periodic splines whose sum is an unrecorded activation.
SPLINES = 10
#: Exponent of walking speed in the size of an unrecorded activation.
_SPEED_POWER = 0.5
#: Time from stretch to activation (s): reflex arc and electromechanical delay.
_REFLEX_DELAY = 0.06
#: Thresholds of the reflex, as shares of the largest recorded stretch velocity.
_THRESHOLDS = (0.0, 0.4)
_REFLEX_SOURCE = "Falisse et al. 2018, doi:10.1371/journal.pone.0208811"

MUSCLES_WITHOUT_EMG = Requirement(
    "muscles without EMG whose paths can be computed",
    lambda context: context.no_undriven_muscles if context.undriven_muscles is None else "",
)


def _select_muscles(others: UndrivenMuscles | None, names: tuple[str, ...]) -> UndrivenMuscles:
    assert others is not None, "required before variants are built"
    rows = np.array([others.names.index(name) for name in names])
    return UndrivenMuscles(
        names=names,
        groups=(),
        curves=others.curves,
        parameters=jax.tree.map(lambda leaf: leaf[rows], others.parameters),
        path=jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], others.path),
    )


def active_moments(
    muscles: UndrivenMuscles, activation: Float[Array, "muscle trial frame"]
) -> Float[Array, "muscle trial coordinate frame"]:
    """Compute the moments (N m) of the active force of each muscle, with rigid tendons."""

    def one_muscle(path, parameters, activation):
        fiber = rigid_tendon_fiber(
            muscles.curves, activation, path.length, path.velocity, **fiber_parameters(parameters)
        )
        return path.moment_arm * fiber.active_force[:, None, :]

    return jax.vmap(one_muscle)(muscles.path, muscles.parameters, activation)


# ---- Activation of muscles without EMG


def drive_over_cycle(effect_sizes: Float[Array, " parameter"], frames: int) -> Float[Array, " frame"]:
    """Compute the activation of muscles without EMG over the gait cycle, from the sizes of `MISSING_DRIVE`.

    The activation is that at the mean walking speed.
    """
    return jnp.asarray(periodic_splines(np.linspace(0.0, 1.0, frames), SPLINES)) @ effect_sizes


def _speed_factor(context: Context) -> Float[np.ndarray, " trial"]:
    """Compute the size of an unrecorded activation in each gait cycle; zero in other tasks.

    Where no EMG tells what these muscles did, other tasks show nothing of their activation in gait.
    """
    gait, speeds = context.is_gait, context.reference.speeds[context.reference.is_gait]
    if not np.isfinite(speeds).all() or not (speeds > 0.0).all():
        return gait.astype(float)
    own = np.where(gait, context.speeds, 0.0)
    return np.asarray((own / speeds.mean()) ** _SPEED_POWER)


def _missing_drive(context: Context) -> tuple[Variant, ...]:
    others = context.undriven_muscles
    assert others is not None, "required before variants are built"
    splines = periodic_splines(context.phase, SPLINES)
    basis = jnp.asarray(_speed_factor(context)[:, None, None] * splines[None])
    return tuple(
        Variant(Partial(_add_driven_muscles, _select_muscles(others, members), basis), group)
        for group, members in others.groups
    )


def _add_driven_muscles(
    muscles: UndrivenMuscles, basis: Float[Array, "trial frame spline"], effect_sizes: EffectSizes
) -> Alteration:
    activation = basis @ effect_sizes
    each = jnp.broadcast_to(activation, muscles.path.length.shape)
    return Alteration(moment=active_moments(muscles, each).sum(axis=0))


def _peak_activation(splines: Float[Array, "frame spline"], effect_sizes: EffectSizes) -> Float[Array, "1"]:
    return jnp.max(splines @ effect_sizes)[None]


# Muscles have the subject's parameters; their passive force is not counted. The variants are the groups of
# muscles that one drive excites.
MISSING_DRIVE = EffectDefinition(
    id="missing_drive",
    meaning="muscles without an electrode are active",
    family="control",
    requirements=(MUSCLES_WITHOUT_EMG,),
    parameters=tuple(
        EffectParameter(
            name=f"activation_{round(100 * number / SPLINES)}_percent",
            unit="1",
            prior_sd=0.3,
            sign=1,
            meaning=f"activation of the group about {round(100 * number / SPLINES)} % of the cycle",
            source="peaks of deep flexors of 0.3 to 0.6; Ao et al. 2022, doi:10.3389/fbioe.2022.962959",
            limit=1.0,
        )
        for number in range(SPLINES)
    ),
    variants=_missing_drive,
    reported=(("peak_activation", "1"),),
    to_reported=lambda context: Partial(
        _peak_activation, jnp.asarray(periodic_splines(context.phase, SPLINES))
    ),
    experiment=FINE_WIRE_EMG,
)


# ---- Stretch reflexes


class AddedExcitation(MuscleAlteration):
    """Add to excitation, frame by frame."""

    added: Float[Array, "*muscle trial padded_frame"]

    def excitation(
        self, excitation: Float[Array, "trial padded_frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial padded_frame"]:
        """See `MuscleAlteration`."""
        return excitation + self.added


def _reflex(
    context: Context,
    velocity: Float[Array, "muscle trial frame"],
    fastest: Float[Array, " muscle"],
    threshold: float,
) -> Float[Array, "muscle trial frame"]:
    """Compute the stretch velocity above the threshold, delayed; 1 at the largest recorded velocity."""
    relative = velocity / jnp.maximum(fastest, 1e-6)[:, None, None]
    above = jnp.maximum(relative - threshold, 0.0) / (1.0 - threshold)
    return jax.vmap(delayed, in_axes=(0, None, None))(above, _REFLEX_DELAY, jnp.asarray(context.step))


def _spasticity_unrecorded(context: Context) -> tuple[Variant, ...]:
    assert context.undriven_muscles is not None, "required before variants are built"
    variants = []
    for group, members in context.undriven_muscles.groups:
        chosen = _select_muscles(context.undriven_muscles, members)
        fastest = _select_muscles(context.reference.undriven_muscles, members).path.velocity.max(axis=(1, 2))
        for threshold in _THRESHOLDS:
            reflex = _reflex(context, chosen.path.velocity, fastest, threshold)
            label = f"{group}, above {threshold:g} of the fastest stretch"
            variants.append(Variant(Partial(_add_reflex_moments, chosen, reflex), label))
    return tuple(variants)


def _add_reflex_moments(
    muscles: UndrivenMuscles, reflex: Float[Array, "muscle trial frame"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(moment=active_moments(muscles, effect_sizes[0] * reflex).sum(axis=0))


# The variants are the groups of muscles and the thresholds.
SPASTICITY_UNRECORDED = EffectDefinition(
    id="spasticity_unrecorded",
    meaning="muscles without an electrode respond to fast stretch",
    family="control",
    requirements=(PARETIC_LEG, MUSCLES_WITHOUT_EMG),
    parameters=(
        EffectParameter(
            name="gain",
            unit="1",
            prior_sd=0.3,
            sign=1,
            meaning="excitation of the group at the fastest recorded stretch",
            source=_REFLEX_SOURCE,
            limit=2.0,
            part="gain",
        ),
    ),
    variants=_spasticity_unrecorded,
    experiment=PASSIVE_STRETCH_AT_TWO_SPEEDS,
)


def _spasticity_recorded(context: Context) -> tuple[Variant, ...]:
    belongs = muscles_of_spastic_groups(context)
    fastest = jnp.asarray(context.reference.paths.velocity).max(axis=(1, 2))
    variants = []
    for threshold in _THRESHOLDS:
        reflex = _reflex(context, jnp.asarray(context.paths.velocity), fastest, threshold)
        padded = with_padding(reflex, context)
        label = f"above {threshold:g} of the fastest stretch"
        variants.append(Variant(Partial(_add_reflex_excitation, jnp.asarray(belongs), padded), label))
    return tuple(variants)


def _add_reflex_excitation(
    belongs: Float[Array, "parameter muscle"],
    reflex: Float[Array, "muscle trial padded_frame"],
    effect_sizes: EffectSizes,
) -> Alteration:
    return Alteration(muscle=AddedExcitation((effect_sizes @ belongs)[:, None, None] * reflex))


# A negative control: the recorded EMG contains these reflexes already.
SPASTICITY_RECORDED = EffectDefinition(
    id="spasticity_recorded",
    meaning="recorded muscles respond to fast stretch, which their EMG shows already",
    family="control",
    requirements=(
        Requirement(
            "EMG of a muscle that is often spastic",
            lambda context: (
                ""
                if recorded_spastic_groups(context)
                else "none of the muscles that are often spastic has an EMG channel"
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=each_spastic_group,
            name="gain_{group}",
            unit="1",
            prior_sd=0.3,
            sign=1,
            meaning="excitation of {muscles} at the fastest recorded stretch",
            source=_REFLEX_SOURCE,
            limit=2.0,
            part="gain_{group}",
        ),
    ),
    variants=_spasticity_recorded,
    negative_control=True,
    experiment=PASSIVE_STRETCH_AT_TWO_SPEEDS,
)
