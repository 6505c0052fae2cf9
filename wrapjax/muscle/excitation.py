"""Cubic splines of EMG envelopes and synergy commands, evaluated with an electromechanical delay."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.interpolate import CubicSpline

#: Sharpness of `smooth_unit_clip`: the transition at 0 and at 1 is about one over this wide.
_SHARPNESS = 20.0
#: Number of splines that `sharpen_emg` sharpens at once.
_SHARPENED_TOGETHER = 32


def smooth_unit_clip(value: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Limit a value to 0 to 1 smoothly: the identity between them, constant beyond.

    The difference of two softplus functions. Constraints at frames would hold in the calibration cycles
    alone; this holds in every cycle and keeps the least-squares problem smooth.
    """
    above = jax.nn.softplus(_SHARPNESS * value) - jax.nn.softplus(_SHARPNESS * (value - 1.0))
    return above / _SHARPNESS


class CommandSplines(eqx.Module):
    """Cubic splines of synergy commands; weighted sums of them drive muscles without a channel.

    The knots are those of `EmgSpline`.
    """

    #: Polynomial coefficients, the same for every muscle; highest power first, in units of one knot step.
    coefficients: Float[Array, "*channel trial command 4 interval"]
    #: 1 for a muscle without a channel, else 0.
    share: Float[Array, "*channel trial"]


class EmgSpline(eqx.Module):
    """Cubic splines through sampled EMG envelopes, with uniform knots in each gait cycle.

    Because knots are uniform within a cycle, a delay shifts every frame by the same fraction of a step, and
    an evaluation is one gather and one cubic polynomial.
    """

    #: Polynomial coefficients; highest power first, in units of one knot step.
    coefficients: Float[Array, "*channel trial 4 interval"]
    #: Time between knots in s.
    step: Float[Array, "*channel trial"]
    #: Additional delay of each cycle's EMG, s; None for zero.
    lag: Float[Array, "*channel trial"] | None = None
    #: Synergy commands of muscles without a channel, whose own splines are zero; None where there are none.
    commands: CommandSplines | None = None
    #: Knot at which each cycle's muscles begin to be activated, from rest; None for the first one.
    start: Int[Array, "*channel trial"] | None = None

    def at_delay(
        self, delay: Float[Array, ""], weights: Float[Array, " command"] | None = None
    ) -> Float[Array, "trial knot"]:
        """Evaluate the envelopes at the time of every knot less the delay.

        Before the first knot the envelope is constant: extrapolating a cubic polynomial beyond the start
        of a recording could produce EMG that was not measured.

        Parameters
        ----------
        delay
            Electromechanical delay in s, not negative; one number for all cycles.
        weights
            Weights of the commands, for a muscle without a channel: its envelope is their weighted sum,
            limited to 0 to 1 by `smooth_unit_clip`.

        Returns
        -------
        Array
            Delayed envelope, dimensionless.
        """
        intervals = self.coefficients.shape[-1]
        delays = delay if self.lag is None else delay + self.lag
        position = jnp.arange(intervals + 1.0)[None, :] - (delays / self.step)[:, None]
        position = jnp.clip(position, 0.0, float(intervals))
        interval = jnp.clip(jnp.floor(position).astype(int), 0, intervals - 1)
        fraction = position - interval

        def evaluate(coefficients: Float[Array, "trial 4 interval"]) -> Float[Array, "trial knot"]:
            c3, c2, c1, c0 = jnp.moveaxis(
                jnp.take_along_axis(coefficients, interval[:, None, :], axis=-1), 1, 0
            )
            return ((c3 * fraction + c2) * fraction + c1) * fraction + c0

        measured = evaluate(self.coefficients)
        if self.commands is None or weights is None:
            return measured
        weighted_sum = jnp.einsum("c,tcpi->tpi", weights, self.commands.coefficients)
        return measured + self.commands.share[:, None] * smooth_unit_clip(evaluate(weighted_sum))


def fit_emg_spline(
    time: Float[np.ndarray, "trial knot"],
    emg: Float[np.ndarray, "trial channel knot"],
    starts: Int[np.ndarray, " trial"] | None = None,
) -> EmgSpline:
    """Fit a cubic spline with not-a-knot end conditions to every cycle and channel.

    Parameters
    ----------
    time
        Times of the samples, s, uniform within a cycle.
    emg
        EMG envelopes, dimensionless.
    starts
        Knot of each cycle at which its recording begins; earlier samples have the value of that knot, which
        the spline holds exactly. None if all recordings begin at the first knot.

    Returns
    -------
    EmgSpline
        Splines; the fields have a leading axis ``channel``.
    """
    knots = np.arange(emg.shape[-1], dtype=float)
    pieces = CubicSpline(knots, emg, axis=-1, bc_type="not-a-knot").c  # (4, interval, trial, channel)
    coefficients = np.transpose(pieces, (3, 2, 0, 1))
    step = (time[:, -1] - time[:, 0]) / (emg.shape[-1] - 1)
    for trial, first in enumerate(() if starts is None else starts.tolist()):
        if not first:
            continue
        own = CubicSpline(knots[first:], emg[trial, :, first:], axis=-1, bc_type="not-a-knot").c
        coefficients[:, trial, :, :first] = 0.0
        coefficients[:, trial, -1, :first] = emg[trial, :, first, None]
        coefficients[:, trial, :, first:] = np.transpose(own, (2, 0, 1))
    return EmgSpline(
        jnp.asarray(coefficients),
        jnp.broadcast_to(step, coefficients.shape[:2]),
        start=None if starts is None else jnp.broadcast_to(starts, coefficients.shape[:2]),
    )


def sharpen_emg(emg: EmgSpline, share: Float[Array, ""], width: float) -> EmgSpline:
    """Restore fast changes of EMG envelopes that low-pass filtering has removed.

    The high-pass residual of an envelope, ``(I - G)(I - G) x`` with G a Gaussian average over time, is added
    to it. Its frequency response rises with the fourth power of the frequency, as the attenuation of a
    fourth-order low-pass filter does, so that slow changes stay as they are.

    Parameters
    ----------
    emg
        Splines of the recorded envelopes.
    share
        Factor on the residual that is added; 0 for the recorded envelopes.
    width
        Standard deviation of the Gaussian, s.

    Returns
    -------
    EmgSpline
        Splines of the sharpened envelopes.
    """
    shape = emg.coefficients.shape
    count = shape[-1] + 1
    lag = np.subtract.outer(np.arange(count), np.arange(count))
    spline_matrix = CubicSpline(np.arange(count), np.eye(count), bc_type="not-a-knot").c

    def high_pass(spline: tuple[Float[Array, "4 interval"], Float[Array, ""]]) -> Float[Array, "4 interval"]:
        coefficients, step = spline
        knots = jnp.append(coefficients[-1], coefficients[:, -1].sum())
        average = jax.nn.softmax(-0.5 * (lag * step / width) ** 2, axis=-1)
        residual = knots - average @ knots
        return spline_matrix @ (residual - average @ residual)

    # Some splines after the others: each needs a matrix of all its knots.
    flat = (emg.coefficients.reshape(-1, *shape[-2:]), emg.step.reshape(-1))
    added = jax.lax.map(high_pass, flat, batch_size=_SHARPENED_TOGETHER).reshape(shape)
    return replace(emg, coefficients=emg.coefficients + share * added)
