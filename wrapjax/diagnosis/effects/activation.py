"""From excitation to activation: nonlinearity, and how long muscles take to let go."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, Variant
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs

#: Activation at which a lag that follows its level is none.
_MIDDLE = 0.3


class Bent(MuscleAlteration):
    """Raise activation to the power of one plus an exponent."""

    exponent: Float[Array, "*muscle"]

    def activation(
        self, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial frame"]:
        """See `MuscleAlteration`. A factor of exactly one at exponent zero; rest stays rest."""
        awake = activation > 0.0
        logarithm = jnp.log(jnp.where(awake, activation, 1.0))
        return activation * jnp.exp(self.exponent * logarithm)


class SlowerLettingGo(MuscleAlteration):
    """Make deactivation take longer by a share."""

    share: Float[Array, "*muscle"]

    def inputs(self, inputs: MuscleInputs) -> MuscleInputs:
        """See `MuscleAlteration`."""
        return replace(inputs, deactivation_ratio=inputs.deactivation_ratio * (1.0 + self.share))


class OtherDynamics(MuscleAlteration):
    """Let activation lag otherwise: with its level, in a second stage, and while it rises.

    To first order, and in the muscle's activation time constant, so that all amounts are of one kind.
    """

    with_level: Float[Array, "*muscle"]
    second_stage: Float[Array, "*muscle"]
    rising: Float[Array, "*muscle"]

    def activation(
        self, activation: Float[Array, "trial frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial frame"]:
        """See `MuscleAlteration`."""
        scale = (inputs.parameters.activation_time_constant / inputs.emg.step)[:, None]
        rate = scale * _slope(activation)
        lag = self.with_level * (activation - _MIDDLE) + jnp.where(rate > 0.0, self.rising, 0.0)
        return activation - lag * rate - self.second_stage * scale * _slope(rate)


def _slope(values: Float[Array, "trial frame"]) -> Float[Array, "trial frame"]:
    """Differentiate by frames; at both ends as in the frame beside them."""
    inside = 0.5 * (values[:, 2:] - values[:, :-2])
    return jnp.concatenate([inside[:, :1], inside, inside[:, -1:]], axis=1)


def activation_family(context: Context) -> Effect:
    """Let activation follow excitation by other dynamics than the model's, in all muscles alike.

    First-order dynamics with two time constants are one choice of several. Others lag as the level of
    activation has it, or pass activation on in stages. Nobody's muscles keep to one of them, and what is left
    is like other causes: so it is allowed for, and never named.
    """
    source = "what dynamics of other forms differ by: Rockenfeller et al. 2015, doi:10.1155/2015/585409"

    def effect_size(name: str, sd: float, limit: float, meaning: str) -> EffectParameter:
        return EffectParameter(name, "1", sd, 0, meaning, source, limit)

    parameters = (
        effect_size(
            "lag_with_level", 5.0, 50.0, "lag, in activation time constants, for a unit of activation"
        ),
        effect_size(
            "second_stage", 8.0, 80.0, "both stages' time constants multiplied, in the model's squared"
        ),
        effect_size("lag_of_rising", 2.0, 20.0, "lag, in activation time constants, while activation rises"),
    )
    form = Partial(_other_dynamics, jnp.ones(len(context.muscles)))
    return Effect("activation_family", "activation", parameters, (Variant(form),), nuisance=True)


def _other_dynamics(each: Float[Array, " muscle"], effect_sizes: Float[Array, " parameter"]) -> Alteration:
    return Alteration(muscle=OtherDynamics(*(effect_size * each for effect_size in effect_sizes)))


def emg_nonlinearity(context: Context) -> Effect:
    """Bend the relation of EMG to activation beyond what calibration can, in all muscles alike."""
    parameter = EffectParameter(
        name="exponent",
        unit="1",
        prior_sd=0.3,
        sign=0,
        meaning="activation is raised to the power of one plus this",
        source="spread of published EMG-force exponents, Lloyd & Besier 2003, "
        "doi:10.1016/S0021-9290(03)00010-1",
        limit=0.8,
    )
    form = Partial(_bent, jnp.ones(len(context.muscles)))
    return Effect("emg_nonlinearity", "activation", (parameter,), (Variant(form),))


def deactivation_asymmetry(context: Context) -> Effect:
    """Let muscles go more slowly, or faster, than the generic ratio to activation has it."""
    parameter = EffectParameter(
        name="ratio_change",
        unit="1",
        prior_sd=0.5,
        sign=0,
        meaning="change of the ratio of deactivation to activation time, as a share of it",
        source="generic ratio 4: He et al. 1991, doi:10.1109/10.84276",
        limit=0.9,
    )
    form = Partial(_slower, jnp.ones(len(context.muscles)))
    return Effect("deactivation_asymmetry", "activation", (parameter,), (Variant(form),))


def _bent(each: Float[Array, " muscle"], effect_sizes: Float[Array, " parameter"]) -> Alteration:
    return Alteration(muscle=Bent(effect_sizes[0] * each))


def _slower(each: Float[Array, " muscle"], effect_sizes: Float[Array, " parameter"]) -> Alteration:
    return Alteration(muscle=SlowerLettingGo(effect_sizes[0] * each))
