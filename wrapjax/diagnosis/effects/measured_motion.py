"""Effects of errors in the measured motion: soft tissue artifacts, a deforming foot, gait events."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter, Requirement
from wrapjax.diagnosis.effects.effect import EffectParameter, EffectSizes, Variant, add_to_paths, delay_emg
from wrapjax.diagnosis.effects.experiments import MULTI_SEGMENT_FOOT, SQUAT_WITH_CLUSTERS, THIRD_WALKING_SPEED
from wrapjax.diagnosis.effects.periodic import periodic_bell
from wrapjax.diagnosis.inputs.context import Context, MeasuredChange
from wrapjax.diagnosis.inputs.recorded_movement import MomentDerivatives, RecordedMovement
from wrapjax.diagnosis.inputs.recorded_paths import RecordedPaths
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration

# ---- Soft tissue artifact

#: Phase at which the skin slides most, by variant, and width of the slide, in gait cycles.
_SLIDES = {"loading": 0.10, "early swing": 0.70}
_SLIDE_WIDTH = 0.10
_ARTIFACT_SOURCE = (
    "thigh 10, shank 7 degrees: PMC8631460; usual: knee angles in walking wrong by up to 4.4 degrees on "
    "average, Benoit et al. 2006, doi:10.1016/j.gaitpost.2005.04.012"
)
#: Standard deviation between people of a slide (rad), and of each share of an angle: 1.7 degrees at a knee
#: that bends by 60 degrees.
_USUAL_SLIDE = 0.028


def neighboring_coordinates(coordinates: Sequence[str]) -> tuple[int, ...]:
    """Find, for each coordinate, the other coordinate that moves its skin most.

    Knee flexion moves the skin of thigh and shank, hip flexion that over the knee. Empty where either is not
    among the coordinates.
    """
    knee, hip = (
        next((row for row, name in enumerate(coordinates) if name.startswith(stem)), None)
        for stem in ("knee_angle", "hip_flexion")
    )
    if knee is None or hip is None:
        return ()
    return tuple(hip if row == knee else knee for row in range(len(coordinates)))


def skin_slides(
    phase: Float[np.ndarray, " frame"],
) -> dict[str, tuple[Float[np.ndarray, " frame"], Float[np.ndarray, " frame"]]]:
    """Compute how far skin slides over the gait cycle, 1 at most, and the derivative by phase, by variant."""
    return {label: periodic_bell(phase, center, _SLIDE_WIDTH) for label, center in _SLIDES.items()}


def _each_coordinate(context: Context) -> Iterable[dict[str, str]]:
    return [{"coordinate": name} for name in context.coordinates]


def _each_neighbor(context: Context) -> Iterable[dict[str, str]]:
    names = context.coordinates
    return [
        {"coordinate": names[row], "neighbor": names[other]}
        for row, other in enumerate(neighboring_coordinates(names))
    ]


def _soft_tissue_artifact(context: Context) -> tuple[Variant, ...]:
    assert context.paths_by_angle is not None, "required before variants are built"
    changes = context.measured_changes.get(SOFT_TISSUE_ARTIFACT.id, {})
    return tuple(
        Variant(
            Partial(
                _misread_angles,
                context.paths_by_angle,
                context.paths.moment_arm,
                *_angle_errors(context, *slide),
                changes.get(label),
            ),
            label,
        )
        for label, slide in skin_slides(context.phase).items()
    )


def _angle_errors(
    context: Context, slide: Float[np.ndarray, " frame"], by_phase: Float[np.ndarray, " frame"]
) -> tuple[Array, Array]:
    """Compute errors of angles and angular velocities per unit of the slide, and of both shares."""
    shape, gait = context.angles.shape, context.is_gait[:, None, None]
    angles = [np.broadcast_to(slide * gait, shape), context.angles]
    rates = [np.broadcast_to(gait * by_phase / context.duration[:, None, None], shape), context.velocities]
    if neighbors := neighboring_coordinates(context.coordinates):
        angles.append(context.angles[:, neighbors])
        rates.append(context.velocities[:, neighbors])
    return jnp.asarray(np.stack(angles)), jnp.asarray(np.stack(rates))


def _misread_angles(
    by_angle: PathState,
    moment_arm: Float[Array, "muscle trial coordinate frame"],
    angles: Float[Array, "kind trial coordinate frame"],
    rates: Float[Array, "kind trial coordinate frame"],
    change: MeasuredChange | None,
    effect_sizes: EffectSizes,
) -> Alteration:
    sizes = effect_sizes.reshape(len(angles), -1)
    # The angles of the bones are the recorded ones less the error.
    angle, rate = (-jnp.einsum("kc,ktcf->tcf", sizes, errors) for errors in (angles, rates))
    length, velocity, arm = (
        jnp.einsum("tcf,mct...f->mt...f", angle, leaf)
        for leaf in (by_angle.length, by_angle.velocity, by_angle.moment_arm)
    )
    # Where an angle changes faster than was recorded, length falls faster by the moment arm.
    velocity -= jnp.einsum("tcf,mtcf->mtf", rate, moment_arm)
    return Alteration(
        paths=Partial(add_to_paths, PathState(length, velocity, arm)),
        moment=None if change is None else change(effect_sizes),
    )


def _moments_by_soft_tissue(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the moments of angles that the bones did not have."""
    count, (trials, frames) = len(movement.mechanics.coordinates), movement.time.shape
    rows_in_mechanics, rows = movement.independent_rows
    angles = np.zeros((count, trials, frames))
    angles[rows_in_mechanics] = movement.motion.values[rows].reshape(-1, trials, frames)
    each_alone = np.eye(count)[:, :, None, None]
    shares = [movement.derivatives_by_angles(each_alone * angles)]
    if neighbors := neighboring_coordinates(movement.mechanics.coordinates):
        shares.append(movement.derivatives_by_angles(each_alone * angles[list(neighbors)]))
    slides = {
        label: movement.derivatives_by_angles(
            np.broadcast_to(movement.is_gait * each_alone * slide, (count, count, trials, frames))
        )
        for label, (slide, _) in skin_slides(np.linspace(0.0, 1.0, frames)).items()
    }
    return {label: np.concatenate([by_slide, *shares]) for label, by_slide in slides.items()}


