"""Effects of errors in the measured external forces: place, timing, crossed plates, other forces."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.effects.definition import EffectDefinition, Requirement
from wrapjax.diagnosis.effects.effect import EffectParameter
from wrapjax.diagnosis.effects.experiments import ROD_ON_PLATE, SYNC_PULSE, WITHOUT_ORTHOSIS
from wrapjax.diagnosis.inputs.recorded_movement import CONTACT, MomentDerivatives, RecordedMovement

# ---- Center of pressure


def _moments_by_cop_offset(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the moments of forces that act too far forward, and too far outward."""
    directions = (movement.forward, movement.outward * movement.rightward)
    return {"": np.stack([_moments_by_displaced_forces(movement, direction) for direction in directions])}


def _moments_by_displaced_forces(
    movement: RecordedMovement, direction: Float[np.ndarray, "3 pose"]
) -> Float[np.ndarray, "coordinate pose"]:
    change = np.zeros_like(movement.wrenches)
    change[:, :3] = np.cross(direction[None], movement.wrenches[:, 3:], axis=1)
    return movement.derivative_by_wrenches(change)


COP_OFFSET = EffectDefinition(
    id="cop_offset",
    meaning="the ground reaction force acts elsewhere on the foot than recorded",
    family="measured_force",
    parameters=(
        EffectParameter(
            name="anterior_m",
            unit="m",
            prior_sd=0.010,
            sign=0,
            meaning="center of pressure recorded too far forward",
            source="plates in treadmills, PMC2665306",
            limit=0.05,
            part="anterior",
        ),
        EffectParameter(
            name="lateral_m",
            unit="m",
            prior_sd=0.010,
            sign=0,
            meaning="center of pressure recorded too far outward",
            source="plates in treadmills, PMC2665306",
            limit=0.05,
            part="lateral",
        ),
    ),
    moment_derivatives=_moments_by_cop_offset,
    in_one_condition=True,
    experiment=ROD_ON_PLATE,
)


# ---- Timing


def _moments_by_latency(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the moments of forces that were recorded later than motion."""
    return {"": movement.derivative_by_wrenches(movement.wrenches_by_latency)[None]}


FORCE_LATENCY = EffectDefinition(
    id="force_latency",
    meaning="ground forces and motion are not recorded at the same time",
    family="measured_force",
    parameters=(
        EffectParameter(
            name="latency",
            unit="s",
            prior_sd=0.010,
            sign=0,
            meaning="forces recorded later than motion",
            source="10 to 15 ms",
            limit=0.05,
            part="latency",
        ),
    ),
    moment_derivatives=_moments_by_latency,
    in_one_condition=True,
    experiment=SYNC_PULSE,
)


# ---- Crossed plates

_CROSSED_SOURCE = "0 to 20 % of a foot's force"


def _moments_by_crossed_plates(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the moments of shares of the feet's forces that plates assign to the wrong foot.

    While both feet are in contact: of the other foot's force, where it acts or at this foot's center of
    pressure; and of this foot's own force, which the other plate records.
    """
    other, this = movement.other_foot_wrench(), movement.wrenches.sum(axis=0)
    both = movement.in_contact & (other[4] > CONTACT * movement.reference.other_foot_wrench()[4].max())
    point = movement.center_of_pressure
    leaked = np.concatenate([np.cross(point, other[3:], axis=0), other[3:]])
    derivatives = []
    for crossed in (other, leaked, this):
        change = np.zeros_like(movement.wrenches)
        change[0] = np.where(both, crossed, 0.0)
        derivatives.append(movement.derivative_by_wrenches(change))
    return {"": np.stack(derivatives)}


CROSSED_PLATES = EffectDefinition(
    id="crossed_plates",
    meaning="a plate's force contains a part of the other foot's",
    family="measured_force",
    parameters=(
        EffectParameter(
            name="other_share",
            unit="1",
            prior_sd=0.10,
            sign=0,
            meaning="share of the other foot's force, where that foot is",
            source=_CROSSED_SOURCE,
            limit=0.5,
            part="other",
        ),
        EffectParameter(
            name="leaked_share",
            unit="1",
            prior_sd=0.10,
            sign=0,
            meaning="share of the other foot's force, taken to act on this one",
            source=_CROSSED_SOURCE,
            limit=0.5,
            part="leaked",
        ),
        EffectParameter(
            name="own_share",
            unit="1",
            prior_sd=0.10,
            sign=0,
            meaning="share of this foot's own force in double support",
            source=_CROSSED_SOURCE,
            limit=0.5,
            part="own",
        ),
    ),
    moment_derivatives=_moments_by_crossed_plates,
)


# ---- Forces that no supported recording contains: their definitions have no derivatives of the moments yet

BELT_ACCELERATION = EffectDefinition(
    id="belt_acceleration",
    meaning="the treadmill's plates record their own acceleration",
    family="measured_force",
    requirements=(Requirement("belt speed", lambda context: "no belt speed is recorded"),),
    parameters=(
        EffectParameter(
            name="moment_scale",
            unit="1",
            prior_sd=0.5,
            sign=0,
            meaning="share of the plate's pitching moment that was not subtracted",
            source="Hnat & van den Bogert 2014, 12 N m RMS",
            limit=2.0,
            part="moment",
        ),
    ),
    experiment=ROD_ON_PLATE,
)

# A negative control: inverse dynamics from the ground up do not depend on the force of a hand.
HANDRAIL_FORCE = EffectDefinition(
    id="handrail_force",
    meaning="a hand leans on the rail",
    family="measured_force",
    requirements=(Requirement("handrail force", lambda context: "no handrail force is recorded"),),
    parameters=(
        EffectParameter(
            name="share",
            unit="1",
            prior_sd=0.5,
            sign=1,
            meaning="share of the rail's force",
            source="negative control: inverse dynamics from the ground up do not depend on it",
            limit=2.0,
            part="share",
        ),
    ),
    negative_control=True,
)

DEVICE_TORQUE = EffectDefinition(
    id="device_torque",
    meaning="a powered device moves the joint",
    family="device",
    requirements=(Requirement("torque of a device", lambda context: "no torque of a device is recorded"),),
    parameters=(
        EffectParameter(
            name="scale",
            unit="1",
            prior_sd=0.5,
            sign=0,
            meaning="share of the commanded torque that acts",
            source="the device's log",
            limit=2.0,
            part="scale",
        ),
    ),
    experiment=WITHOUT_ORTHOSIS,
)
