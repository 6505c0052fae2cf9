"""What EMG is: gains that drift or follow posture, offsets, crosstalk, and delays that follow speed."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, Int

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.diagnosis.effects.periodic import with_padding
from wrapjax.model.alteration import Alteration, MuscleAlteration, MuscleInputs
from wrapjax.muscle.excitation import EmgSpline, sharpen_emg
from wrapjax.subject.muscle_groups import are_neighbours, region_of

#: Walking speeds nearer to each other than this (m/s) count as one.
_SAME_SPEED = 0.05
#: By how much the posture at which a gain does not change with angle may differ from the angle's zero (deg).
_POSTURES = (0.0, 60.0)
#: Of the averages that tell quick changes of EMG from slow ones (s); and what they leave at 6 Hz.
_SMOOTHED = 0.025
_LEFT_AT_6_HZ = float(-np.expm1(-0.5 * (2.0 * np.pi * 6.0 * _SMOOTHED) ** 2)) ** 2
#: Which power of the knot's time stands last in a spline's coefficients.
_CONSTANT = 3

EffectSizes = Float[Array, " parameter"]


class AlteredGain(MuscleAlteration):
    """Multiply excitation, frame by frame."""

    gain: Float[Array, "*muscle trial padded_frame"]

    def excitation(
        self, excitation: Float[Array, "trial padded_frame"], inputs: MuscleInputs
    ) -> Float[Array, "trial padded_frame"]:
        """See `MuscleAlteration`."""
        return excitation * self.gain


def emg_drift(context: Context) -> Effect | NotTestable:
    """Let each channel's gain change from the first cycle to the last, none of it on average."""
    if np.ptp(context.reference.order) == 0.0:
        return NotTestable("emg_drift", "one cycle alone cannot show a gain that drifts")
    parameters = tuple(
        EffectParameter(
            name=f"gain_change_{channel}",
            unit="1",
            prior_sd=0.30,
            sign=0,
            meaning=f"change of the recorded gain of {channel} from the first cycle to the last",
            source="30 % a session",
            limit=0.9,
            part=channel,
        )
        for channel in _channels(context)
    )
    whole = context.reference.order
    form = Partial(_drift, _channel_of(context), jnp.asarray(context.order), jnp.asarray(whole.mean()))
    return Effect("emg_drift", "excitation", parameters, (Variant(form),))


def _drift(
    channel_of: Int[Array, " muscle"],
    order: Float[Array, " trial"],
    middle: Float[Array, ""],
    effect_sizes: EffectSizes,
) -> Alteration:
    """Undo what the recorded gain has become since the middle of the session."""
    change = effect_sizes[channel_of][:, None]
    return Alteration(emg=Partial(_with_gain, (1.0 + change * middle) / (1.0 + change * order[None])))


def _with_gain(gain: Float[Array, "muscle trial"], emg: EmgSpline) -> EmgSpline:
    return replace(emg, coefficients=emg.coefficients * gain[:, :, None, None])


def emg_offset(context: Context) -> Effect:
    """Take a constant off each channel: noise and resting level that were scaled along with it."""
    parameters = tuple(
        EffectParameter(
            name=f"offset_{channel}",
            unit="1",
            prior_sd=0.02,
            sign=1,
            meaning=f"EMG of {channel} at rest, in units of its largest",
            source="quiet phases of normalised EMG, 0 to 0.05",
            limit=0.2,
            part=channel,
        )
        for channel in _channels(context)
    )
    form = Partial(_offset, _channel_of(context))
    return Effect("emg_offset", "excitation", parameters, (Variant(form),))


def _offset(channel_of: Int[Array, " muscle"], effect_sizes: EffectSizes) -> Alteration:
    return Alteration(emg=Partial(_less, effect_sizes[channel_of]))


def _less(offset: Float[Array, " muscle"], emg: EmgSpline) -> EmgSpline:
    coefficients = emg.coefficients.at[:, :, _CONSTANT].add(-offset[:, None, None])
    return replace(emg, coefficients=coefficients)


def emg_smoothing(context: Context) -> Effect:
    """Give quick changes of EMG back what the filter of its envelopes took: muscles were told them all.

    Every laboratory's envelopes are filtered, and what that takes from bursts is like other causes in every
    person: so it is allowed for, and never named.
    """
    parameter = EffectParameter(
        name="share_at_6_Hz",
        unit="1",
        prior_sd=1.0,
        sign=1,
        meaning="what the filter took of an envelope at 6 Hz, as a share of what it left",
        source="smoothing of envelopes: Hug 2011, doi:10.1016/j.jelekin.2010.08.009",
        limit=5.0,
    )
    form = Partial(_sharper)
    return Effect("emg_smoothing", "excitation", (parameter,), (Variant(form),), nuisance=True)


def _sharper(effect_sizes: EffectSizes) -> Alteration:
    return Alteration(emg=Partial(_quicker, effect_sizes[0] / _LEFT_AT_6_HZ))


def _quicker(share: Float[Array, ""], emg: EmgSpline) -> EmgSpline:
    return sharpen_emg(emg, share, _SMOOTHED)


