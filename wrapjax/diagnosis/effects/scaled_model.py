"""Effects of errors of the scaled model's joints in inverse dynamics: centers, axes, knee laxity."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from wrapjax.diagnosis.effects.definition import EffectDefinition, JointPlace
from wrapjax.diagnosis.effects.effect import EffectParameter
from wrapjax.diagnosis.effects.experiments import STAR_ARC_MOVEMENTS
from wrapjax.diagnosis.inputs.recorded_movement import MomentDerivatives, RecordedMovement
from wrapjax.diagnosis.inputs.recorded_paths import RecordedPaths, engine_motion
from wrapjax.geometry.exact_paths.path_derivatives import derivatives_by_model_changes
from wrapjax.geometry.paths import PathState
from wrapjax.geometry.skeleton.joint_changes import with_moved_joint, with_rotated_joint_axes
from wrapjax.geometry.skeleton.model_description import ModelDescription

#: Variants of a joint in a wrong place: whether the foot stays where it is, held by markers, or is displaced
#: with the joint, since the laboratory's angles are kept.
FOOT_HELD, FOOT_DISPLACED = "foot in place", "foot displaced"

#: Change of a joint: model, coordinate of the joint, axis of the body that carries it, and size (m or rad).
_JointChange = Callable[[ModelDescription, str, int, float], ModelDescription]


def _paths_by_joints(
    recorded: RecordedPaths, changes: list[tuple[_JointChange, str, int, float]]
) -> Mapping[str, PathState]:
    """Compute the paths of a person whose joints differ from the model's.

    Where the model's joint is too far forward, the person's is behind it.

    Parameters
    ----------
    recorded
        Recorded paths.
    changes
        For each parameter: the change of a joint, the start of its coordinate's name, the axis, and the sign
        of the change for a positive effect size.
    """
    engine, names = recorded.engine, recorded.subject.trials.moment_coordinates
    if engine is None:
        return {}

    def person(
        change: _JointChange, stem: str, axis: int, sign: float
    ) -> Callable[[float], ModelDescription]:
        coordinate = next((name for name in names if name.startswith(stem)), None)
        if coordinate is None:
            return lambda step: engine.model
        return lambda step: change(engine.model, coordinate, axis, -sign * step)

    derivatives = derivatives_by_model_changes(
        engine, [person(*change) for change in changes], *engine_motion(engine, recorded.subject)
    )
    return dict.fromkeys((FOOT_HELD, FOOT_DISPLACED), derivatives)


# ---- Hip center


def _moments_by_joint_center(movement: RecordedMovement, stem: str) -> MomentDerivatives:
    """Compute a joint's moment about a center too far forward, up or outward in the body that carries it.

    Markers hold the foot, so that only this joint's moment changes.

    Parameters
    ----------
    movement
        Recorded movement.
    stem
        Start of the names of the joint's coordinates.
    """
    force, held = movement.transmitted_wrenches()[:, 3:], movement.no_change(3)
    for row in movement.rows_of(stem):
        axes = movement.mechanics.rotation[_carrier(movement, row)]
        for number, sign in enumerate((1.0, 1.0, movement.outward)):
            lever = np.cross(sign * axes[:, number], force[row], axis=0)
            held[number, row] = -(movement.mechanics.screw[row, :3] * lever).sum(axis=0)
    return held


def _moments_by_hip_center(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the hip's moment about a center too far forward, up or outward in the pelvis.

    Where markers hold the foot, only the hip's moment changes. Where angles are kept, the model's leg is
    displaced with its hip, and the ground reaction force acts elsewhere on the whole leg.
    """
    outward = np.diag([1.0, 1.0, movement.outward])
    rows, displaced = movement.rows_of("hip_"), movement.no_change(3)
    for number in range(3) if rows else ():
        name = movement.mechanics.coordinates[rows[0]]
        displaced[number] = movement.derivative_by_joint(name, outward[number], np.zeros(3))
    return {FOOT_HELD: _moments_by_joint_center(movement, "hip_"), FOOT_DISPLACED: displaced}


def _paths_by_hip_center(recorded: RecordedPaths) -> Mapping[str, PathState]:
    signs = (1.0, 1.0, recorded.movement.outward)
    return _paths_by_joints(
        recorded, [(with_moved_joint, "hip_", axis, sign) for axis, sign in enumerate(signs)]
    )


