"""Published muscle laws, and the point of the continuous family that is nearest to each.

A law has force curves, activation dynamics and a relation of force to EMG. The family of
`wrapjax.muscle.personal_law` changes a given set of curves; `nearest_law` finds the values of its parameters
with which it reproduces a published law best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from wrapjax.muscle.curves import hill_curves
from wrapjax.muscle.personal_law import LAW_NAMES, LAW_PARAMETERS, PersonalCurves, personal_shape

Curve = Callable[[Float[Array | np.ndarray, "*shape"]], Float[Array, "*shape"]]

#: Law whose curves and dynamics the family changes: all its parameters are zero.
GIVEN_LAW = "nmsm"
#: Fiber lengths and velocities, and activations, at which laws are compared.
_LENGTHS = np.linspace(0.4, 1.6, 61)
_VELOCITIES = np.linspace(-1.0, 1.0, 61)
_ACTIVATIONS = np.linspace(0.0, 1.0, 41)
# Passive forces at lengths that muscles reach in life.
_STRETCHED = np.linspace(1.0, 1.5, 26)
# Weight of the prior against an error of the curves: it decides only what the curves leave undecided.
_PRIOR_WEIGHT = 1e-3


@dataclass(frozen=True)
class PublishedLaw:
    """Published muscle law, where it differs from the given curves and dynamics.

    Parameters
    ----------
    meaning, source
        What it is, and where it was published.
    active_force, force_velocity, passive_force
        Force factors at a normalised fiber length or velocity; None for the given ones.
    shape
        Muscle activation at a neural activation; None for the given one.
    dynamics
        Parameters of the family that describe its activation dynamics.
    """

    meaning: str
    source: str
    active_force: Curve | None = None
    force_velocity: Curve | None = None
    passive_force: Curve | None = None
    shape: Curve | None = None
    dynamics: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


def _thelen_velocity(velocity: Float[Array | np.ndarray, "*shape"]) -> Float[Array, "*shape"]:
    """Compute the force factor of Thelen 2003, equations 6 and 7, of a fully active muscle at length 1."""
    curvature, largest = 0.25, 1.4
    slope = (2.0 + 2.0 / curvature) / (largest - 1.0)
    shortening = (1.0 + velocity) / (1.0 - jnp.minimum(velocity, 0.0) / curvature)
    faster = slope * jnp.maximum(velocity, 0.0)
    return jnp.where(velocity > 0.0, (1.0 + faster * largest) / (1.0 + faster), shortening)


def _exponential_passive(
    growth: float, strain: float
) -> Callable[[Float[Array | np.ndarray, "*shape"]], Float[Array, "*shape"]]:
    """Return a passive force factor that grows exponentially to 1 at this strain (Thelen 2003, eq. 3).

    Its argument is the normalised fiber length.
    """
    return lambda length: jnp.expm1(growth * jnp.maximum(length - 1.0, 0.0) / strain) / np.expm1(growth)


def _de_groote_velocity(velocity: Float[Array | np.ndarray, "*shape"]) -> Float[Array, "*shape"]:
    """Compute the force factor of De Groote et al. 2016, supplement."""
    return -0.318 * jnp.arcsinh(-8.149 * velocity - 0.374) + 0.886


#: Shape factor of the relation of force to EMG, in the middle of its published range of -3 to 0.
_SHAPE_FACTOR = -1.5

#: Published laws by name. Millard's curves are not among them: the simulators that test a diagnosis use them.
PUBLISHED_LAWS: Mapping[str, PublishedLaw] = MappingProxyType(
    {
        GIVEN_LAW: PublishedLaw(
            "curves and dynamics of the NMSM Pipeline", "He et al. 1991, doi:10.1115/1.2894892"
        ),
        "de_groote": PublishedLaw(
            "force-velocity and passive curves, rates that depend on activation",
            "De Groote et al. 2016, doi:10.1007/s10439-016-1591-9",
            force_velocity=_de_groote_velocity,
            passive_force=_exponential_passive(4.0, 0.6),
            dynamics=MappingProxyType({"directional_rate": 1.0}),
        ),
        "thelen": PublishedLaw(
            "wide active curve, low eccentric plateau, rates that depend on activation",
            "Thelen 2003, doi:10.1115/1.1531112",
            active_force=lambda length: jnp.exp(-((length - 1.0) ** 2) / 0.45),
            force_velocity=_thelen_velocity,
            passive_force=_exponential_passive(5.0, 0.6),
            dynamics=MappingProxyType({"directional_rate": 1.0}),
        ),
        "ceinms": PublishedLaw(
            f"exponential relation of force to EMG, shape factor {_SHAPE_FACTOR:g}",
            "Lloyd & Besier 2003, doi:10.1016/S0021-9290(03)00010-1; "
            "Pizzolato et al. 2015, doi:10.1016/j.jbiomech.2015.09.021",
            shape=lambda activation: jnp.expm1(_SHAPE_FACTOR * activation) / np.expm1(_SHAPE_FACTOR),
        ),
    }
)


def nearest_law(name: str, curves: str = "paper") -> Float[np.ndarray, " law_parameter"]:
    """Find the values of the family's parameters with which it is nearest to a published law.

    Curves are compared by least squares over fiber lengths of 0.4 to 1.6, velocities of -1 to 1 and
    activations of 0 to 1; what they leave undecided has its prior mean of zero.

    Parameters
    ----------
    name
        Name in `PUBLISHED_LAWS`.
    curves
        Name of the Hill curves that the family changes.

    Returns
    -------
    numpy.ndarray
        Values in the order of `LAW_PARAMETERS`.

    Raises
    ------
    KeyError
        If the name is unknown.
    ValueError
        If the curves are unknown.
    """
    return np.array(_nearest(name, curves))


@cache
def _nearest(name: str, curves: str) -> tuple[float, ...]:
    law, given = PUBLISHED_LAWS[name], hill_curves(curves)
    sd = np.array([one.prior_sd for one in LAW_PARAMETERS])
    lower, upper = (np.array([getattr(one, end) for one in LAW_PARAMETERS]) for end in ("lower", "upper"))
    targets = [
        (PersonalCurves.active_force, law.active_force, _LENGTHS),
        (PersonalCurves.force_velocity, law.force_velocity, _VELOCITIES),
        (PersonalCurves.passive_force, law.passive_force, _STRETCHED),
    ]

    def errors(values: Float[Array, " law_parameter"]) -> Float[Array, " error"]:
        family = PersonalCurves(given, values)
        found = [_PRIOR_WEIGHT * values / sd]
        found += [of(family, jnp.asarray(x)) - want(x) for of, want, x in targets if want is not None]
        if law.shape is not None:
            found.append(personal_shape(jnp.asarray(_ACTIVATIONS), values) - law.shape(_ACTIVATIONS))
        return jnp.concatenate(found)

    solution = least_squares(
        jax.jit(errors),
        np.zeros(len(sd)),
        jac=jax.jit(jax.jacfwd(errors)),
        bounds=(lower - 1e-9, upper + 1e-9),
        x_scale=sd,
    )
    found = np.clip(solution.x, lower, upper)
    for parameter, value in law.dynamics.items():
        found[LAW_NAMES.index(parameter)] = value
    # The solver stays inside bounds, where zero can be one of them.
    found[np.abs(found) < 1e-6] = 0.0
    return tuple(found.tolist())