# The error of an angle has three parts: a slide at a phase of the cycle, a share of the angle itself, and a
# share of the angle of the neighboring joint that moves the skin. Muscles have the paths of the bones'
# angles, to first order, moment arms included. Where ground reaction forces were recorded, inverse dynamics
# took the wrong angles too. The variants are the phases of the slide.
SOFT_TISSUE_ARTIFACT = EffectDefinition(
    id="soft_tissue_artifact",
    meaning="skin and markers move against the bones, so that recorded angles are wrong",
    family="measured_motion",
    requirements=(
        Requirement(
            "paths as polynomials of the joint angles",
            lambda context: (
                "paths are not known as a function of joint angles" if context.paths_by_angle is None else ""
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=_each_coordinate,
            name="slide_{coordinate}",
            unit="rad",
            prior_sd=0.06,
            sign=0,
            meaning="error of {coordinate} where it is largest",
            source=_ARTIFACT_SOURCE,
            limit=0.3,
            part="{coordinate}",
            usual_sd=_USUAL_SLIDE,
        ),
        RepeatedParameter(
            repetitions=_each_coordinate,
            name="share_{coordinate}",
            unit="1",
            prior_sd=0.06,
            sign=0,
            meaning="error of {coordinate} as a share of the angle",
            source=_ARTIFACT_SOURCE,
            limit=0.3,
            part="{coordinate}",
            usual_sd=_USUAL_SLIDE,
        ),
        RepeatedParameter(
            repetitions=_each_neighbor,
            name="share_of_{neighbor}_in_{coordinate}",
            unit="1",
            prior_sd=0.06,
            sign=0,
            meaning="error of {coordinate} as a share of the angle of {neighbor}",
            source=_ARTIFACT_SOURCE,
            limit=0.3,
            part="{coordinate}",
            usual_sd=_USUAL_SLIDE,
        ),
    ),
    variants=_soft_tissue_artifact,
    moment_derivatives=_moments_by_soft_tissue,
    experiment=SQUAT_WITH_CLUSTERS,
)


# ---- Deformation of the foot

#: Share of the largest moment on the forefoot at which it begins to bend the foot.
_ONSET = 0.05


def foot_loads(movement: RecordedMovement) -> dict[str, Float[np.ndarray, "trial frame"]]:
    """Compute the load that bends the foot, by variant: vertical force, or moment on the forefoot.

    Relative to the largest one of the gait. Empty without an ankle.
    """
    rows = movement.rows_of("ankle_angle")
    if not rows:
        return {}
    # A load with a sudden onset would require accelerations that no foot has.
    onset = _ONSET * np.abs(_moment_on_forefoot(movement.reference, rows[0])).max()

    def loads(of: RecordedMovement) -> dict[str, Float[np.ndarray, " pose"]]:
        upward = _moment_on_forefoot(of, rows[0])
        return {"whole foot": of.force[1], "forefoot": 0.5 * (upward + np.hypot(upward, onset))}

    largest = {label: load.max() for label, load in loads(movement.reference).items()}
    return {
        label: (load / largest[label]).reshape(movement.time.shape)
        for label, load in loads(movement).items()
        if largest[label] > 0.0
    }


def _moment_on_forefoot(movement: RecordedMovement, ankle: int) -> Float[np.ndarray, " pose"]:
    """Compute the moment of the ground about the ankle that bends the forefoot upwards, N m."""
    moment, force = movement.wrenches.sum(axis=0).reshape(2, 3, -1)
    at_ankle = moment - np.cross(movement.mechanics.joint_center[ankle], force, axis=0)
    return np.asarray((at_ankle * movement.rightward).sum(axis=0))


def _moments_by_foot(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the moments of an ankle recorded too far in dorsiflexion, in proportion to the foot's load."""
    derivatives = {}
    for label, load in foot_loads(movement).items():
        errors = np.zeros((1, len(movement.mechanics.coordinates), *movement.time.shape))
        errors[0, movement.rows_of("ankle_angle")] = load
        derivatives[label] = movement.derivatives_by_angles(errors)
    return derivatives


def _paths_by_foot(recorded: RecordedPaths) -> Mapping[str, PathState]:
    """Compute the paths of an ankle that is less dorsiflexed than recorded, per rad at the largest load."""
    paths, by_angle, movement = recorded.paths, recorded.by_angle, recorded.movement
    if by_angle is None or paths is None:
        return {}
    names = recorded.subject.trials.moment_coordinates
    ankle = [row for row, name in enumerate(names) if name.startswith("ankle_angle")][:1]
    step = (movement.time[:, 1] - movement.time[:, 0])[:, None]

    def changed(load: Float[np.ndarray, "trial frame"]) -> PathState:
        # The angle of the bones is the recorded one less the error.
        arm, bend = paths.moment_arm[:, :, ankle[0]], -load
        rate = np.gradient(bend, axis=-1) / step
        by_ankle = jax.tree.map(lambda leaf: leaf[:, ankle], by_angle)
        return PathState(
            length=bend * by_ankle.length,
            velocity=bend * by_ankle.velocity - (rate * arm)[:, None],
            moment_arm=bend[:, None] * by_ankle.moment_arm,
        )

    return {label: changed(load) for label, load in foot_loads(movement).items()}


# The variants are the loads that bend the foot.
FOOT_DEFORMATION = EffectDefinition(
    id="foot_deformation",
    meaning="the foot bends, where the model has it rigid",
    family="measured_motion",
    parameters=(
        EffectParameter(
            name="bend",
            unit="rad",
            prior_sd=0.06,
            sign=0,
            meaning="ankle recorded too far in dorsiflexion where the foot is loaded most",
            source="ankle angles off by up to 7.3 degrees, PMC8085108",
            limit=0.3,
            part="bend",
        ),
    ),
    moment_derivatives=_moments_by_foot,
    path_derivatives=_paths_by_foot,
    experiment=MULTI_SEGMENT_FOOT,
)


# ---- Gait events


def _event_jitter(context: Context) -> tuple[Variant, ...]:
    cycles = context.reference.gait_cycles
    is_cycle = np.array([[other == name for other in cycles] for name in context.trials], dtype=float)
    durations = jnp.asarray(is_cycle * context.duration[:, None])
    return (Variant(Partial(_shift_cycles, jnp.ones(len(context.muscles)), durations)),)


def _shift_cycles(
    each: Float[Array, " muscle"], durations: Float[Array, "trial parameter"], effect_sizes: EffectSizes
) -> Alteration:
    return Alteration(emg=Partial(delay_emg, each[:, None] * (durations @ effect_sizes)[None]))


EVENT_JITTER = EffectDefinition(
    id="event_jitter",
    meaning="EMG and motion of single cycles are shifted against each other",
    family="measured_motion",
    requirements=(
        Requirement(
            "two cycles",
            lambda context: (
                "the shift of one cycle alone is a delay" if len(context.reference.gait_cycles) < 2 else ""
            ),
        ),
    ),
    parameters=(
        RepeatedParameter(
            repetitions=lambda context: [{"cycle": name} for name in context.reference.gait_cycles],
            name="shift_{cycle}",
            unit="1",
            prior_sd=0.02,
            sign=0,
            meaning="share of the cycle by which the EMG of {cycle} is late",
            source="2 % of a cycle",
            limit=0.1,
        ),
    ),
    variants=_event_jitter,
    experiment=THIRD_WALKING_SPEED,
)
