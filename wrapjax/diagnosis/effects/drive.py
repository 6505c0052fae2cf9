"""Drive that no electrode heard: muscles without a channel, and reflexes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.diagnosis.effects.periodic import bumps, delayed, with_padding
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs, fiber_parameters
from wrapjax.muscle.hill import rigid_tendon_fiber
from wrapjax.path_sources.undriven_muscles import UndrivenMuscles
from wrapjax.subject.muscle_groups import SPASTIC_GROUPS

#: Bumps that an unrecorded drive is made of, round the cycle.
BUMPS = 10
#: Drive grows with the square root of walking speed.
_SPEED_POWER = 0.5
#: From stretch to activation (s): reflex arc and electromechanical delay.
_REFLEX_DELAY = 0.06
#: Shares of the fastest recorded stretch below which a reflex is silent.
_THRESHOLDS = (0.0, 0.4)
_FALISSE = "Falisse et al. 2018, doi:10.1371/journal.pone.0208811"

EffectSizes = Float[Array, " parameter"]


class AddedExcitation(MuscleAlteration):
    """Add to excitation."""

    added: Float[Array, "*muscle trial padded_frame"]

    def excitation(
        self, excitation: Float[Array, "trial padded_frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial padded_frame"]:
        """See `MuscleAlteration`."""
        return excitation + self.added


def missing_drive(context: Context) -> Effect | NotTestable:
    """Drive a group of muscles that have no channel, by a sum of bumps round the cycle.

    Muscles have the parameters that the subject gives them; their passive force is not counted. Shapes: the
    groups.
    """
    if context.others is None:
        return NotTestable("missing_drive", context.no_others)
    parameters = tuple(
        EffectParameter(
            name=f"activation_{round(100 * place / BUMPS)}_percent",
            unit="1",
            prior_sd=0.3,
            sign=1,
            meaning=f"activation of the group about {round(100 * place / BUMPS)} % of the cycle",
            source="peaks of deep flexors of 0.3 to 0.6; Ao et al. 2022, doi:10.3389/fbioe.2022.962959",
            limit=1.0,
        )
        for place in range(BUMPS)
    )
    shape = bumps(context.phase, BUMPS)
    basis = jnp.asarray(_speed_factor(context)[:, None, None] * shape[None])
    variants = tuple(
        Variant(Partial(_driven, _members(context.others, members), basis), group)
        for group, members in context.others.groups
    )
    return Effect(
        id="missing_drive",
        family="excitation",
        parameters=parameters,
        variants=variants,
        reported=(("peak_activation", "1"),),
        reading=Partial(_peak, jnp.asarray(shape)),
    )


def drive_over_cycle(effect_sizes: Float[Array, " parameter"], frames: int) -> Float[Array, " frame"]:
    """Give the activation that amounts of `missing_drive` stand for, at the mean speed."""
    return jnp.asarray(bumps(np.linspace(0.0, 1.0, frames), BUMPS)) @ effect_sizes


def _peak(shape: Float[Array, "frame bump"], effect_sizes: EffectSizes) -> Float[Array, "1"]:
    return jnp.max(shape @ effect_sizes)[None]


def _driven(
    others: UndrivenMuscles, basis: Float[Array, "trial frame bump"], effect_sizes: EffectSizes
) -> Alteration:
    activation = basis @ effect_sizes
    each = jnp.broadcast_to(activation, others.path.length.shape)
    return Alteration(moment=_active_moment(others, each))


def _active_moment(
    others: UndrivenMuscles, activation: Float[Array, "muscle trial frame"]
) -> Float[Array, "trial coordinate frame"]:
    """Moments of the active forces of muscles without a channel, rigid tendons as everywhere."""

    def of_one(path, parameters, activation):
        fiber = rigid_tendon_fiber(
            others.curves, activation, path.length, path.velocity, **fiber_parameters(parameters)
        )
        return path.moment_arm * fiber.active_force[:, None, :]

    return jax.vmap(of_one)(others.path, others.parameters, activation).sum(axis=0)


def spasticity_unrecorded(context: Context) -> Effect | NotTestable:
    """Let a group of muscles without a channel answer to fast stretch. Shapes: groups and thresholds."""
    id = "spasticity_unrecorded"
    if context.paretic is False:
        return NotTestable(id, "this leg is not the paretic one")
    if context.others is None:
        return NotTestable(id, context.no_others)
    variants = []
    for group, members in context.others.groups:
        chosen = _members(context.others, members)
        fastest = _members(context.reference.others, members).path.velocity.max(axis=(1, 2))
        for threshold in _THRESHOLDS:
            reflex = _reflex(context, chosen.path.velocity, fastest, threshold)
            label = f"{group}, above {threshold:g} of the fastest stretch"
            variants.append(Variant(Partial(_reflex_drive, chosen, reflex), label))
    parameter = _reflex_gain("gain", "the group")
    return Effect(id, "excitation", (parameter,), tuple(variants))


def _reflex_drive(
    others: UndrivenMuscles, reflex: Float[Array, "muscle trial frame"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(moment=_active_moment(others, effect_sizes[0] * reflex))


def spasticity_recorded(context: Context) -> Effect | NotTestable:
    """Let recorded muscles answer to fast stretch: a negative control, for their EMG holds it already."""
    id = "spasticity_recorded"
    groups = {name: context.muscle_rows(members) for name, members in SPASTIC_GROUPS.items()}
    groups = {name: rows for name, rows in groups.items() if rows}
    if not groups:
        return NotTestable(id, "none of the muscles that are often spastic has an EMG channel")
    parameters = tuple(_reflex_gain(f"gain_{name}", name.replace("_", " ")) for name in groups)
    belongs = np.zeros((len(groups), len(context.muscles)))
    for number, rows in enumerate(groups.values()):
        belongs[number, rows] = 1.0
    fastest = jnp.asarray(context.reference.paths.velocity).max(axis=(1, 2))
    variants = []
    for threshold in _THRESHOLDS:
        reflex = _reflex(context, jnp.asarray(context.paths.velocity), fastest, threshold)
        padded = with_padding(reflex, context.padding)
        label = f"above {threshold:g} of the fastest stretch"
        variants.append(Variant(Partial(_added_reflex, jnp.asarray(belongs), padded), label))
    return Effect(id, "excitation", parameters, tuple(variants), negative_control=True)


def _added_reflex(
    belongs: Float[Array, "parameter muscle"],
    reflex: Float[Array, "muscle trial padded_frame"],
    effect_sizes: EffectSizes,
) -> Alteration:
    return Alteration(muscle=AddedExcitation((effect_sizes @ belongs)[:, None, None] * reflex))


def _reflex(
    context: Context,
    velocity: Float[Array, "muscle trial frame"],
    fastest: Float[Array, " muscle"],
    threshold: float,
) -> Float[Array, "muscle trial frame"]:
    """Stretch beyond the threshold, one at the fastest recorded, after the reflex's delay."""
    relative = velocity / jnp.maximum(fastest, 1e-6)[:, None, None]
    answer = jnp.maximum(relative - threshold, 0.0) / (1.0 - threshold)
    return jax.vmap(delayed, in_axes=(0, None, None))(answer, _REFLEX_DELAY, jnp.asarray(context.step))


def _reflex_gain(name: str, whose: str) -> EffectParameter:
    return EffectParameter(
        name=name,
        unit="1",
        prior_sd=0.3,
        sign=1,
        meaning=f"excitation of {whose} at the fastest recorded stretch",
        source=_FALISSE,
        limit=2.0,
        part=name,
    )


def _speed_factor(context: Context) -> Float[np.ndarray, " trial"]:
    speeds = context.reference.speeds
    if not np.isfinite(speeds).all() or not (speeds > 0.0).all():
        return np.ones(len(context.trials))
    return np.asarray((context.speeds / speeds.mean()) ** _SPEED_POWER)


def _members(others: UndrivenMuscles | None, names: tuple[str, ...]) -> UndrivenMuscles:
    """Pick muscles by name."""
    assert others is not None, "a part of a context has what the whole one has"
    rows = np.array([others.names.index(name) for name in names])
    return UndrivenMuscles(
        names=names,
        groups=(),
        curves=others.curves,
        parameters=jax.tree.map(lambda leaf: leaf[rows], others.parameters),
        path=jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], others.path),
    )
