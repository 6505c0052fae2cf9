"""Continuous family of muscle laws: force curves and activation dynamics with parameters of the person.

Published laws differ in the width of the active force-length curve, in the force-velocity curve, in the
passive force and in the activation dynamics, and recordings tell them apart. The family starts from a given
set of curves and the dynamics of He et al. 1991, and changes both by the parameters of `LAW_PARAMETERS`,
which all muscles share. All are zero for the given law, which the family then reproduces to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.muscle.activation import active_frames
from wrapjax.muscle.curves import AbstractCurves


@dataclass(frozen=True)
class LawParameter:
    """Parameter of the family: prior standard deviation about zero, bounds, meaning and source of the spread.

    All are dimensionless, most are logarithms of factors.
    """

    name: str
    prior_sd: float
    lower: float
    upper: float
    meaning: str
    source: str


_LENGTH = (
    "active curves of Thelen 2003 (doi:10.1115/1.1531112), De Groote et al. 2016 "
    "(doi:10.1007/s10439-016-1591-9) and Gordon et al. 1966 (doi:10.1113/jphysiol.1966.sp007909)"
)
_VELOCITY = (
    "Hill's a/F0 of 0.15 to 0.5 and eccentric plateaus of 1.3 to 1.8: Winters 1990 "
    "(doi:10.1007/978-1-4613-9030-5_5), Zajac 1989 (Crit Rev Biomed Eng 17:359)"
)
_PASSIVE = "passive strain at maximum force of 0.4 to 0.8 and exponents of 3 to 5: Thelen 2003, Zajac 1989"
_DYNAMICS = "Rockenfeller et al. 2015 (doi:10.1155/2015/585409), Winters 1990, Milner-Brown et al. 1973"
_SHAPE = (
    "Lloyd & Besier 2003 (doi:10.1016/S0021-9290(03)00010-1), Manal & Buchanan 2003 "
    "(doi:10.1016/S0021-9290(03)00152-0)"
)

#: Parameters of the family, in the order of the vectors that hold their values.
LAW_PARAMETERS: tuple[LawParameter, ...] = (
    LawParameter(
        "active_shift", 0.04, -0.15, 0.15, "optimal fiber lengths by which the peak lies later", _LENGTH
    ),
    LawParameter("active_width_short", 0.30, -0.9, 0.9, "log factor on the width below the peak", _LENGTH),
    LawParameter("active_width_long", 0.30, -0.9, 0.9, "log factor on the width above the peak", _LENGTH),
    LawParameter(
        "active_flatness",
        0.20,
        -0.5,
        0.6,
        "log factor on the exponent of the distance from the peak",
        _LENGTH,
    ),
    LawParameter(
        "shortening_curvature", 0.30, -1.0, 1.0, "log factor on the curvature while shortening", _VELOCITY
    ),
    LawParameter(
        "lengthening_slope", 0.40, -1.2, 1.2, "log factor on the slope at the start of lengthening", _VELOCITY
    ),
    LawParameter(
        "lengthening_plateau", 0.25, -0.8, 0.8, "log factor on the force that lengthening adds", _VELOCITY
    ),
    LawParameter("passive_force", 0.50, -1.5, 1.5, "log factor on the passive force at length 1.4", _PASSIVE),
    LawParameter(
        "passive_growth", 0.30, -0.9, 0.9, "log factor on the growth of passive force with length", _PASSIVE
    ),
    LawParameter("second_stage", 0.60, 0.0, 1.0, "share of dynamics with two equal stages", _DYNAMICS),
    LawParameter(
        "deactivation_ratio", 0.40, -1.2, 1.2, "log factor on the ratio of fall to rise time", _DYNAMICS
    ),
    LawParameter("rate_exponent", 0.50, -1.5, 1.0, "log exponent of the excitation in the rate", _DYNAMICS),
    LawParameter(
        "directional_rate",
        0.60,
        0.0,
        1.0,
        "share of a rate that depends on activation and direction",
        _DYNAMICS,
    ),
    LawParameter("shape_exponent", 0.20, -0.6, 0.6, "log exponent of activation", _SHAPE),
    LawParameter("shape_saturation", 0.50, -0.6, 2.5, "saturation h of a (1 + h) / (1 + h a)", _SHAPE),
)

_PLACE = {parameter.name: place for place, parameter in enumerate(LAW_PARAMETERS)}
#: Names of the parameters, in the order of vectors.
LAW_NAMES: tuple[str, ...] = tuple(_PLACE)

#: Length at which the passive force has its own parameter, optimal fiber lengths.
_PASSIVE_LENGTH = 1.4
#: Distance from the peak at which another flatness leaves the active force unchanged.
_FLATNESS_LENGTH = 0.35
# Smoothness of the side of the peak (optimal fiber lengths) and of the direction of activation.
_SIDE, _DIRECTION = 0.02, 0.05


class PersonalCurves(AbstractCurves):
    """Muscle force curves of one person, by the parameters `LAW_PARAMETERS` of a continuous family."""

    given: AbstractCurves
    law: Float[Array, "*shape law_parameter"]

    def _value(self, name: str) -> Float[Array, "..."]:
        return self.law[..., _PLACE[name]]

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the active force factor at a normalised fiber length."""
        distance = length - 1.0 - self._value("active_shift")
        side = 0.5 + 0.5 * jnp.tanh(distance / _SIDE)
        width = (1.0 - side) * self._value("active_width_short") + side * self._value("active_width_long")
        relative = 0.5 * jnp.log((distance / _FLATNESS_LENGTH) ** 2 + 1e-4)
        stretch = jnp.expm1(jnp.expm1(self._value("active_flatness")) * relative - width)
        return self.given.active_force(length - self._value("active_shift") + distance * stretch)

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the force factor; it is unchanged at rest and at the maximum shortening velocity."""
        slow = jnp.clip(1.0 + velocity, 0.0, 1.0)
        inside = (velocity > -1.0) & (velocity < 0.0)
        shortening = velocity / (1.0 + jnp.expm1(-self._value("shortening_curvature")) * slow)
        plateau = self._value("lengthening_plateau")
        faster = jnp.exp(self._value("lengthening_slope") - plateau)
        moved = jnp.where(inside, shortening, jnp.where(velocity > 0.0, velocity * faster, velocity))
        force = self.given.force_velocity(moved)
        added = jnp.where(velocity > 0.0, force - self.given.force_velocity(jnp.zeros_like(velocity)), 0.0)
        return force + added * jnp.expm1(plateau)

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Compute the passive force factor at a normalised fiber length."""
        beyond = length - _PASSIVE_LENGTH
        force = self.given.passive_force(length + beyond * jnp.expm1(self._value("passive_growth")))
        return force * jnp.exp(self._value("passive_force"))


