"""Effects on tendons: compliance, and transmission of force between muscles."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition, Requirement
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant
from wrapjax.diagnosis.effects.experiments import SINGLE_MUSCLE_CONTRACTIONS, THIRD_WALKING_SPEED
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration, CompliantTendon
from wrapjax.subject.muscle_groups import SPASTIC_GROUPS

# ---- Compliance

#: Strain of the plantar flexors' tendon as a multiple of that of other tendons, by variant.
_ACHILLES_FACTORS = {"all tendons alike": 1.0, "plantar flexors 2.5 times": 2.5}


def _tendon_compliance(context: Context) -> tuple[Variant, ...]:
    plantar_flexors = context.muscle_rows(SPASTIC_GROUPS["plantar_flexors"])
    variants = []
    for label, factor in _ACHILLES_FACTORS.items():
        each = np.ones(len(context.muscles))
        each[plantar_flexors] = factor
        variants.append(Variant(Partial(_make_compliant, jnp.asarray(each)), label))
    return tuple(variants) if plantar_flexors else (variants[0],)


def _make_compliant(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=CompliantTendon(effect_sizes[0] * each))


# Tendons are in equilibrium with their fibers in every frame.
TENDON_COMPLIANCE = EffectDefinition(
    id="tendon_compliance",
    meaning="tendons stretch under load",
    family="tendon",
    parameters=(
        EffectParameter(
            name="strain_at_max_force",
            unit="1",
            prior_sd=0.04,
            sign=1,
            meaning="strain of tendons at maximum isometric force",
            source="0.04, and 0.10 of the plantar flexors: PMC3656509; usual: half of the 0.04, since "
            "tendons stretch in everybody, and slack lengths take up a part of it (no published size)",
            limit=0.12,
            usual_sd=0.02,
        ),
    ),
    variants=_tendon_compliance,
    experiment=THIRD_WALKING_SPEED,
)


# ---- Transmission of force between muscles


def _soleus_and_gastrocnemius(context: Context) -> tuple[list[int], list[int]]:
    return context.muscle_rows(("soleus",)), context.muscle_rows(("gasmed", "gaslat"))


def _force_sharing(context: Context) -> tuple[Variant, ...]:
    soleus, gastrocnemius = _soleus_and_gastrocnemius(context)
    count = len(context.muscles)
    # Axes: parameter, muscle whose force it is, muscle along whose path it acts too. The heads of
    # gastrocnemius together take the share.
    shares = np.zeros((2, count, count))
    shares[0][np.ix_(soleus, gastrocnemius)] = 1.0 / len(gastrocnemius)
    shares[1][np.ix_(gastrocnemius, soleus)] = 1.0 / len(soleus)
    return (Variant(Partial(_share_force, jnp.asarray(shares))),)


def _share_force(shares: Float[Array, "parameter muscle muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(paths=Partial(_add_moment_arms, jnp.tensordot(effect_sizes, shares, axes=1)))


def _add_moment_arms(shares: Float[Array, "muscle muscle"], paths: PathState) -> PathState:
    """Add shares of other muscles' moment arms: a force that acts along their paths too has these as well."""
    added = jnp.einsum("mn,ntcf->mtcf", shares, paths.moment_arm)
    return eqx.tree_at(lambda tree: tree.moment_arm, paths, paths.moment_arm + added)


FORCE_SHARING = EffectDefinition(
    id="force_sharing",
    meaning="soleus and gastrocnemius transmit force to each other laterally",
    family="tendon",
    requirements=(
        Requirement(
            "EMG of soleus and gastrocnemius",
            lambda context: (
                ""
                if all(_soleus_and_gastrocnemius(context))
                else "soleus and gastrocnemius do not both have EMG"
            ),
        ),
    ),
    parameters=(
        EffectParameter(
            name="soleus_along_gastrocnemius",
            unit="1",
            prior_sd=0.05,
            sign=1,
            meaning="share of soleus's force that acts along gastrocnemius too",
            source="0 to 0.1",
            limit=0.5,
            part="soleus_along_gastrocnemius",
        ),
        EffectParameter(
            name="gastrocnemius_along_soleus",
            unit="1",
            prior_sd=0.05,
            sign=1,
            meaning="share of gastrocnemius's force that acts along soleus too",
            source="0 to 0.1",
            limit=0.5,
            part="gastrocnemius_along_soleus",
        ),
    ),
    variants=_force_sharing,
    experiment=SINGLE_MUSCLE_CONTRACTIONS,
)
