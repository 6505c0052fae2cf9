"""Motion that was not what was recorded: skin that slides over bone, events that jitter."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context, MeasuredChange, change_id
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.diagnosis.effects.emg import later
from wrapjax.diagnosis.effects.geometry import added_to_paths
from wrapjax.diagnosis.effects.periodic import bell
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration

EffectSizes = Float[Array, " parameter"]

#: When in the cycle skin slides most, by what happens then.
_SLIDES = {"loading": 0.10, "early swing": 0.70}
_WIDTH = 0.10


def soft_tissue_artifact(context: Context) -> Effect | NotTestable:
    """Record angles that bones did not have: at a part of the cycle, and in proportion to angles.

    To the joint's own, and to the neighbour's that drags its skin (see `dragged_by`).

    Muscles took the paths of the bones' angles, to first order, moment arms included; inverse dynamics made
    of the others what they did, where ground forces were recorded. Shapes: when in the cycle.
    """
    if context.paths_by_angle is None:
        return NotTestable("soft_tissue_artifact", "paths are not known as a function of joint angles")

    def effect_size(name: str, unit: str, part: str, meaning: str) -> EffectParameter:
        source = "thigh 10, shank 7 degrees: PMC8631460"
        return EffectParameter(name, unit, 0.06, 0, f"error of {part} {meaning}", source, 0.3, part)

    names = context.coordinates
    effect_sizes = [
        *(effect_size(f"slide_{name}", "rad", name, "where it is largest") for name in names),
        *(effect_size(f"share_{name}", "1", name, "as a share of the angle") for name in names),
        *(
            effect_size(
                f"share_of_{names[other]}_in_{names[row]}",
                "1",
                names[row],
                f"as a share of the angle of {names[other]}",
            )
            for row, other in enumerate(dragged_by(names))
        ),
    ]
    variants = tuple(
        Variant(
            Partial(
                _misread,
                context.paths_by_angle,
                context.paths.moment_arm,
                *_errors(context, *shape),
                context.measured_changes.get(change_id("soft_tissue_artifact", when)),
            ),
            when,
        )
        for when, shape in sliding(context.phase).items()
    )
    return Effect("soft_tissue_artifact", "kinematics", tuple(effect_sizes), variants)


def dragged_by(coordinates: Sequence[str]) -> tuple[int, ...]:
    """Number, for each coordinate, the joint that moves its skin most beside itself.

    The knee's flexion drags the skin of thigh and shank, the hip's that over the knee. Empty where either is
    not among them.
    """
    knee, hip = (
        next((row for row, name in enumerate(coordinates) if name.startswith(stem)), None)
        for stem in ("knee_angle", "hip_flexion")
    )
    if knee is None or hip is None:
        return ()
    return tuple(hip if row == knee else knee for row in range(len(coordinates)))


def sliding(
    phase: Float[np.ndarray, " frame"],
) -> dict[str, tuple[Float[np.ndarray, " frame"], Float[np.ndarray, " frame"]]]:
    """Give how skin slides over the cycle, one where it does so most, and the derivative by phase."""
    return {when: bell(phase, center, _WIDTH) for when, center in _SLIDES.items()}


def _errors(
    context: Context, slide: Float[np.ndarray, " frame"], by_phase: Float[np.ndarray, " frame"]
) -> tuple[Array, Array]:
    """Errors of angles and of their rates for a unit of sliding, then of both shares."""
    shape = context.angles.shape
    angles = [np.broadcast_to(slide, shape), context.angles]
    rates = [np.broadcast_to(by_phase / context.duration[:, None, None], shape), context.velocities]
    if neighbours := dragged_by(context.coordinates):
        angles.append(context.angles[:, neighbours])
        rates.append(context.velocities[:, neighbours])
    return jnp.asarray(np.stack(angles)), jnp.asarray(np.stack(rates))


def _misread(
    by_angle: PathState,
    moment_arm: Float[Array, "muscle trial coordinate frame"],
    angles: Float[Array, "kind trial coordinate frame"],
    rates: Float[Array, "kind trial coordinate frame"],
    change: MeasuredChange | None,
    effect_sizes: EffectSizes,
) -> Alteration:
    own = effect_sizes.reshape(len(angles), -1)
    # Bones lag behind what was recorded by the error.
    angle, rate = (-jnp.einsum("kc,ktcf->tcf", own, errors) for errors in (angles, rates))
    length, velocity, arm = (
        jnp.einsum("tcf,mct...f->mt...f", angle, leaf)
        for leaf in (by_angle.length, by_angle.velocity, by_angle.moment_arm)
    )
    # Where an angle changes faster than was recorded, length falls faster by the moment arm.
    velocity -= jnp.einsum("tcf,mtcf->mtf", rate, moment_arm)
    return Alteration(
        paths=Partial(added_to_paths, PathState(length, velocity, arm)),
        moment=None if change is None else change(effect_sizes),
    )


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
    each: Float[Array, " muscle"], durations: Float[Array, "trial parameter"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(emg=Partial(later, each[:, None] * (durations @ effect_sizes)[None]))
