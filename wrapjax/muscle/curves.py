"""Normalised force-length, force-velocity and passive force-length curves of a Hill-type muscle."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class AbstractCurves(eqx.Module):
    """Interface of the normalised force curves of a muscle; see `HillCurves`."""

    @abc.abstractmethod
    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the active force factor at a normalised fiber length."""

    @abc.abstractmethod
    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the force factor at a normalised fiber velocity (lengthening positive)."""

    @abc.abstractmethod
    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the passive force factor at a normalised fiber length."""


class HillCurves(AbstractCurves):
    """Analytical active force-length, force-velocity and passive force-length curves.

    The forms are those of De Groote et al. 2016 (doi:10.1007/s10439-016-1591-9); the arctangent
    replaces their logarithm in the force-velocity curve. Forces are in units of the maximum
    isometric force, lengths of the optimal fiber length, velocities of the maximum fiber velocity
    (lengthening positive).
    """

    #: Amplitude, center, width and growth of the width with length of three Gaussian-like terms.
    active_bumps: Float[np.ndarray, "3 4"]
    #: Coefficients d1 to d6 of ``d1 + d2 atan(d3 + d4 atan(d5 + d6 v))``.
    velocity: Float[np.ndarray, "6"]
    #: Coefficients e1 to e3 of ``e1 ln(1 + exp(e2 (l - e3)))``.
    passive: Float[np.ndarray, "3"]

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the active force factor at a normalised fiber length: 1 near length 1."""
        total = jnp.zeros_like(length)
        for amplitude, center, width, growth in self.active_bumps:
            total += amplitude * jnp.exp(-0.5 * ((length - center) / (width + growth * length)) ** 2)
        return total

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the force factor at a normalised fiber velocity: 0 at -1, 1 at 0, about 1.5 at 1."""
        d1, d2, d3, d4, d5, d6 = self.velocity
        return d1 + d2 * jnp.arctan(d3 + d4 * jnp.arctan(d5 + d6 * velocity))

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the passive force factor at a normalised fiber length: about 0.28 at 1.4."""
        e1, e2, e3 = self.passive
        return e1 * jnp.logaddexp(0.0, e2 * (length - e3))


_PASSIVE = np.array([0.232000797810576, 12.438535493526128, 1.329470475731338])
_THIRD_BUMP = [0.1, 1.0, 0.5 * np.sqrt(0.5), 0.0]

#: Hill curves by name: ``paper`` as in the NMSM Pipeline until 2026, used for the published results;
#: ``opensim`` its later refit "consistent with OpenSim". They differ by less than 6e-4.
HILL_CURVES: dict[str, AbstractCurves] = {
    "paper": HillCurves(
        active_bumps=np.array(
            [
                [0.814483478343008, 1.055033428970575, 0.162384573599574, 0.063303448465465],
                [0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188],
                _THIRD_BUMP,
            ]
        ),
        velocity=np.array(
            [
                -12.4090551101489,
                9.35818070443882,
                7.93116233095206,
                2.70637350085154,
                -0.274108493130008,
                8.03512618783281,
            ]
        ),
        passive=_PASSIVE,
    ),
    "opensim": HillCurves(
        active_bumps=np.array(
            [
                [0.8174335195120225, 1.054348561163096, 0.16194288662761705, 0.06381565266097716],
                [0.43130780147182907, 0.7163004817144202, -0.029060905806803296, 0.19835014521987723],
                _THIRD_BUMP,
            ]
        ),
        velocity=np.array(
            [
                -32.51401019139919,
                22.160392466960214,
                18.7932134796918,
                6.320952269683997,
                -0.27671677680513945,
                8.053304562566995,
            ]
        ),
        passive=_PASSIVE,
    ),
}


def hill_curves(name: str) -> AbstractCurves:
    """Return the curves of a name.

    Raises
    ------
    ValueError
        If `HILL_CURVES` has no such name, as in another process than the one that added it.
    """
    if name not in HILL_CURVES:
        raise ValueError(
            f"there are no curves '{name}'; there are {', '.join(HILL_CURVES)}, and curves of your own once "
            "they are in wrapjax.muscle.curves.HILL_CURVES of this process"
        )
    return HILL_CURVES[name]
