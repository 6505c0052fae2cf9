"""Motion that was not what was recorded: skin that slides over bone, events that jitter."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.gap.context import Context, PathsOfAngles
from wrapjax.gap.cycles import bell
from wrapjax.gap.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.gap.effects.emg import later
from wrapjax.gap.effects.geometry import added_to_paths
from wrapjax.geometry import PathState
from wrapjax.model import Alteration

Amounts = Float[Array, " parameter"]

#: When in the cycle skin slides most, by what happens then.
_SLIDES = {"loading": 0.10, "early swing": 0.70}
_WIDTH = 0.10


def soft_tissue_artifact(context: Context) -> Effect | NotTestable:
    """Change the angles that paths are laid through: at a part of the cycle, and in proportion to them.

    To first order, moment arms included. Shapes: when in the cycle. What inverse dynamics make of other
    angles is not part of it.
    """
    if context.paths_of_angles is None:
        return NotTestable("soft_tissue_artifact", "paths are not known as a function of joint angles")
    source = "thigh 10, shank 7 degrees: PMC8631460"
    slides = [
        EffectParameter(
            name=f"slide_{name}",
            unit="rad",
            prior_sd=0.06,
            sign=0,
            meaning=f"error of {name} where it is largest",
            source=source,
            limit=0.3,
            part=name,
        )
        for name in context.coordinates
    ]
    shares = [
        EffectParameter(
            name=f"share_{name}",
            unit="1",
            prior_sd=0.06,
            sign=0,
            meaning=f"error of {name} as a share of the angle",
            source=source,
            limit=0.3,
            part=name,
        )
        for name in context.coordinates
    ]
    variants = tuple(
        Variant(Partial(_slid, _slopes(context.paths_of_angles, *_errors(context, center))), when)
        for when, center in _SLIDES.items()
    )
    return Effect("soft_tissue_artifact", "kinematics", (*slides, *shares), variants)


def _errors(context: Context, center: float) -> tuple[Array, Array]:
    """Errors of angles and of their rates for a unit of each amount."""
    value, by_phase = bell(context.phase, center, _WIDTH)
    shape = context.angles.shape
    slide = np.broadcast_to(value, shape)
    slide_rate = np.broadcast_to(by_phase / context.duration[:, None, None], shape)
    alone = np.eye(shape[1])[:, None, :, None]
    angles = np.concatenate([slide[None] * alone, context.angles[None] * alone])
    rates = np.concatenate([slide_rate[None] * alone, context.velocities[None] * alone])
    return jnp.asarray(angles), jnp.asarray(rates)


@jax.jit
def _slopes(
    paths: PathsOfAngles,
    angles: Float[Array, "parameter trial coordinate frame"],
    rates: Float[Array, "parameter trial coordinate frame"],
) -> PathState:
    """How paths change with each amount; leaves lead with ``parameter``."""
    recorded = jnp.zeros(angles.shape[1:]), jnp.zeros(rates.shape[1:])
    return jax.lax.map(lambda error: jax.jvp(paths, recorded, error)[1], (angles, rates))


def _slid(slopes: PathState, amounts: Amounts) -> Alteration:
    change = jax.tree.map(lambda leaf: jnp.tensordot(amounts, leaf, axes=1), slopes)
    return Alteration(paths=Partial(added_to_paths, change))


def event_jitter(context: Context) -> Effect | NotTestable:
    """Shift the EMG of each cycle against its motion, by a share of the cycle."""
    cycles = context.reference.trials
    if len(cycles) < 2:
        return NotTestable("event_jitter", "the shift of one cycle alone is a delay")
    parameters = tuple(
        EffectParameter(
            name=f"shift_{name}",
            unit="1",
            prior_sd=0.02,
            sign=0,
            meaning=f"share of the cycle by which the EMG of {name} is late",
            source="2 % of a cycle",
            limit=0.1,
        )
        for name in cycles
    )
    own = np.array([[one == name for one in cycles] for name in context.trials], dtype=float)
    durations = jnp.asarray(own * context.duration[:, None])
    form = Partial(_jitter, jnp.ones(len(context.muscles)), durations)
    return Effect("event_jitter", "kinematics", parameters, (Variant(form),))


def _jitter(
    each: Float[Array, " muscle"], durations: Float[Array, "trial parameter"], amounts: Amounts
) -> Alteration:
    return Alteration(emg=Partial(later, each[:, None] * (durations @ amounts)[None]))
