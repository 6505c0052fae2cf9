"""What acts at joints beside muscles: capsules and ligaments, damping, fascia, an orthosis."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.model.alteration import Alteration

Basis = Float[np.ndarray, "parameter trial coordinate frame"]

_PASSIVE_SOURCE = "Riener & Edrich 1999, doi:10.1016/S0021-9290(99)00009-3"
_SWING_SOURCE = "van der Kooij et al. 2022, doi:10.48550/arXiv.2112.05564"
#: How the passive moment grows towards either end (1/rad) and with other joints' angles, in the
#: convention hip flexion, knee flexion and ankle dorsiflexion positive: their equations 1 to 3.
_PER_DEGREE = np.rad2deg(1.0)
_COUPLED: dict[tuple[str, int], dict[str, float]] = {
    ("hip_flexion", 1): {"hip_flexion": 0.0305, "knee_angle": -0.0226},
    ("hip_flexion", -1): {"hip_flexion": -0.0750, "knee_angle": -0.0034},
    ("knee_angle", 1): {"knee_angle": 0.0495, "ankle_angle": -0.0004, "hip_flexion": -0.0128},
    ("knee_angle", -1): {"knee_angle": -0.0352, "ankle_angle": -0.0460, "hip_flexion": 0.0217},
    ("ankle_angle", 1): {"ankle_angle": 0.1949, "knee_angle": 0.0008},
    ("ankle_angle", -1): {"ankle_angle": -0.0843, "knee_angle": -0.0176},
}
_SAGITTAL = ("hip_flexion", "knee_angle", "ankle_angle")
#: Growth towards the ends of range without coupling, 1/rad.
_GENTLE, _STEEP = 4.0, 12.0
#: Of joint damping, N m s/rad.
_DAMPING_SD = {"hip": 2.0, "knee": 0.3, "ankle": 0.3, "subtalar": 0.2}
#: Angles at which an orthosis is at rest (deg).
_NEUTRAL_ANGLES = (-5.0, 0.0, 5.0)
#: How many times as far the spring's knee end moves as its hip end.
_LEVER_RATIOS = (0.5, 1.0)


def passive_joint_moment(context: Context) -> Effect:
    """Resist the ends of the recorded range, one amount a coordinate and direction.

    The moment falls off exponentially from where it is largest in the recorded cycles. Shapes: with the
    rates and the coupling to neighbouring joints of Riener and Edrich (others: the gentle rate), gentle,
    and steep.
    """
    parameters = []
    for name in context.coordinates:
        sagittal = name.startswith(_SAGITTAL)
        for end in ("upper", "lower"):
            parameters.append(
                EffectParameter(
                    name=f"{end}_end_{name}",
                    unit="N m",
                    prior_sd=5.0 if sagittal else 3.0,
                    sign=1,
                    meaning=f"passive moment of {name} against the {end} end, where it is largest",
                    source=_PASSIVE_SOURCE,
                    limit=60.0,
                    part=f"{end}_end_{name}",
                )
            )
    shapes = {"coupled joints": None, "gentle": _GENTLE, "steep": _STEEP}
    return Effect(
        id="passive_joint_moment",
        family="joint",
        parameters=tuple(parameters),
        variants=tuple(Variant(_linear(_ends(context, rate)), label) for label, rate in shapes.items()),
    )


def _ends(context: Context, rate: float | None) -> Basis:
    """Moments of one N m at most; the largest over all cycles."""
    basis = np.zeros((2 * len(context.coordinates), *context.angles.shape))
    for row, name in enumerate(context.coordinates):
        for place, direction in enumerate((1, -1)):
            here, anywhere = (_exponent(one, name, direction, rate) for one in (context, context.reference))
            basis[2 * row + place, :, row] = -direction * np.exp(here - anywhere.max())
    return basis


def _exponent(
    context: Context, name: str, direction: int, rate: float | None
) -> Float[np.ndarray, "trial frame"]:
    stem = next((stem for stem in _SAGITTAL if name.startswith(stem)), None)
    if rate is not None or stem is None:
        own = context.angles[:, context.coordinates.index(name)]
        return (rate or _GENTLE) * direction * own
    # A knee that bends into negative angles has its ends the other way round.
    own_sign = _flexion_sign(context, stem)
    total = np.zeros((len(context.trials), context.angles.shape[-1]))
    for other, growth in _COUPLED[stem, int(direction * own_sign)].items():
        row = context.coordinate(other)
        if row is not None:
            total += _PER_DEGREE * growth * _flexion_sign(context, other) * context.angles[:, row]
    return total


def _flexion_sign(context: Context, stem: str) -> float:
    """1 where flexion is positive, as of hip and ankle; of a knee, what the recorded angles say."""
    row = context.coordinate(stem)
    if stem != "knee_angle" or row is None:
        return 1.0
    angles = context.reference.angles[:, row]
    return 1.0 if np.abs(angles.max()) >= np.abs(angles.min()) else -1.0


def joint_damping(context: Context) -> Effect:
    """Resist motion in proportion to its rate, one amount a coordinate."""
    return Effect(
        id="joint_damping",
        family="joint",
        parameters=tuple(
            EffectParameter(
                name=f"damping_{name}",
                unit="N m s/rad",
                prior_sd=_DAMPING_SD.get(name.split("_")[0], 0.5),
                sign=1,
                meaning=f"damping of {name}",
                source=_SWING_SOURCE,
                limit=20.0,
                part=name,
            )
            for name in context.coordinates
        ),
        variants=(Variant(_linear(_each_alone(-context.velocities))),),
    )


def biarticular_spring(context: Context) -> Effect | NotTestable:
    """Couple hip and knee by a spring across both, slack nowhere: fascia and passive two-joint muscle."""
    hip, knee = context.coordinate("hip_flexion"), context.coordinate("knee_angle")
    if hip is None or knee is None:
        return NotTestable("biarticular_spring", "the moments of hip flexion and knee are not both matched")
    variants = []
    for ratio in _LEVER_RATIOS:
        lever = ratio * _flexion_sign(context, "knee_angle")

        def stretch(one: Context, lever: float = lever) -> Float[np.ndarray, "trial frame"]:
            # Hip flexion stretches what is behind the joints, knee flexion slackens it.
            return one.angles[:, hip] - lever * one.angles[:, knee]

        away = stretch(context) - stretch(context.reference).mean()
        basis = np.zeros((1, *context.angles.shape))
        basis[0, :, hip], basis[0, :, knee] = -away, lever * away
        variants.append(Variant(_linear(basis), f"knee lever {ratio:g} of the hip's"))
    parameter = EffectParameter(
        name="stiffness",
        unit="N m/rad",
        prior_sd=12.0,
        sign=1,
        meaning="stiffness about the hip of a spring across hip and knee",
        source="range 0 to 25 N m/rad, after " + _SWING_SOURCE,
        limit=100.0,
    )
    return Effect("biarticular_spring", "joint", (parameter,), tuple(variants))


def ankle_foot_orthosis(context: Context) -> Effect | NotTestable:
    """Add a spring at the ankle, stiffer one way than the other, in stance and swing alike."""
    ankle = context.coordinate("ankle_angle")
    if ankle is None:
        return NotTestable("ankle_foot_orthosis", "the ankle's moment is not matched")
    source = "Shuman et al. 2021 (0.58 to 3.66 N m/deg), Waterval et al. 2019"

    def parameter(name: str, unit: str, sd: float, sign: int, meaning: str, limit: float) -> EffectParameter:
        return EffectParameter(name, unit, sd, sign, meaning, source, limit)

    variants = []
    for neutral in _NEUTRAL_ANGLES:
        bent = np.rad2deg(context.angles[:, ankle]) - neutral
        basis = np.zeros((3, *context.angles.shape))
        basis[0, :, ankle] = -np.maximum(bent, 0.0)
        basis[1, :, ankle] = np.maximum(-bent, 0.0)
        basis[2, :, ankle] = 1.0
        variants.append(Variant(_linear(basis), f"neutral at {neutral:g} deg"))
    return Effect(
        id="ankle_foot_orthosis",
        family="joint",
        parameters=(
            parameter("dorsiflexion_stiffness", "N m/deg", 1.5, 1, "stiffness against dorsiflexion", 10.0),
            parameter(
                "plantarflexion_stiffness", "N m/deg", 1.0, 1, "stiffness against plantarflexion", 10.0
            ),
            parameter("preload", "N m", 3.0, 0, "moment at the neutral angle, dorsiflexion positive", 30.0),
        ),
        variants=tuple(variants),
    )


def _each_alone(values: Float[np.ndarray, "trial coordinate frame"]) -> Basis:
    """Let each coordinate's values act about that coordinate."""
    count = values.shape[1]
    return np.moveaxis(values, 1, 0)[:, :, None] * np.eye(count)[:, None, :, None]


def _linear(basis: Basis) -> Partial:
    return Partial(_weighted, jnp.asarray(basis))


def _weighted(
    basis: Float[Array, "parameter trial coordinate frame"], effect_sizes: Float[Array, " parameter"]
) -> Alteration:
    return Alteration(moment=jnp.tensordot(effect_sizes, basis, axes=1))
