"""Effects on the recorded EMG: gain, offset, filtering, crosstalk and electromechanical delay."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, Int

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant, delay_emg
from wrapjax.diagnosis.effects.experiments import (
    EMG_AT_REST,
    ISOMETRIC_RAMPS,
    REPEATED_FIRST_TRIAL,
    SINGLE_MUSCLE_CONTRACTIONS,
    SYNC_PULSE,
)
from wrapjax.diagnosis.effects.periodic import with_padding
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs
from wrapjax.muscle.excitation import EmgSpline, sharpen_emg
from wrapjax.subject.muscle_groups import are_neighbours, region_of

#: Walking speeds that differ by less than this (m/s) are one speed.
_SAME_SPEED = 0.05
#: Angles (deg) at which the gain is the recorded one, from the zero of the joint's angle.
_POSTURES = (0.0, 60.0)
#: Width (s) of the averages that separate fast changes of EMG from slow ones.
_AVERAGING_WIDTH = 0.025
#: Share of a sine of 6 Hz that these averages take away.
_SHARE_AT_6_HZ = float(-np.expm1(-0.5 * (2.0 * np.pi * 6.0 * _AVERAGING_WIDTH) ** 2)) ** 2
#: Place of the constant among the coefficients of a spline's polynomials.
CONSTANT_TERM = 3


def driving_channels(context: Context) -> tuple[str, ...]:
    """Select the channels that drive a muscle, in their order."""
    return tuple(name for number, name in enumerate(context.channels) if number in context.muscle_channels)


def channel_of_muscle(context: Context) -> Int[Array, " muscle"]:
    """Find the place among `driving_channels` of the channel that drives each muscle."""
    used = sorted(set(context.muscle_channels))
    return jnp.asarray([used.index(channel) for channel in context.muscle_channels])


def _each_channel(context: Context) -> Iterable[dict[str, str]]:
    return [{"channel": channel} for channel in driving_channels(context)]


# ---- Drift


def _emg_drift(context: Context) -> tuple[Variant, ...]:
    conditions = context.reference.conditions
    courses = {
        "": (context.order, context.reference.order),
        **{label: (cycles, conditions[label]) for label, cycles in context.conditions.items()},
    }
    channel_of = channel_of_muscle(context)
    return tuple(
        Variant(
            Partial(_undo_drift, channel_of, jnp.asarray(course, float), jnp.asarray(every.mean())), label
        )
        for label, (course, every) in courses.items()
    )


def _undo_drift(
    channel_of: Int[Array, " muscle"],
    course: Float[Array, " trial"],
    mean: Float[Array, ""],
    effect_sizes: EffectSizes,
) -> Alteration:
    """Divide by the recorded gain of each cycle relative to that at the mean of the course."""
    change = effect_sizes[channel_of][:, None]
    return Alteration(emg=Partial(_multiply_emg, (1.0 + change * mean) / (1.0 + change * course[None])))


def _multiply_emg(gain: Float[Array, "muscle trial"], emg: EmgSpline) -> EmgSpline:
    return replace(emg, coefficients=emg.coefficients * gain[:, :, None, None])


# The mean gain over the cycles is unchanged: calibration determines that one. The gain drifts from the first
# cycle to the last, or differs in one recording or at one speed.
EMG_DRIFT = EffectDefinition(
    id="emg_drift",
    meaning="a channel's gain changes during the session",
    family="emg",
    requirements=(
        Requirement(
            "cycles recorded at different times",
            lambda context: (
                "one cycle alone cannot show a gain that drifts"
                if np.ptp(context.reference.order) == 0.0
                else ""
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=_each_channel,
            name="gain_change_{channel}",
            unit="1",
            prior_sd=0.30,
            sign=0,
            meaning="change of the recorded gain of {channel}, from first to last cycle or in one condition",
            source="30 % a session",
            limit=0.9,
            part="{channel}",
        ),
    ),
    variants=_emg_drift,
    experiment=REPEATED_FIRST_TRIAL,
)


# ---- Offset


def _emg_offset(context: Context) -> tuple[Variant, ...]:
    everywhere = np.ones(len(context.trials), dtype=bool)
    return tuple(
        Variant(Partial(_remove_offset, channel_of_muscle(context), jnp.asarray(cycles, float)), label)
        for label, cycles in {"": everywhere, **context.conditions}.items()
    )


def _remove_offset(
    channel_of: Int[Array, " muscle"], cycles: Float[Array, " trial"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(emg=Partial(_subtract_from_emg, effect_sizes[channel_of][:, None] * cycles[None]))


def _subtract_from_emg(offset: Float[Array, "muscle trial"], emg: EmgSpline) -> EmgSpline:
    coefficients = emg.coefficients.at[:, :, CONSTANT_TERM].add(-offset[:, :, None])
    return replace(emg, coefficients=coefficients)


# Noise and resting level, which normalisation scales with the signal; in all recordings or in one.
EMG_OFFSET = EffectDefinition(
    id="emg_offset",
    meaning="envelopes do not come down to zero at rest",
    family="emg",
    parameters=(
        RepeatedParameter(
            repetitions=_each_channel,
            name="offset_{channel}",
            unit="1",
            prior_sd=0.02,
            sign=1,
            meaning="EMG of {channel} at rest, in units of its largest",
            source="quiet phases of normalised EMG, 0 to 0.05",
            limit=0.2,
            part="{channel}",
        ),
    ),
    variants=_emg_offset,
    experiment=EMG_AT_REST,
)


# ---- Filtering of the envelopes


def _emg_smoothing(context: Context) -> tuple[Variant, ...]:
    return (Variant(Partial(_undo_smoothing)),)


def _undo_smoothing(effect_sizes: EffectSizes) -> Alteration:
    return Alteration(emg=Partial(_sharpen, effect_sizes[0] / _SHARE_AT_6_HZ))


def _sharpen(share: Float[Array, ""], emg: EmgSpline) -> EmgSpline:
    return sharpen_emg(emg, share, _AVERAGING_WIDTH)


# Every laboratory filters its envelopes, and what a filter removes of the bursts resembles other effects in
# every person: hence a nuisance effect.
EMG_SMOOTHING = EffectDefinition(
    id="emg_smoothing",
    meaning="filtered envelopes lack fast changes of the muscles' excitation",
    family="emg",
    parameters=(
        EffectParameter(
            name="share_at_6_Hz",
            unit="1",
            prior_sd=1.0,
            sign=1,
            meaning="amplitude of an envelope at 6 Hz that the filter removed, as a share of what remains",
            source="smoothing of envelopes: Hug 2011, doi:10.1016/j.jelekin.2010.08.009",
            limit=5.0,
        ),
    ),
    variants=_emg_smoothing,
    nuisance=True,
)


# ---- Crosstalk


def _neighboring_channels(context: Context) -> list[tuple[str, str]]:
    """Pairs of channels over neighboring muscles: the one that records, the one that it records too."""
    regions = {
        channel: region_of(context.muscles[first]) for channel, first in first_muscles(context).items()
    }
    return [
        (into, source)
        for into, here in regions.items()
        for source, there in regions.items()
        if into != source and here is not None and there is not None and are_neighbours(here, there)
    ]


def first_muscles(context: Context) -> dict[str, int]:
    """Find the first muscle that each channel drives."""
    channel_of = channel_of_muscle(context).tolist()
    return {channel: channel_of.index(number) for number, channel in enumerate(driving_channels(context))}


def _emg_crosstalk(context: Context) -> tuple[Variant, ...]:
    channels, first_muscle = driving_channels(context), first_muscles(context)
    pairs = _neighboring_channels(context)
    into = jnp.asarray([channels.index(into) for into, _ in pairs])
    source = jnp.asarray([first_muscle[source] for _, source in pairs])
    return (Variant(Partial(_remove_crosstalk, channel_of_muscle(context), into, source)),)


def _remove_crosstalk(
    channel_of: Int[Array, " muscle"],
    into: Int[Array, " pair"],
    source: Int[Array, " pair"],
    effect_sizes: EffectSizes,
) -> Alteration:
    """Subtract shares by channel; the first muscle of each source represents its channel."""
    shares = jnp.zeros((channel_of.size, channel_of.size)).at[into, source].add(effect_sizes)
    return Alteration(emg=Partial(add_channels, -shares[channel_of]))


def add_channels(shares: Float[Array, "muscle muscle"], emg: EmgSpline) -> EmgSpline:
    """Add shares of the envelopes of other muscles to the envelope of each muscle."""
    added = jnp.einsum("mn,ntpi->mtpi", shares, emg.coefficients)
    return replace(emg, coefficients=emg.coefficients + added)


EMG_CROSSTALK = EffectDefinition(
    id="emg_crosstalk",
    meaning="an electrode records a neighboring muscle as well",
    family="emg",
    requirements=(
        Requirement(
            "two channels over neighboring muscles",
            lambda context: (
                ""
                if _neighboring_channels(context)
                else "no two channels are known to lie beside one another"
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=lambda context: [
                {"into": into, "source": source} for into, source in _neighboring_channels(context)
            ],
            name="{source}_in_{into}",
            unit="1",
            prior_sd=0.15,
            sign=1,
            meaning="share of {source} that the electrode of {into} records",
            source="0 to 0.2; Peter et al. 2019, doi:10.3389/fphys.2019.01283",
            limit=0.6,
            part="{source}_in_{into}",
        ),
    ),
    variants=_emg_crosstalk,
    experiment=SINGLE_MUSCLE_CONTRACTIONS,
)


# ---- Gain that depends on posture


class ExcitationGain(MuscleAlteration):
    """Multiply excitation, frame by frame."""

    gain: Float[Array, "*muscle trial padded_frame"]

    def excitation(
        self, excitation: Float[Array, "trial padded_frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial padded_frame"]:
        """See `MuscleAlteration`."""
        return excitation * self.gain


def _posture_dependent_gain(context: Context) -> tuple[Variant, ...]:
    channel_of = channel_of_muscle(context)
    arms = np.abs(np.asarray(context.reference.paths.moment_arm)).mean(axis=(1, 3))
    joint = np.array(
        [arms[np.asarray(channel_of) == channel_of[row]].sum(axis=0).argmax() for row in range(len(arms))]
    )

    def posture(cycles: Context, offset: float) -> Float[np.ndarray, "muscle trial frame"]:
        return np.sin(np.moveaxis(cycles.angles, 1, 0) + np.deg2rad(offset))[joint]

    variants = []
    for offset in _POSTURES:
        mean = posture(context.reference, offset).mean(axis=(1, 2))[:, None, None]
        change = with_padding(jnp.asarray(posture(context, offset) - mean), context)
        variants.append(Variant(Partial(_change_gain, channel_of, change), f"turned by {offset:g} deg"))
    return tuple(variants)


def _change_gain(
    channel_of: Int[Array, " muscle"],
    change: Float[Array, "muscle trial padded_frame"],
    effect_sizes: EffectSizes,
) -> Alteration:
    return Alteration(muscle=ExcitationGain(1.0 + effect_sizes[channel_of][:, None, None] * change))


# Skin and electrode slide over the muscle as the joint that its muscles move most bends. The posture is that
# at the time of the excitation. The variants differ in the angle at which the gain is the recorded one.
POSTURE_DEPENDENT_GAIN = EffectDefinition(
    id="posture_dependent_gain",
    meaning="a channel's gain changes with the joint's angle",
    family="emg",
    parameters=(
        RepeatedParameter(
            repetitions=_each_channel,
            name="gain_{channel}",
            unit="1",
            prior_sd=0.4,
            sign=0,
            meaning="change of the gain of {channel} with the sine of its joint's angle",
            source="0 to 0.5",
            limit=1.0,
            part="{channel}",
        ),
    ),
    variants=_posture_dependent_gain,
    experiment=ISOMETRIC_RAMPS,
)


# ---- Delay


def _gait_speeds(context: Context) -> Float[np.ndarray, " cycle"]:
    return context.reference.speeds[context.reference.is_gait]


def _speeds_that_are_not_given(context: Context) -> str:
    speeds = _gait_speeds(context)
    given = len(speeds) > 0 and np.isfinite(speeds).all()
    return "" if given else "walking speeds are not given for every cycle"


def _one_speed(context: Context) -> str:
    one = np.ptp(_gait_speeds(context)) < _SAME_SPEED
    return "all cycles were walked at one speed; two are needed" if one else ""


def _speed_dependent_delay(context: Context) -> tuple[Variant, ...]:
    speeds = _gait_speeds(context)
    own = np.where(context.is_gait, context.speeds, speeds.mean())
    share = jnp.asarray((speeds.mean() - own) / np.ptp(speeds))
    return (Variant(Partial(_delay_by_cycle, jnp.ones(len(context.muscles)), share)),)


def _delay_by_cycle(
    each: Float[Array, " muscle"], share: Float[Array, " trial"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(emg=Partial(delay_emg, effect_sizes[0] * each[:, None] * share[None]))


# The mean delay over the cycles is unchanged: it is the calibrated one.
SPEED_DEPENDENT_DELAY = EffectDefinition(
    id="speed_dependent_delay",
    meaning="force follows EMG with another delay at another walking speed",
    family="control",
    requirements=(
        Requirement("walking speeds of all cycles", _speeds_that_are_not_given),
        Requirement("two walking speeds", _one_speed),
    ),
    parameters=(
        EffectParameter(
            name="delay_slow_minus_fast",
            unit="s",
            prior_sd=0.020,
            sign=0,
            meaning="electromechanical delay at the slowest speed less that at the fastest",
            source="delays of 20 to 100 ms, Zhou et al. 1995",
            limit=0.08,
        ),
    ),
    variants=_speed_dependent_delay,
    experiment=SYNC_PULSE,
)
