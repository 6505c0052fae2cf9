"""Effects on the force curves of muscles: other curve families, and contracture."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant
from wrapjax.diagnosis.effects.experiments import ISOMETRIC_RAMPS, SLOW_PASSIVE_MOTION
from wrapjax.diagnosis.effects.spastic_groups import (
    PARETIC_LEG,
    each_spastic_group,
    muscles_of_spastic_groups,
    recorded_spastic_groups,
)
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs
from wrapjax.muscle.curves import AbstractCurves

# ---- Modified curves: each wraps other curves, and equals them bit for bit where its changes are zero


class _ModifiedCurves(AbstractCurves):
    """Curves that are computed from other curves."""

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


class ForceLengthCurvesOfOtherWidth(_ModifiedCurves):
    """Curves with other widths of active and passive force over length."""

    #: Logarithms of the factors on the width of active force and on the strain of passive force.
    active: Float[Array, ""]
    passive_strain: Float[Array, ""]

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the active force factor; the width about the optimal length is scaled."""
        return self.plain.active_force(length + (length - 1.0) * jnp.expm1(-self.active))

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the passive force factor; the strain beyond the optimal length is scaled."""
        return self.plain.passive_force(length + (length - 1.0) * jnp.expm1(-self.passive_strain))


class ScaledForceVelocity(_ModifiedCurves):
    """Curves with another curvature while shortening, and another plateau while lengthening."""

    #: Logarithms of the factors on the curvature and on the plateau.
    shortening: Float[Array, ""]
    plateau: Float[Array, ""]

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the force factor; it is unchanged at rest and at the maximum shortening velocity.

        While shortening, velocity is scaled as another curvature scales Hill's hyperbola; while lengthening,
        the force above that at rest is multiplied.
        """
        slow = jnp.clip(1.0 + velocity, 0.0, 1.0)
        inside = (velocity > -1.0) & (velocity < 0.0)
        slower = velocity / (1.0 + jnp.expm1(-self.shortening) * slow)
        force = self.plain.force_velocity(jnp.where(inside, slower, velocity))
        at_rest = self.plain.force_velocity(jnp.zeros_like(velocity))
        more = jnp.where(velocity > 0.0, force - at_rest, 0.0)
        return force + more * jnp.expm1(self.plateau)


class ShiftedPassiveForce(_ModifiedCurves):
    """Curves whose passive force begins at a shorter length."""

    #: Shift, in optimal fiber lengths.
    shift: Float[Array, ""]

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the passive force factor."""
        return self.plain.passive_force(length + self.shift)


# ---- Curve family

_CURVES_SOURCE = "spread of published curves: De Groote et al. 2016, Millard et al. 2013, Thelen 2003"


class ChangedCurves(MuscleAlteration):
    """Change the widths, the force-velocity curve and the passive force of a muscle."""

    active_width: Float[Array, "*muscle"]
    passive_strain: Float[Array, "*muscle"]
    curvature: Float[Array, "*muscle"]
    plateau: Float[Array, "*muscle"]
    passive_shift: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        shifted = ShiftedPassiveForce(inputs.curves, self.passive_shift)
        curves = ForceLengthCurvesOfOtherWidth(shifted, self.active_width, self.passive_strain)
        return replace(inputs, curves=ScaledForceVelocity(curves, self.curvature, self.plateau))


def _curve_family(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_change_curves, jnp.ones(len(context.muscles)))),)


def _change_curves(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    widths, strains, (curvature, plateau, width, strain, shift) = (
        effect_sizes[: each.size],
        effect_sizes[each.size : 2 * each.size],
        effect_sizes[2 * each.size :],
    )
    return Alteration(
        muscle=ChangedCurves(
            widths + width * each, strains + strain * each, curvature * each, plateau * each, shift * each
        )
    )


def _each_muscle(context: Context) -> Iterable[dict[str, str]]:
    return [{"muscle": muscle} for muscle in context.muscles]


def _shared_by_all_muscles(name: str, prior_sd: float, quantity: str) -> EffectParameter:
    meaning = f"logarithm of the factor on {quantity}"
    return EffectParameter(name, "1", prior_sd, 0, meaning, _CURVES_SOURCE, limit=1.0)


# No published family of curves fits every person, and the difference resembles other effects: hence a
# nuisance effect. Widths and passive strains can differ between muscles; a family's curves are the same in
# all of them.
CURVE_FAMILY = EffectDefinition(
    id="curve_family",
    meaning="force depends on fiber length and velocity by other curves",
    family="activation_and_muscle",
    parameters=(
        RepeatedParameter(
            repetitions=_each_muscle,
            name="{muscle}.active_width",
            unit="1",
            prior_sd=0.10,
            sign=0,
            meaning="logarithm of the factor on the width of active force over length",
            source=_CURVES_SOURCE,
            limit=1.0,
        ),
        RepeatedParameter(
            repetitions=_each_muscle,
            name="{muscle}.passive_strain",
            unit="1",
            prior_sd=0.12,
            sign=0,
            meaning="logarithm of the factor on the strain at a given passive force",
            source=_CURVES_SOURCE,
            limit=1.0,
        ),
        _shared_by_all_muscles(
            "shortening_curvature", 0.25, "the curvature of force over shortening velocity"
        ),
        _shared_by_all_muscles("lengthening_plateau", 0.12, "the force that fast lengthening adds"),
        _shared_by_all_muscles("active_width", 0.15, "the width of active force over length, of all muscles"),
        _shared_by_all_muscles("passive_strain", 0.25, "the strain at a given passive force, of all muscles"),
        EffectParameter(
            name="passive_shift",
            unit="1",
            prior_sd=0.08,
            sign=0,
            meaning="optimal fiber lengths by which passive force begins early",
            source=_CURVES_SOURCE,
        ),
    ),
    variants=_curve_family,
    nuisance=True,
    experiment=ISOMETRIC_RAMPS,
)


# ---- Contracture


class PassiveShift(MuscleAlteration):
    """Let passive force begin at a shorter fiber length."""

    #: Shift, in optimal fiber lengths.
    shift: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        return replace(inputs, curves=ShiftedPassiveForce(inputs.curves, self.shift))


def _contracture(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_shift_passive_force, jnp.asarray(muscles_of_spastic_groups(context)))),)


def _shift_passive_force(belongs: Float[Array, "parameter muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=PassiveShift(effect_sizes @ belongs))


CONTRACTURE = EffectDefinition(
    id="contracture",
    meaning="muscles are shorter at rest, as after a stroke",
    family="passive",
    requirements=(
        PARETIC_LEG,
        Requirement(
            "EMG of a muscle that often shortens after a stroke",
            lambda context: (
                ""
                if recorded_spastic_groups(context)
                else "none of the muscles that often shorten has an EMG channel"
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=each_spastic_group,
            name="shift_{group}",
            unit="1",
            prior_sd=0.10,
            sign=1,
            meaning="optimal fiber lengths by which passive force of {muscles} begins early",
            source="ankle stiffness of 0.54 against 0.35 N m/deg at 10 degrees: Chung et al. 2004",
            limit=0.6,
            part="{group}",
        ),
    ),
    variants=_contracture,
    experiment=SLOW_PASSIVE_MOTION,
)