def personal_neural_activation(
    excitation: Float[Array, "trial padded_frame"],
    activation_time_constant: Float[Array, ""],
    step: Float[Array, " trial"],
    deactivation_ratio: Float[Array, ""] | float,
    law: Float[Array, " law_parameter"],
    start: Int[Array, " trial"] | None = None,
) -> Float[Array, "trial padded_frame"]:
    """Compute neural activation by the dynamics of the family; see `activation.neural_activation`.

    The rate of the dynamics of He et al. 1991 takes a power of the excitation, and is mixed with one that
    depends on the activation and on the direction of its change (Winters 1990; Thelen 2003). Two equal stages
    with half of the time constant each (Milner-Brown et al. 1973, doi:10.1113/jphysiol.1973.sp010079) are
    mixed with a single one.

    Parameters
    ----------
    excitation, activation_time_constant, step, deactivation_ratio, start
        See `activation.neural_activation`.
    law
        Values of `LAW_PARAMETERS`.

    Returns
    -------
    Array
        Neural activation.
    """
    second = law[_PLACE["second_stage"]]
    ratio = deactivation_ratio * jnp.exp(law[_PLACE["deactivation_ratio"]])
    directional = law[_PLACE["directional_rate"]]
    exponent = jnp.expm1(law[_PLACE["rate_exponent"]])
    fast = 1.0 / activation_time_constant
    slow = fast / ratio
    positive = excitation > 0.0
    level = excitation * jnp.exp(exponent * jnp.log(jnp.where(positive, excitation, 1.0) + 1e-3))
    by_level = (fast - slow) * level + slow
    scale = 2.0 * step

    def advance(previous, inputs):
        (one, first, last), before = previous
        e, of_level, *running = inputs

        def stage(target, now, earlier, speed):
            rising = 0.5 + 0.5 * jnp.tanh((target - now) / _DIRECTION)
            slower = 0.5 + 1.5 * jnp.clip(now, 0.0, 1.0)
            of_direction = rising * fast / slower + (1.0 - rising) * slower * slow
            g = scale * speed * (of_level + directional * (of_direction - of_level))
            return (g * target + 4.0 * now - earlier) / (g + 3.0)

        single = stage(e, one, before[0], 1.0)
        of_first = stage(e, first, before[1], 2.0)
        of_last = stage(of_first, last, before[2], 2.0)
        if running:
            single, of_first, of_last = (jnp.where(running[0], a, 0.0) for a in (single, of_first, of_last))
        now = (single, of_first, of_last)
        return (now, (one, first, last)), single + second * (of_last - single)

    rest = jnp.zeros_like(excitation[:, 0])
    running = () if start is None else (active_frames(start, excitation.shape[1])[:, 2:].T,)
    inputs = (excitation[:, 2:].T, by_level[:, 2:].T, *running)
    _, later = jax.lax.scan(advance, ((rest, rest, rest), (rest, rest, rest)), inputs)
    return jnp.concatenate([jnp.stack([rest, rest], axis=1), later.T], axis=1)


def personal_shape(
    activation: Float[Array, "*shape"], law: Float[Array, " law_parameter"]
) -> Float[Array, "*shape"]:
    """Change the relation of muscle activation to neural activation by an exponent and a saturation."""
    positive = activation > 0.0
    logarithm = jnp.log(jnp.where(positive, activation, 1.0))
    power = activation * jnp.exp(jnp.expm1(law[_PLACE["shape_exponent"]]) * logarithm)
    saturation = law[_PLACE["shape_saturation"]]
    return power * (1.0 + saturation) / (1.0 + saturation * power)


def given_law(muscles: int) -> Float[np.ndarray, "muscle law_parameter"]:
    """Return the values of all parameters for the given law: zeros, one row for each muscle."""
    return np.zeros((muscles, len(LAW_PARAMETERS)))
