"""Effects of moments about joints that no muscle makes: passive tissue, damping, springs, an orthosis."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant
from wrapjax.diagnosis.effects.experiments import (
    PASSIVE_STRETCH_AT_TWO_SPEEDS,
    SLOW_PASSIVE_MOTION,
    WITHOUT_ORTHOSIS,
)
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.model.alteration import Alteration

#: Moments per unit of each parameter, N m.
Basis = Float[np.ndarray, "parameter trial coordinate frame"]

_SWING_SOURCE = "van der Kooij et al. 2022, doi:10.48550/arXiv.2112.05564"


def _linear(basis: Basis) -> Partial:
    return Partial(_add_moments, jnp.asarray(basis))


def _add_moments(
    basis: Float[Array, "parameter trial coordinate frame"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(moment=jnp.tensordot(effect_sizes, basis, axes=1))


def _flexion_sign(context: Context, stem: str) -> float:
    """Give the sign of flexion: 1 for hip and ankle; for the knee, that of its largest recorded angle."""
    row = context.coordinate(stem)
    if stem != "knee_angle" or row is None:
        return 1.0
    angles = context.reference.angles[:, row]
    return 1.0 if np.abs(angles.max()) >= np.abs(angles.min()) else -1.0


# ---- Passive moments at the ends of the range of motion

_SAGITTAL = ("hip_flexion", "knee_angle", "ankle_angle")
_PER_DEGREE = np.rad2deg(1.0)
#: Growth of the passive moment towards either end with the angles of the joint and its neighbors (1/deg), for
#: hip flexion, knee flexion and ankle dorsiflexion positive: equations 1 to 3 of Riener & Edrich 1999.
_COUPLED: dict[tuple[str, int], dict[str, float]] = {
    ("hip_flexion", 1): {"hip_flexion": 0.0305, "knee_angle": -0.0226},
    ("hip_flexion", -1): {"hip_flexion": -0.0750, "knee_angle": -0.0034},
    ("knee_angle", 1): {"knee_angle": 0.0495, "ankle_angle": -0.0004, "hip_flexion": -0.0128},
    ("knee_angle", -1): {"knee_angle": -0.0352, "ankle_angle": -0.0460, "hip_flexion": 0.0217},
    ("ankle_angle", 1): {"ankle_angle": 0.1949, "knee_angle": 0.0008},
    ("ankle_angle", -1): {"ankle_angle": -0.0843, "knee_angle": -0.0176},
}
#: Growth without coupling, 1/rad.
_GENTLE, _STEEP = 4.0, 12.0
#: Growth of each variant, 1/rad; None for Riener and Edrich's, outside the sagittal plane the gentle one.
_GROWTH = {"coupled joints": None, "gentle": _GENTLE, "steep": _STEEP}
#: Prior standard deviation of the passive moment in the sagittal plane and outside it, N m.
_PASSIVE_SD, _PASSIVE_SD_ELSEWHERE = 5.0, 3.0


def _each_end(context: Context) -> Iterable[dict[str, Any]]:
    for coordinate in context.coordinates:
        prior_sd = _PASSIVE_SD if coordinate.startswith(_SAGITTAL) else _PASSIVE_SD_ELSEWHERE
        for end in ("upper", "lower"):
            yield {"end": end, "coordinate": coordinate, "prior_sd": prior_sd}


def _passive_joint_moment(context: Context) -> tuple[Variant, ...]:
    return tuple(Variant(_linear(_passive_moments(context, rate)), label) for label, rate in _GROWTH.items())


def _passive_moments(context: Context, rate: float | None) -> Basis:
    """Compute passive moments whose largest value over all cycles is 1 N m."""
    basis = np.zeros((2 * len(context.coordinates), *context.angles.shape))
    for row, name in enumerate(context.coordinates):
        for place, direction in enumerate((1, -1)):
            exponent, of_all_cycles = (
                _exponent(cycles, name, direction, rate) for cycles in (context, context.reference)
            )
            basis[2 * row + place, :, row] = -direction * np.exp(exponent - of_all_cycles.max())
    return basis


def _exponent(
    context: Context, name: str, direction: int, rate: float | None
) -> Float[np.ndarray, "trial frame"]:
    stem = next((stem for stem in _SAGITTAL if name.startswith(stem)), None)
    if rate is not None or stem is None:
        angle = context.angles[:, context.coordinates.index(name)]
        return (rate or _GENTLE) * direction * angle
    # Where a knee's flexion is negative, its upper end is that of extension.
    sign = _flexion_sign(context, stem)
    total = np.zeros((len(context.trials), context.angles.shape[-1]))
    for other, growth in _COUPLED[stem, int(direction * sign)].items():
        row = context.coordinate(other)
        if row is not None:
            total += _PER_DEGREE * growth * _flexion_sign(context, other) * context.angles[:, row]
    return total


# The moment decays exponentially from the end of the recorded range. The variants are its rates of growth.
PASSIVE_JOINT_MOMENT = EffectDefinition(
    id="passive_joint_moment",
    meaning="capsule and ligaments resist motion near the ends of the range",
    family="passive",
    parameters=(
        RepeatedParameter(
            repetitions=_each_end,
            name="{end}_end_{coordinate}",
            unit="N m",
            sign=1,
            meaning="passive moment of {coordinate} against the {end} end, where it is largest",
            source="Riener & Edrich 1999, doi:10.1016/S0021-9290(99)00009-3",
            limit=60.0,
            part="{end}_end_{coordinate}",
            prior=f"{_PASSIVE_SD:g}; {_PASSIVE_SD_ELSEWHERE:g} outside the sagittal plane",
        ),
    ),
    variants=_passive_joint_moment,
    experiment=SLOW_PASSIVE_MOTION,
)


# ---- Damping

#: Prior standard deviation of the damping of each joint, and of all other joints, N m s/rad.
_DAMPING_SD = {"hip": 2.0, "knee": 0.3, "ankle": 0.3, "subtalar": 0.2}
_DAMPING_SD_ELSEWHERE = 0.5


def _each_coordinate_with_damping(context: Context) -> Iterable[dict[str, Any]]:
    for coordinate in context.coordinates:
        prior_sd = _DAMPING_SD.get(coordinate.split("_")[0], _DAMPING_SD_ELSEWHERE)
        yield {"coordinate": coordinate, "prior_sd": prior_sd}


def _joint_damping(context: Context) -> tuple[Variant, ...]:
    values = -context.velocities
    count = values.shape[1]
    # The velocity of each coordinate acts about that coordinate only.
    basis = np.moveaxis(values, 1, 0)[:, :, None] * np.eye(count)[:, None, :, None]
    return (Variant(_linear(basis)),)


JOINT_DAMPING = EffectDefinition(
    id="joint_damping",
    meaning="joints resist motion in proportion to its speed",
    family="passive",
    parameters=(
        RepeatedParameter(
            repetitions=_each_coordinate_with_damping,
            name="damping_{coordinate}",
            unit="N m s/rad",
            sign=1,
            meaning="damping of {coordinate}",
            source=_SWING_SOURCE,
            limit=20.0,
            part="{coordinate}",
            prior=", ".join(f"{joint} {prior_sd:g}" for joint, prior_sd in _DAMPING_SD.items())
            + f", others {_DAMPING_SD_ELSEWHERE:g}",
        ),
    ),
    variants=_joint_damping,
    experiment=PASSIVE_STRETCH_AT_TWO_SPEEDS,
)


# ---- Spring across hip and knee

#: Lever of the spring at the knee as a multiple of its lever at the hip, by variant.
_LEVER_RATIOS = (0.5, 1.0)


def _hip_and_knee(context: Context) -> tuple[int | None, int | None]:
    return context.coordinate("hip_flexion"), context.coordinate("knee_angle")


def _biarticular_spring(context: Context) -> tuple[Variant, ...]:
    hip, knee = _hip_and_knee(context)
    variants = []
    for ratio in _LEVER_RATIOS:
        lever = ratio * _flexion_sign(context, "knee_angle")

        def stretch(cycles: Context, lever: float = lever) -> Float[np.ndarray, "trial frame"]:
            # Hip flexion stretches tissue behind the joints, knee flexion slackens it.
            return cycles.angles[:, hip] - lever * cycles.angles[:, knee]

        from_mean = stretch(context) - stretch(context.reference).mean()
        basis = np.zeros((1, *context.angles.shape))
        basis[0, :, hip], basis[0, :, knee] = -from_mean, lever * from_mean
        variants.append(Variant(_linear(basis), f"knee lever {ratio:g} of the hip's"))
    return tuple(variants)


# Fascia and passive two-joint muscles; the spring is never slack. The variants are the levers.
BIARTICULAR_SPRING = EffectDefinition(
    id="biarticular_spring",
    meaning="tissue that spans hip and knee couples them like a spring",
    family="passive",
    requirements=(
        Requirement(
            "moments of hip flexion and of the knee",
            lambda context: (
                "the moments of hip flexion and knee are not both matched"
                if None in _hip_and_knee(context)
                else ""
            ),
        ),
    ),
    parameters=(
        EffectParameter(
            name="stiffness",
            unit="N m/rad",
            prior_sd=12.0,
            sign=1,
            meaning="stiffness about the hip of a spring across hip and knee",
            source="range 0 to 25 N m/rad, after " + _SWING_SOURCE,
            limit=100.0,
        ),
    ),
    variants=_biarticular_spring,
    experiment=SLOW_PASSIVE_MOTION,
)


# ---- Ankle-foot orthosis

#: Angles at which an orthosis makes no moment, by variant, deg.
_NEUTRAL_ANGLES = (-5.0, 0.0, 5.0)
_ORTHOSIS_SOURCE = "Shuman et al. 2021 (0.58 to 3.66 N m/deg), Waterval et al. 2019"


def _ankle_foot_orthosis(context: Context) -> tuple[Variant, ...]:
    ankle = context.coordinate("ankle_angle")
    variants = []
    for neutral in _NEUTRAL_ANGLES:
        bent = np.rad2deg(context.angles[:, ankle]) - neutral
        basis = np.zeros((3, *context.angles.shape))
        basis[0, :, ankle] = -np.maximum(bent, 0.0)
        basis[1, :, ankle] = np.maximum(-bent, 0.0)
        basis[2, :, ankle] = 1.0
        variants.append(Variant(_linear(basis), f"neutral at {neutral:g} deg"))
    return tuple(variants)


# The spring acts in stance and swing alike. The variants are the neutral angles.
ANKLE_FOOT_ORTHOSIS = EffectDefinition(
    id="ankle_foot_orthosis",
    meaning="a brace or a shoe acts on the ankle like a spring",
    family="device",
    requirements=(
        Requirement(
            "moment of the ankle",
            lambda context: (
                "the ankle's moment is not matched" if context.coordinate("ankle_angle") is None else ""
            ),
        ),
    ),
    parameters=(
        EffectParameter(
            name="dorsiflexion_stiffness",
            unit="N m/deg",
            prior_sd=1.5,
            sign=1,
            meaning="stiffness against dorsiflexion",
            source=_ORTHOSIS_SOURCE,
            limit=10.0,
        ),
        EffectParameter(
            name="plantarflexion_stiffness",
            unit="N m/deg",
            prior_sd=1.0,
            sign=1,
            meaning="stiffness against plantarflexion",
            source=_ORTHOSIS_SOURCE,
            limit=10.0,
        ),
        EffectParameter(
            name="preload",
            unit="N m",
            prior_sd=3.0,
            sign=0,
            meaning="moment at the neutral angle, dorsiflexion positive",
            source=_ORTHOSIS_SOURCE,
            limit=30.0,
        ),
    ),
    variants=_ankle_foot_orthosis,
    experiment=WITHOUT_ORTHOSIS,
)
