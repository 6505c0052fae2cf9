"""The catalogue: every effect by its id, and which of them a subject's recording can show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects import (
    activation,
    bounds,
    drive,
    emg,
    fiber,
    geometry,
    joint,
    kinematics,
    measurement,
    tendon,
)
from wrapjax.diagnosis.effects.effect import Effect, NotTestable
from wrapjax.errors import InputError, Problem, nearest_name


@dataclass(frozen=True)
class Entry:
    """An effect before it is known for which subject.

    Parameters
    ----------
    meaning
        What is different in the person or the recording: a clause in words of the laboratory.
    on
        Gives the effect for a subject, or why its recording cannot show it.
    """

    meaning: str
    on: Callable[[Context], Effect | NotTestable]


#: By id. Effects that are composed act in this order.
CATALOGUE: dict[str, Entry] = {
    "tendon_compliance": Entry("tendons stretch under load", tendon.tendon_compliance),
    "slow_fibers": Entry("muscle fibers shorten more slowly than assumed", fiber.slow_fibers),
    "activation_dependent_fiber_length": Entry(
        "muscles that are little active are strongest at greater length",
        fiber.activation_dependent_fiber_length,
    ),
    "curve_family": Entry("force depends on fiber length and velocity by other curves", fiber.curve_family),
    "force_enhancement": Entry(
        "force depends on whether the muscle was stretched or shortened just before", fiber.force_enhancement
    ),
    "short_range_stiffness": Entry(
        "muscles at rest are stiff when they begin to move", fiber.short_range_stiffness
    ),
    "force_sharing": Entry(
        "soleus and gastrocnemius pass force to each other sideways", tendon.force_sharing
    ),
    "contracture": Entry("muscles are shorter at rest, as after a stroke", fiber.contracture),
    "passive_joint_moment": Entry(
        "capsule and ligaments resist the ends of the range", joint.passive_joint_moment
    ),
    "joint_damping": Entry("joints resist motion in proportion to its speed", joint.joint_damping),
    "biarticular_spring": Entry(
        "tissue that spans hip and knee couples them like a spring", joint.biarticular_spring
    ),
    "ankle_foot_orthosis": Entry(
        "a brace or a shoe acts on the ankle like a spring", joint.ankle_foot_orthosis
    ),
    "missing_drive": Entry("muscles without an electrode are active", drive.missing_drive),
    "speed_dependent_delay": Entry(
        "force follows EMG with another delay at another walking speed", emg.speed_dependent_delay
    ),
    "emg_drift": Entry("a channel's gain changes from the first cycle to the last", emg.emg_drift),
    "emg_smoothing": Entry("filtered envelopes lack quick changes that muscles were told", emg.emg_smoothing),
    "emg_crosstalk": Entry("an electrode records a neighboring muscle as well", emg.emg_crosstalk),
    "activation_family": Entry(
        "muscles turn excitation into activation by other dynamics", activation.activation_family
    ),
    "emg_nonlinearity": Entry(
        "activation does not rise with EMG along the assumed curve", activation.emg_nonlinearity
    ),
    "posture_dependent_gain": Entry(
        "a channel's gain changes with the joint's angle", emg.posture_dependent_gain
    ),
    "emg_offset": Entry("envelopes do not come down to zero at rest", emg.emg_offset),
    "spasticity_unrecorded": Entry(
        "muscles without an electrode answer to fast stretch", drive.spasticity_unrecorded
    ),
    "spasticity_recorded": Entry(
        "recorded muscles answer to fast stretch, which their EMG shows already", drive.spasticity_recorded
    ),
    "deactivation_asymmetry": Entry(
        "muscles let go more slowly or faster than assumed", activation.deactivation_asymmetry
    ),
    "soft_tissue_artifact": Entry(
        "skin and markers move against the bones, so recorded angles are off", kinematics.soft_tissue_artifact
    ),
    "event_jitter": Entry(
        "EMG and motion of single cycles are shifted against each other", kinematics.event_jitter
    ),
    "wrap_surface": Entry(
        "cylinders that muscles wrap round lie elsewhere or have another size", geometry.wrap_surface
    ),
    "muscle_attachment": Entry("muscles begin or end elsewhere on the bones", geometry.muscle_attachment),
    "bound_pressure": Entry("a calibrated parameter is held back by its bound", bounds.bound_pressure),
    "cop_offset": Entry(
        "the ground force acts elsewhere on the foot than recorded", measurement.of_chain("cop_offset")
    ),
    "hip_center_offset": Entry(
        "the hip's center lies elsewhere than in the model", measurement.of_chain("hip_center_offset")
    ),
    "joint_axis_rotation": Entry(
        "axes of knee, ankle or foot point elsewhere than in the model",
        measurement.of_chain("joint_axis_rotation"),
    ),
    "force_latency": Entry(
        "ground forces and motion are not recorded at the same time", measurement.of_chain("force_latency")
    ),
    "segment_inertia": Entry(
        "thigh, shank or foot are heavier or lighter than in the model",
        measurement.of_chain("segment_inertia"),
    ),
    "crossed_plates": Entry(
        "a plate's force holds some of the other foot's", measurement.of_chain("crossed_plates")
    ),
    "belt_acceleration": Entry(
        "the treadmill's plates record their own acceleration", measurement.of_chain("belt_acceleration")
    ),
    "handrail_force": Entry("a hand leans on the rail", measurement.of_chain("handrail_force")),
    "foot_deformation": Entry(
        "the foot bends, where the model has it rigid", measurement.of_chain("foot_deformation")
    ),
    "wobbling_mass": Entry(
        "soft tissue swings after the foot's impact", measurement.of_chain("wobbling_mass")
    ),
    "device_torque": Entry("a powered device moves the joint", measurement.of_chain("device_torque")),
    "knee_laxity": Entry("the knee gives way sideways", measurement.of_chain("knee_laxity")),
}


def catalogue(context: Context, without: Sequence[str] = ()) -> tuple[Effect | NotTestable, ...]:
    """Say of every effect what it is for this subject, or why its recording cannot show it.

    Parameters
    ----------
    context
        The subject and its cycles.
    without
        Ids of effects to leave out.

    Raises
    ------
    InputError
        If an effect to be left out is not in the catalogue.
    """
    refuse_unknown(without)
    return tuple(entry.on(context) for id, entry in CATALOGUE.items() if id not in without)


def refuse_unknown(ids: Sequence[str]) -> None:
    """Raise `InputError` if any of these is no effect of the catalogue."""
    unknown = [id for id in ids if id not in CATALOGUE]
    if unknown:
        raise InputError(
            Problem("--without", f"there is no effect '{id}'", hint=nearest_name(id, tuple(CATALOGUE)))
            for id in unknown
        )


def effect_meanings() -> dict[str, str]:
    """Say of every effect that a diagnosis looks for, by its id, what it means in the laboratory."""
    return {id: entry.meaning for id, entry in CATALOGUE.items()}


def effects_in(entries: Sequence[Effect | NotTestable]) -> tuple[Effect, ...]:
    """Keep what is testable."""
    return tuple(entry for entry in entries if isinstance(entry, Effect))