_HIP_SOURCE = (
    "Stagni et al. 2000, doi:10.1016/S0021-9290(00)00093-2; usual: 12 mm between regression and computed "
    "tomography, Mantovani et al. 2016, Gait & Posture 44:48-54"
)
#: Standard deviation of the hip's center about that of the scaled model along each axis, m.
_USUAL_HIP = 0.007

HIP_CENTER_OFFSET = EffectDefinition(
    id="hip_center_offset",
    meaning="the hip's center lies elsewhere than in the model",
    family="geometry",
    parameters=(
        EffectParameter(
            name="anterior_m",
            unit="m",
            prior_sd=0.015,
            sign=0,
            meaning="hip center placed too far forward",
            source=_HIP_SOURCE,
            limit=0.06,
            part="anterior",
            usual_sd=_USUAL_HIP,
        ),
        EffectParameter(
            name="superior_m",
            unit="m",
            prior_sd=0.015,
            sign=0,
            meaning="hip center placed too far up",
            source=_HIP_SOURCE,
            limit=0.06,
            part="superior",
            usual_sd=_USUAL_HIP,
        ),
        EffectParameter(
            name="lateral_m",
            unit="m",
            prior_sd=0.015,
            sign=0,
            meaning="hip center placed too far outward",
            source=_HIP_SOURCE,
            limit=0.06,
            part="lateral",
            usual_sd=_USUAL_HIP,
        ),
    ),
    joint_places=tuple(JointPlace("hip_", "translation", axis) for axis in range(3)),
    moment_derivatives=_moments_by_hip_center,
    path_derivatives=_paths_by_hip_center,
    experiment=STAR_ARC_MOVEMENTS,
)


# ---- Knee and ankle centers

_LANDMARKS = "landmarks between examiners: Della Croce et al. 2005, doi:10.1016/j.gaitpost.2004.05.003"
#: Start of the coordinate's name, and standard deviation of the center about the scaled model's, m.
_DISTAL_CENTERS = (("knee_angle", 0.005), ("ankle_angle", 0.003))


