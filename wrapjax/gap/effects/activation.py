"""From excitation to activation: nonlinearity, and how long muscles take to let go."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.gap.context import Context
from wrapjax.gap.effect import Effect, EffectParameter, Variant
from wrapjax.model import Alteration, MuscleAlteration, MuscleInputs


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


def _bent(each: Float[Array, " muscle"], amounts: Float[Array, " parameter"]) -> Alteration:
    return Alteration(muscle=Bent(amounts[0] * each))


def _slower(each: Float[Array, " muscle"], amounts: Float[Array, " parameter"]) -> Alteration:
    return Alteration(muscle=SlowerLettingGo(amounts[0] * each))
