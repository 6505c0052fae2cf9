"""Tendons that stretch, and force that takes another way than its own tendon."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration, CompliantTendon
from wrapjax.subject.muscle_groups import SPASTIC_GROUPS

EffectSizes = Float[Array, " parameter"]

#: How many times the strain of other tendons that of the plantar flexors is.
_ACHILLES = {"all tendons alike": 1.0, "plantar flexors 2.5 times": 2.5}


def tendon_compliance(context: Context) -> Effect:
    """Let tendons stretch, in equilibrium with their fibers at every frame."""
    parameter = EffectParameter(
        name="strain_at_max_force",
        unit="1",
        prior_sd=0.04,
        sign=1,
        meaning="strain of tendons at maximum isometric force",
        source="0.04, and 0.10 of the plantar flexors: PMC3656509",
        limit=0.12,
    )
    achilles = context.muscle_rows(SPASTIC_GROUPS["plantar_flexors"])
    variants = []
    for label, factor in _ACHILLES.items():
        each = np.ones(len(context.muscles))
        each[achilles] = factor
        variants.append(Variant(Partial(_compliant, jnp.asarray(each)), label))
    kept = tuple(variants) if achilles else (variants[0],)
    return Effect("tendon_compliance", "tendon", (parameter,), kept)


def _compliant(each: Float[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(muscle=CompliantTendon(effect_sizes[0] * each))


def force_sharing(context: Context) -> Effect | NotTestable:
    """Pass a share of force between soleus and gastrocnemius, along the other's path.

    A force that takes another muscle's path too has a part of its moment arms added to its own.
    """
    soleus, gastrocnemius = context.muscle_rows(("soleus",)), context.muscle_rows(("gasmed", "gaslat"))
    if not soleus or not gastrocnemius:
        return NotTestable("force_sharing", "soleus and gastrocnemius do not both have EMG")
    count = len(context.muscles)
    shares = np.zeros((2, count, count))
    # [.., from, along]: both heads of gastrocnemius together take the share.
    shares[0][np.ix_(soleus, gastrocnemius)] = 1.0 / len(gastrocnemius)
    shares[1][np.ix_(gastrocnemius, soleus)] = 1.0 / len(soleus)
    parameters = tuple(
        EffectParameter(
            name=name,
            unit="1",
            prior_sd=0.05,
            sign=1,
            meaning=meaning,
            source="0 to 0.1",
            limit=0.5,
            part=name,
        )
        for name, meaning in (
            ("soleus_along_gastrocnemius", "share of soleus's force that acts along gastrocnemius too"),
            ("gastrocnemius_along_soleus", "share of gastrocnemius's force that acts along soleus too"),
        )
    )
    form = Partial(_shared, jnp.asarray(shares))
    return Effect("force_sharing", "tendon", parameters, (Variant(form),))


def _shared(shares: Float[Array, "parameter muscle muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(paths=Partial(_along_others, jnp.tensordot(effect_sizes, shares, axes=1)))


def _along_others(shares: Float[Array, "muscle muscle"], paths: PathState) -> PathState:
    added = jnp.einsum("mn,ntcf->mtcf", shares, paths.moment_arm)
    return eqx.tree_at(lambda tree: tree.moment_arm, paths, paths.moment_arm + added)