def _moments_by_distal_centers(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    return {"": np.concatenate([_moments_by_joint_center(movement, stem) for stem, _ in _DISTAL_CENTERS])}


# No effect of the catalogue moves these joints. The paths of their muscles are uncertain in every null
# hypothesis by themselves.
JOINT_CENTER_SPREAD = EffectDefinition(
    id="joint_center_spread",
    meaning="centers of knee and ankle lie as far from the model's as is usual",
    family="geometry",
    parameters=tuple(
        EffectParameter(
            name=f"{stem.split('_')[0]}_{direction}_m",
            unit="m",
            prior_sd=sd,
            sign=0,
            meaning=f"{stem.split('_')[0]} center placed too far {words}",
            source=_LANDMARKS,
        )
        for stem, sd in _DISTAL_CENTERS
        for direction, words in (("anterior", "forward"), ("superior", "up"), ("lateral", "outward"))
    ),
    joint_places=tuple(
        JointPlace(stem, "translation", axis) for stem, _ in _DISTAL_CENTERS for axis in range(3)
    ),
    moment_derivatives=_moments_by_distal_centers,
    nuisance=True,
)


# ---- Joint axes

#: For each parameter of `JOINT_AXIS_ROTATION`: the axis of the body that carries the joint (forward, up, to
#: the right) about which the joint's axis is rotated.
_AXIS_ROTATIONS = (
    JointPlace("knee_angle", "orientation", 1),
    JointPlace("knee_angle", "orientation", 0),
    JointPlace("ankle_angle", "orientation", 1),
    JointPlace("ankle_angle", "orientation", 0),
    JointPlace("subtalar_angle", "orientation", 1),
    JointPlace("subtalar_angle", "orientation", 2),
)


def _moments_by_joint_axes(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the joint's moment about an axis that is rotated by either of the two angles that place it.

    One rotation is that of toes that turn out. The other is about the direction across: forward for knee and
    ankle, whose axes run from side to side, and outward for the subtalar joint, whose axis runs forward.
    Where markers do not hold the foot, a bent joint also displaces it.
    """
    mechanics, wrench = movement.mechanics, movement.transmitted_wrenches()
    held, displaced = movement.no_change(len(_AXIS_ROTATIONS)), movement.no_change(len(_AXIS_ROTATIONS))
    for number, place in enumerate(_AXIS_ROTATIONS):
        sign = place.sign(movement.outward)
        for row in movement.rows_of(place.stem):
            moment = wrench[row, :3] - np.cross(mechanics.joint_center[row], wrench[row, 3:], axis=0)
            about = sign * mechanics.rotation[_carrier(movement, row), :, place.axis]
            rotated = np.cross(about, mechanics.screw[row, :3], axis=0)
            held[number, row] = (rotated * moment).sum(axis=0)
            name = mechanics.coordinates[row]
            displaced[number] += movement.derivative_by_joint(name, np.zeros(3), sign * np.eye(3)[place.axis])
    return {FOOT_HELD: held, FOOT_DISPLACED: displaced}


def _carrier(movement: RecordedMovement, coordinate: int) -> int:
    """Find the body that carries a coordinate's joint; the joint's child body where that is ground."""
    mechanics = movement.mechanics
    moved = np.flatnonzero(mechanics.moves[coordinate])
    names = [mechanics.bodies[body] for body in moved]
    child = next(body for body in moved if mechanics.parents[body] not in names)
    parent = mechanics.parents[child]
    return mechanics.bodies.index(parent) if parent in mechanics.bodies else int(child)


def _paths_by_joint_axes(recorded: RecordedPaths) -> Mapping[str, PathState]:
    outward = recorded.movement.outward
    return _paths_by_joints(
        recorded,
        [(with_rotated_joint_axes, place.stem, place.axis, place.sign(outward)) for place in _AXIS_ROTATIONS],
    )


_AXIS_SOURCE = (
    "5 to 15 degrees; usual: knee, landmarks between examiners, Della Croce et al. 2005, "
    "doi:10.1016/j.gaitpost.2004.05.003; ankle and subtalar joint, spread between cadavers, Isman and Inman "
    "1969, Bull. Prosthet. Res. 10-11:97-129"
)


def _axis_parameter(name: str, usual_sd: float, meaning: str) -> EffectParameter:
    part = name.split("_")[0]
    return EffectParameter(
        name, "rad", 0.12, 0, meaning, _AXIS_SOURCE, limit=0.5, part=part, usual_sd=usual_sd
    )


JOINT_AXIS_ROTATION = EffectDefinition(
    id="joint_axis_rotation",
    meaning="axes of knee, ankle or foot point elsewhere than in the model",
    family="geometry",
    parameters=(
        _axis_parameter("knee_rad", 0.07, "knee axis turned outward in the horizontal plane"),
        _axis_parameter("knee_tilt_rad", 0.035, "knee axis with its outer end too high"),
        _axis_parameter("ankle_rad", 0.10, "ankle axis turned outward in the horizontal plane"),
        _axis_parameter("ankle_tilt_rad", 0.07, "ankle axis with its outer end too high"),
        _axis_parameter("subtalar_rad", 0.15, "subtalar axis turned outward in the horizontal plane"),
        _axis_parameter("subtalar_pitch_rad", 0.12, "subtalar axis with its front end too high"),
    ),
    joint_places=_AXIS_ROTATIONS,
    moment_derivatives=_moments_by_joint_axes,
    path_derivatives=_paths_by_joint_axes,
    experiment=STAR_ARC_MOVEMENTS,
)


# ---- Knee laxity


def _moments_by_knee_laxity(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the moments of hip and knee adduction of a vertical force that acts further outward."""
    vertical = np.zeros_like(movement.wrenches)
    vertical[:, 4] = movement.wrenches[:, 4]
    change = np.zeros_like(movement.wrenches)
    outward = movement.outward * movement.rightward
    change[:, :3] = np.cross(outward[None], vertical[:, 3:], axis=1)
    derivatives = movement.no_change(1)
    rows = movement.rows_of("hip_adduction") + movement.rows_of("knee_adduction")
    derivatives[0, rows] = movement.derivative_by_wrenches(change)[rows]
    return {"": derivatives}


KNEE_LAXITY = EffectDefinition(
    id="knee_laxity",
    meaning="the knee gives way sideways",
    family="geometry",
    parameters=(
        EffectParameter(
            name="lever_m",
            unit="m",
            prior_sd=0.01,
            sign=0,
            meaning="change of the vertical force's lever about the hip and knee",
            source="varus and valgus under load",
            limit=0.05,
            part="lever",
        ),
    ),
    moment_derivatives=_moments_by_knee_laxity,
    experiment=STAR_ARC_MOVEMENTS,
)
