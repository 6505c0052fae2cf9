"""Effects of EMG channels that were exchanged, or lost in one recording."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, Int

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectSizes, Variant
from wrapjax.diagnosis.effects.emg import (
    CONSTANT_TERM,
    add_channels,
    channel_of_muscle,
    driving_channels,
    first_muscles,
)
from wrapjax.diagnosis.effects.experiments import REPEATED_FIRST_TRIAL, SINGLE_MUSCLE_CONTRACTIONS
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration
from wrapjax.muscle.excitation import EmgSpline
from wrapjax.subject.gait_activity import exchanged_channels

#: Effect size of an exchanged or lost channel is one; smaller ones let the fit move towards it.
_PRIOR_SD, _LIMIT = 0.5, 1.25
#: Size of an envelope under one condition, relative to the others, below which its channel is taken as lost.
_LOST = 0.1

# ---- Exchanged channels


def _pairs(context: Context) -> list[tuple[str, str]]:
    """List the pairs of channels whose envelopes have each other's usual phases of activity in walking.

    Moments alone do not show an exchange, to which the calibration has adapted before the effect is scored;
    and a share of an exchange, of any pair, resembles much that is amiss in a recording.
    """
    every = context.reference
    if not every.is_gait.any():
        return []
    frames = slice(every.padding, every.padding + every.angles.shape[-1])
    first = first_muscles(every)
    of_gait = np.asarray(every.envelopes)[:, every.is_gait, CONSTANT_TERM, frames]
    typical = np.median(of_gait, axis=1)
    channels = driving_channels(every)
    muscles: dict[str, list[str]] = {name: [] for name in channels}
    for muscle, number in zip(every.muscles, every.muscle_channels, strict=True):
        muscles[every.channels[number]].append(muscle)
    return list(exchanged_channels({name: typical[first[name]] for name in channels}, muscles))


def _emg_channel_swap(context: Context) -> tuple[Variant, ...]:
    channels, first_muscle = driving_channels(context), first_muscles(context)
    pairs = _pairs(context)
    numbers = jnp.asarray([[channels.index(name) for name in pair] for pair in pairs])
    sources = jnp.asarray([[first_muscle[name] for name in pair] for pair in pairs])
    return (Variant(Partial(_exchange, channel_of_muscle(context), numbers, sources)),)


def _exchange(
    channel_of: Int[Array, " muscle"],
    pairs: Int[Array, "pair 2"],
    sources: Int[Array, "pair 2"],
    effect_sizes: EffectSizes,
) -> Alteration:
    """Give the channels of each pair the other's envelope; a pair's first muscles represent its channels."""
    shares = jnp.zeros((channel_of.size, channel_of.size))
    for own, other in ((0, 1), (1, 0)):
        shares = shares.at[pairs[:, own], sources[:, other]].add(effect_sizes)
        shares = shares.at[pairs[:, own], sources[:, own]].add(-effect_sizes)
    return Alteration(emg=Partial(add_channels, shares[channel_of]))


EMG_CHANNEL_SWAP = EffectDefinition(
    id="emg_channel_swap",
    meaning="two EMG channels were exchanged",
    family="emg",
    requirements=(
        Requirement(
            "two channels with each other's usual phases of activity in walking",
            lambda context: (
                ""
                if _pairs(context)
                else "no two channels have each other's usual phases of activity in walking"
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=lambda context: [
                {"first": first, "second": second} for first, second in _pairs(context)
            ],
            name="{first}_with_{second}",
            unit="1",
            prior_sd=_PRIOR_SD,
            sign=1,
            meaning="share of {first} and {second} that each has of the other; 1 where they are exchanged",
            source="1 for channels that are exchanged",
            limit=_LIMIT,
            part="{first}_with_{second}",
        ),
    ),
    variants=_emg_channel_swap,
    experiment=SINGLE_MUSCLE_CONTRACTIONS,
)


# ---- Channels lost in one recording


def _lost_channels(context: Context) -> list[str]:
    """List the channels that record next to nothing under one condition.

    An envelope that is merely smaller there is a matter of gain; to replace it would remove whatever differs
    between conditions, and be an effect of every recording.
    """
    every = context.reference
    size = np.sqrt(np.mean(np.square(np.asarray(every.envelopes)[:, :, CONSTANT_TERM]), axis=2))
    first = first_muscles(every)
    return [
        name
        for name in driving_channels(every)
        if any(
            np.median(size[first[name], cycles]) < _LOST * np.median(size[first[name], ~cycles])
            for cycles in every.conditions.values()
        )
    ]


def _all_recorded(context: Context) -> str:
    if _lost_channels(context):
        return ""
    return "no channel recorded next to nothing in one recording or at one speed"


def _emg_channel_loss(context: Context) -> tuple[Variant, ...]:
    every = context.reference
    return tuple(
        Variant(
            Partial(
                _restore,
                _place_of_lost(context),
                jnp.asarray(cycles, float),
                every.envelopes[:, ~every.conditions[label]].mean(axis=1),
            ),
            label,
        )
        for label, cycles in context.conditions.items()
    )


def _place_of_lost(context: Context) -> Int[np.ndarray, " muscle"]:
    """Find the place of each muscle's channel among `_lost_channels`; -1 where it is not lost."""
    lost, driving = _lost_channels(context), driving_channels(context)
    channels = np.asarray(channel_of_muscle(context))
    return np.array([lost.index(driving[one]) if driving[one] in lost else -1 for one in channels])


def _restore(
    lost: Int[Array | np.ndarray, " muscle"],
    cycles: Float[Array, " trial"],
    envelope: Float[Array, "muscle 4 interval"],
    effect_sizes: EffectSizes,
) -> Alteration:
    sizes = jnp.where(lost < 0, 0.0, effect_sizes[lost])
    share = sizes[:, None] * cycles[None]
    return Alteration(emg=Partial(_replace_share, share[..., None, None], envelope[:, None]))


def _replace_share(
    share: Float[Array, "muscle trial 1 1"], envelope: Float[Array, "muscle 1 4 interval"], emg: EmgSpline
) -> EmgSpline:
    return replace(emg, coefficients=emg.coefficients + share * (envelope - emg.coefficients))


# The envelope that was lost is estimated by the mean of the other cycles at the same phase.
EMG_CHANNEL_LOSS = EffectDefinition(
    id="emg_channel_loss",
    meaning="a channel did not record its muscle in one recording or at one speed",
    family="emg",
    requirements=(
        Requirement(
            "a channel that records next to nothing in one of several recordings or at one speed",
            _all_recorded,
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=lambda context: [{"channel": name} for name in _lost_channels(context)],
            name="lost_{channel}",
            unit="1",
            prior_sd=_PRIOR_SD,
            sign=1,
            meaning="share of {channel} that was not recorded; 1 where the electrode had come off",
            source="1 for an electrode that has come off",
            limit=_LIMIT,
            part="{channel}",
        ),
    ),
    variants=_emg_channel_loss,
    experiment=REPEATED_FIRST_TRIAL,
)