def emg_crosstalk(context: Context) -> Effect | NotTestable:
    """Take from each channel a share of those over neighbouring muscles."""
    channels = _channels(context)
    regions = {}
    for number, channel in enumerate(channels):
        first = _channel_of(context).tolist().index(number)
        regions[channel] = (first, region_of(context.muscles[first]))
    pairs = [
        (into, source)
        for into, (_, where) in regions.items()
        for source, (_, other) in regions.items()
        if into != source and where is not None and other is not None and are_neighbours(where, other)
    ]
    if not pairs:
        return NotTestable("emg_crosstalk", "no two channels are known to lie beside one another")
    parameters = tuple(
        EffectParameter(
            name=f"{source}_in_{into}",
            unit="1",
            prior_sd=0.15,
            sign=1,
            meaning=f"share of {source} that the electrode of {into} hears",
            source="0 to 0.2; Peter et al. 2019, doi:10.3389/fphys.2019.01283",
            limit=0.6,
            part=f"{source}_in_{into}",
        )
        for into, source in pairs
    )
    into = jnp.asarray([channels.index(into) for into, _ in pairs])
    source = jnp.asarray([regions[source][0] for _, source in pairs])
    form = Partial(_crosstalk, _channel_of(context), into, source)
    return Effect("emg_crosstalk", "excitation", parameters, (Variant(form),))


def _crosstalk(
    channel_of: Int[Array, " muscle"],
    into: Int[Array, " pair"],
    source: Int[Array, " pair"],
    effect_sizes: EffectSizes,
) -> Alteration:
    """Subtract by channel; the muscle of each source stands for its channel."""
    heard = jnp.zeros((channel_of.size, channel_of.size)).at[into, source].add(effect_sizes)
    return Alteration(emg=Partial(_without, heard[channel_of]))


def _without(heard: Float[Array, "muscle muscle"], emg: EmgSpline) -> EmgSpline:
    crosstalk = jnp.einsum("mn,ntpi->mtpi", heard, emg.coefficients)
    return replace(emg, coefficients=emg.coefficients - crosstalk)


def posture_dependent_gain(context: Context) -> Effect:
    """Let each channel's gain follow the angle of the joint that its muscles move most.

    As skin and electrode slide over the muscle. The posture is that at the time of excitation.
    """
    parameters = tuple(
        EffectParameter(
            name=f"gain_{channel}",
            unit="1",
            prior_sd=0.4,
            sign=0,
            meaning=f"change of the gain of {channel} with the sine of its joint's angle",
            source="0 to 0.5",
            limit=1.0,
            part=channel,
        )
        for channel in _channels(context)
    )
    channel_of = _channel_of(context)
    arms = np.abs(np.asarray(context.reference.paths.moment_arm)).mean(axis=(1, 3))
    joint = np.array(
        [arms[np.asarray(channel_of) == channel_of[row]].sum(axis=0).argmax() for row in range(len(arms))]
    )

    def posture(one: Context, away: float) -> Float[np.ndarray, "muscle trial frame"]:
        return np.sin(np.moveaxis(one.angles, 1, 0) + np.deg2rad(away))[joint]

    variants = []
    for away in _POSTURES:
        level = posture(context.reference, away).mean(axis=(1, 2))[:, None, None]
        shape = with_padding(jnp.asarray(posture(context, away) - level), context.padding)
        variants.append(Variant(Partial(_posture, channel_of, shape), f"turned by {away:g} deg"))
    return Effect("posture_dependent_gain", "excitation", parameters, tuple(variants))


def _posture(
    channel_of: Int[Array, " muscle"],
    shape: Float[Array, "muscle trial padded_frame"],
    effect_sizes: EffectSizes,
) -> Alteration:
    return Alteration(muscle=AlteredGain(1.0 + effect_sizes[channel_of][:, None, None] * shape))


def speed_dependent_delay(context: Context) -> Effect | NotTestable:
    """Let the electromechanical delay follow walking speed; on average it is the calibrated one."""
    speeds = context.reference.speeds
    if not np.isfinite(speeds).all():
        return NotTestable("speed_dependent_delay", "walking speeds are not given for every cycle")
    if np.ptp(speeds) < _SAME_SPEED:
        return NotTestable("speed_dependent_delay", "all cycles were walked at one speed; two are needed")
    parameter = EffectParameter(
        name="delay_slow_minus_fast",
        unit="s",
        prior_sd=0.020,
        sign=0,
        meaning="electromechanical delay at the slowest speed less that at the fastest",
        source="delays of 20 to 100 ms, Zhou et al. 1995",
        limit=0.08,
    )
    share = jnp.asarray((speeds.mean() - context.speeds) / np.ptp(speeds))
    form = Partial(_by_cycle, jnp.ones(len(context.muscles)), share)
    return Effect("speed_dependent_delay", "excitation", (parameter,), (Variant(form),))


def _by_cycle(
    each: Float[Array, " muscle"], share: Float[Array, " trial"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(emg=Partial(later, effect_sizes[0] * each[:, None] * share[None]))


def later(lag: Float[Array, "muscle trial"], emg: EmgSpline) -> EmgSpline:
    """Delay EMG by so much more (s)."""
    return replace(emg, lag=lag if emg.lag is None else emg.lag + lag)


def _channels(context: Context) -> tuple[str, ...]:
    """Name the channels that drive a muscle, in their order."""
    return tuple(name for number, name in enumerate(context.channels) if number in context.muscle_channels)


def _channel_of(context: Context) -> Int[Array, " muscle"]:
    """Say which of `_channels` drives each muscle."""
    used = sorted(set(context.muscle_channels))
    return jnp.asarray([used.index(channel) for channel in context.muscle_channels])
