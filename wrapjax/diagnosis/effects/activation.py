"""Effects on the activation dynamics: nonlinearity, other dynamics, and the time of deactivation."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant
from wrapjax.diagnosis.effects.experiments import ISOMETRIC_RAMPS, THIRD_WALKING_SPEED
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs

#: Activation at which a lag that depends on the level of activation is zero.
_MIDDLE = 0.3
_DYNAMICS_SOURCE = (
    "differences of published activation dynamics: Rockenfeller et al. 2015, doi:10.1155/2015/585409"
)


# ---- Other activation dynamics


class ActivationLag(MuscleAlteration):
    """Add lags of the activation: with its level, by a second stage, and while it rises.

    To first order in the lag. Lags are in units of the muscle's activation time constant, so that all are of
    one kind.
    """

    with_level: Float[Array, "*muscle"]
    second_stage: Float[Array, "*muscle"]
    rising: Float[Array, "*muscle"]

    def activation(
        self, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial frame"]:
        """See `MuscleAlteration`."""
        scale = (inputs.parameters.activation_time_constant / inputs.emg.step)[:, None]
        rate = scale * _difference(activation)
        lag = self.with_level * (activation - _MIDDLE) + jnp.where(rate > 0.0, self.rising, 0.0)
        return activation - lag * rate - self.second_stage * scale * _difference(rate)


def _difference(values: Float[Array, "trial frame"]) -> Float[Array, "trial frame"]:
    """Differentiate by frames, with central differences; the ends take the value of the next frame."""
    inside = 0.5 * (values[:, 2:] - values[:, :-2])
    return jnp.concatenate([inside[:, :1], inside, inside[:, -1:]], axis=1)


def _activation_family(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_add_lag, jnp.ones(len(context.muscles)))),)


def _add_lag(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=ActivationLag(*(effect_size * each for effect_size in effect_sizes)))


# First-order dynamics with two time constants are one choice of several. Other published dynamics lag with
# the level of activation, or have two stages. No person's muscles follow exactly one of them, and the
# difference resembles other effects: hence a nuisance effect.
ACTIVATION_FAMILY = EffectDefinition(
    id="activation_family",
    meaning="muscles turn excitation into activation by other dynamics",
    family="activation_and_muscle",
    parameters=(
        EffectParameter(
            name="lag_with_level",
            unit="1",
            prior_sd=5.0,
            sign=0,
            meaning="lag, in activation time constants, for a unit of activation",
            source=_DYNAMICS_SOURCE,
            limit=50.0,
        ),
        EffectParameter(
            name="second_stage",
            unit="1",
            prior_sd=8.0,
            sign=0,
            meaning="product of the time constants of both stages, in squared activation time constants",
            source=_DYNAMICS_SOURCE,
            limit=80.0,
        ),
        EffectParameter(
            name="lag_of_rising",
            unit="1",
            prior_sd=2.0,
            sign=0,
            meaning="lag, in activation time constants, while activation rises",
            source=_DYNAMICS_SOURCE,
            limit=20.0,
        ),
    ),
    variants=_activation_family,
    nuisance=True,
)


# ---- Nonlinearity


class ActivationPower(MuscleAlteration):
    """Raise activation to the power of one plus an exponent."""

    exponent: Float[Array, "*muscle"]

    def activation(
        self, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial frame"]:
        """See `MuscleAlteration`. The factor is exactly one at exponent zero; zero activation stays zero."""
        positive = activation > 0.0
        logarithm = jnp.log(jnp.where(positive, activation, 1.0))
        return activation * jnp.exp(self.exponent * logarithm)


def _emg_nonlinearity(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_raise_activation, jnp.ones(len(context.muscles)))),)


def _raise_activation(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=ActivationPower(effect_sizes[0] * each))


EMG_NONLINEARITY = EffectDefinition(
    id="emg_nonlinearity",
    meaning="activation does not rise with EMG along the assumed curve",
    family="activation_and_muscle",
    parameters=(
        EffectParameter(
            name="exponent",
            unit="1",
            prior_sd=0.3,
            sign=0,
            meaning="activation is raised to the power of one plus this",
            source="spread of published EMG-force exponents, Lloyd & Besier 2003, "
            "doi:10.1016/S0021-9290(03)00010-1",
            limit=0.8,
        ),
    ),
    variants=_emg_nonlinearity,
    experiment=ISOMETRIC_RAMPS,
)


# ---- Deactivation


class DeactivationTime(MuscleAlteration):
    """Change the ratio of the deactivation to the activation time constant by a share of it."""

    share: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        return replace(inputs, deactivation_ratio=inputs.deactivation_ratio * (1.0 + self.share))


def _deactivation_asymmetry(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_change_deactivation, jnp.ones(len(context.muscles)))),)


def _change_deactivation(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=DeactivationTime(effect_sizes[0] * each))


DEACTIVATION_ASYMMETRY = EffectDefinition(
    id="deactivation_asymmetry",
    meaning="muscles deactivate more slowly or faster than assumed",
    family="activation_and_muscle",
    parameters=(
        EffectParameter(
            name="ratio_change",
            unit="1",
            prior_sd=0.5,
            sign=0,
            meaning="change of the ratio of deactivation to activation time, as a share of it",
            source="generic ratio 4: He et al. 1991, doi:10.1109/10.84276",
            limit=0.9,
        ),
    ),
    variants=_deactivation_asymmetry,
    experiment=THIRD_WALKING_SPEED,
)
