"""From EMG envelopes to muscle excitations: scale and electromechanical delay, and EMG nobody measured."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

#: How sharply EMG that nobody measured turns where it is held within 0 and 1: over about one over this.
_SHARPNESS = 20.0


def smooth_unit_clip(value: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Hold a value within 0 and 1: the value itself between them, smoothly level beyond.

    A difference of two softplus functions. Bounds at frames would hold in cycles that are calibrated on;
    this holds in all, and leaves the problem smooth.
    """
    above = jax.nn.softplus(_SHARPNESS * value) - jax.nn.softplus(_SHARPNESS * (value - 1.0))
    return above / _SHARPNESS


class CommandSplines(eqx.Module):
    """Commands that muscles without a channel take a weighted sum of, knots as in `EmgSpline`."""

    #: The same for every muscle; highest power first, in units of one knot step.
    coefficients: Float[Array, "*channel trial command 4 interval"]
    #: 1 for a muscle without a channel, else 0.
    share: Float[Array, "*channel trial"]


class EmgSpline(eqx.Module):
    """Cubic splines through sampled EMG envelopes, one set of uniform knots a gait cycle.

    The knots are uniform within a cycle, so that a delay shifts every frame by the same fraction of
    a step: looking a value up is one gather and one cubic.
    """

    #: Highest power first, in units of one knot step.
    coefficients: Float[Array, "*channel trial 4 interval"]
    #: Time between knots in s.
    step: Float[Array, "*channel trial"]
    #: By how much more each cycle's EMG is delayed, s; None for none.
    lag: Float[Array, "*channel trial"] | None = None
    #: Where some muscles have no channel; their own splines are zero then.
    commands: CommandSplines | None = None

    def at_delay(
        self, delay: Float[Array, ""], weights: Float[Array, " command"] | None = None
    ) -> Float[Array, "trial knot"]:
        """Evaluate the envelopes at every knot's time less the delay.

        Before the first knot the envelope holds its first value: extrapolating a cubic through the
        start of a recording would invent bursts that nobody measured.

        Parameters
        ----------
        delay
            Electromechanical delay in s, not negative; one number for all cycles.
        weights
            Of the commands, for a muscle without a channel: its envelope is their sum, held within 0 and 1.
        """
        intervals = self.coefficients.shape[-1]
        delays = delay if self.lag is None else delay + self.lag
        position = jnp.arange(intervals + 1.0)[None, :] - (delays / self.step)[:, None]
        position = jnp.clip(position, 0.0, float(intervals))
        interval = jnp.clip(jnp.floor(position).astype(int), 0, intervals - 1)
        fraction = position - interval

        def look_up(coefficients: Float[Array, "trial 4 interval"]) -> Float[Array, "trial knot"]:
            c3, c2, c1, c0 = jnp.moveaxis(
                jnp.take_along_axis(coefficients, interval[:, None, :], axis=-1), 1, 0
            )
            return ((c3 * fraction + c2) * fraction + c1) * fraction + c0

        measured = look_up(self.coefficients)
        if self.commands is None or weights is None:
            return measured
        together = jnp.einsum("c,tcpi->tpi", weights, self.commands.coefficients)
        return measured + self.commands.share[:, None] * smooth_unit_clip(look_up(together))


def fit_emg_spline(
    time: Float[np.ndarray, "trial knot"], emg: Float[np.ndarray, "trial channel knot"]
) -> EmgSpline:
    """Fit the not-a-knot cubic spline of every cycle and channel.

    Parameters
    ----------
    time
        Times of the samples in s, uniform within a cycle.
    emg
        Envelopes, dimensionless.

    Returns
    -------
    EmgSpline
        Both fields with a leading axis ``channel``.
    """
    knots = np.arange(emg.shape[-1], dtype=float)
    pieces = CubicSpline(knots, emg, axis=-1, bc_type="not-a-knot").c  # (4, interval, trial, channel)
    coefficients = np.transpose(pieces, (3, 2, 0, 1))
    step = (time[:, -1] - time[:, 0]) / (emg.shape[-1] - 1)
    return EmgSpline(jnp.asarray(coefficients), jnp.broadcast_to(step, coefficients.shape[:2]))


def sharpen_emg(emg: EmgSpline, share: Float[Array, ""], width: float) -> EmgSpline:
    """Give back to envelopes what a filter has taken from their quick changes.

    What is left of an envelope after a Gaussian average, and after another one, is what is added: next to
    nothing of slow changes, as good low-pass filters take next to nothing of them (of the fourth order, both
    grow with the fourth power of the frequency).

    Parameters
    ----------
    emg
        As it was recorded.
    share
        Of what is left; none of it at 0.
    width
        Standard deviation of the Gaussian, s.
    """
    count = emg.coefficients.shape[-1] + 1
    lag = np.subtract.outer(np.arange(count), np.arange(count))
    through = CubicSpline(np.arange(count), np.eye(count), bc_type="not-a-knot").c

    @partial(jnp.vectorize, signature="(p,i),()->(p,i)")
    def quick_changes(
        coefficients: Float[Array, "4 interval"], step: Float[Array, ""]
    ) -> Float[Array, "4 interval"]:
        knots = jnp.append(coefficients[-1], coefficients[:, -1].sum())
        average = jax.nn.softmax(-0.5 * (lag * step / width) ** 2, axis=-1)
        left = knots - average @ knots
        return through @ (left - average @ left)

    return replace(emg, coefficients=emg.coefficients + share * quick_changes(emg.coefficients, emg.step))
