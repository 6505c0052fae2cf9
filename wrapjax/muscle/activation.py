"""First-order activation dynamics and the nonlinear activation-force relation."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

#: Ratio of the deactivation to the activation time constant (He et al. 1991, doi:10.1109/10.84276).
DEACTIVATION_RATIO = 4.0

# Rational fit of the isometric EMG-force curve, with G(0) = 0 and G(1) = 1
# (Meyer et al. 2017, doi:10.1371/journal.pone.0179698, equation 8).
_G1 = 29.280183270562596
_G2 = 4.107869238218326
_G3 = 1.000004740962477
_G4 = -7.623282868703527
_G5 = 17.227022969058535
_G6 = 0.884220539986325


def neural_activation(
    excitation: Float[Array, "trial padded_frame"],
    activation_time_constant: Float[Array, ""],
    step: Float[Array, " trial"],
    deactivation_ratio: Float[Array, ""] | float = DEACTIVATION_RATIO,
    start: Int[Array, " trial"] | None = None,
) -> Float[Array, "trial padded_frame"]:
    """Compute neural activation from excitation by first-order activation dynamics, from rest.

    ``da/dt = (c1 e + c2)(e - a)`` with ``c2 = 1/(r ta)`` and ``c1 = 1/ta - c2`` (He et al. 1991,
    doi:10.1109/10.84276), discretised by the implicit second-order backward difference. The first two frames
    are zero.

    Parameters
    ----------
    excitation
        Excitation e, 0 to 1, including the padding frames.
    activation_time_constant
        Activation time constant ta, s.
    step
        Time between frames of each cycle, s.
    deactivation_ratio
        Ratio r of the deactivation to the activation time constant.
    start
        Frame of each cycle from which on the dynamics run; the two frames from there on are zero, and all
        before. None for the first frame.

    Returns
    -------
    Array
        Neural activation a; it can undershoot zero by the order of the discretisation error.
    """
    fast = 1.0 / activation_time_constant
    slow = fast / deactivation_ratio
    gain = 2.0 * step[:, None] * ((fast - slow) * excitation + slow)

    def advance(previous, inputs):
        last, before_last = previous
        g, e = inputs
        now = (g * e + 4.0 * last - before_last) / (g + 3.0)
        return (now, last), now

    rest = jnp.zeros_like(excitation[:, 0])
    if start is not None:
        # Where excitation and rate are zero, rest persists.
        running = active_frames(start, excitation.shape[1])
        excitation, gain = jnp.where(running, excitation, 0.0), jnp.where(running, gain, 0.0)
    _, rest_of_frames = jax.lax.scan(advance, (rest, rest), (gain[:, 2:].T, excitation[:, 2:].T))
    return jnp.concatenate([jnp.stack([rest, rest], axis=1), rest_of_frames.T], axis=1)


def active_frames(start: Int[Array, " trial"], frames: int) -> Bool[Array, "trial padded_frame"]:
    """Mark the frames of each cycle in which activation follows from that of the two frames before."""
    return jnp.arange(frames)[None] >= start[:, None] + 2


def muscle_activation(
    neural: Float[Array, "*shape"], nonlinearity: Float[Array, ""]
) -> Float[Array, "*shape"]:
    """Compute muscle activation from neural activation by a nonlinear activation-force relation.

    ``(1 - c) a + c G(a)``, with G the isometric EMG-force curve of Meyer et al. 2017 (equation 8,
    doi:10.1371/journal.pone.0179698).

    Parameters
    ----------
    neural
        Neural activation a, not negative.
    nonlinearity
        Weight c of the nonlinear curve, from 0 (linear) to 0.35.

    Returns
    -------
    Array
        Muscle activation, 0 to 1.
    """
    saturating = _G4 / (_G1 * (neural + _G6) ** _G5 + _G2) + _G3
    return (1.0 - nonlinearity) * neural + nonlinearity * saturating
