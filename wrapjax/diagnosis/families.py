"""Families of effects: what is named where a recording shows a kind of cause, but not which cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Family:
    """Family of effects: identifier, meaning in words, and identifiers of its effects."""

    id: str
    meaning: str
    members: tuple[str, ...]


#: Families, in the order in which recordings are turned into joint moments. Every effect that can be named is
#: in one of them.
FAMILIES: tuple[Family, ...] = (
    Family(
        "emg",
        "the recorded EMG",
        (
            "emg_drift",
            "emg_offset",
            "emg_crosstalk",
            "posture_dependent_gain",
        ),
    ),
    Family(
        "control",
        "how the person excites muscles",
        ("missing_drive", "spasticity_unrecorded", "spasticity_recorded", "speed_dependent_delay"),
    ),
    Family(
        "activation_and_muscle",
        "activation and fibers of the muscles",
        (
            "emg_nonlinearity",
            "deactivation_asymmetry",
            "slow_fibers",
            "activation_dependent_fiber_length",
            "force_enhancement",
            "short_range_stiffness",
            "bound_pressure",
        ),
    ),
    Family("tendon", "tendons and connections between muscles", ("tendon_compliance", "force_sharing")),
    Family(
        "passive",
        "passive tissue",
        ("contracture", "passive_joint_moment", "joint_damping", "biarticular_spring", "knee_laxity"),
    ),
    Family("geometry", "paths of the muscles", ("wrap_surface", "muscle_attachment")),
    Family(
        "measured_motion",
        "the recorded motion and the joints of the model",
        (
            "soft_tissue_artifact",
            "foot_deformation",
            "event_jitter",
            "hip_center_offset",
            "joint_axis_rotation",
        ),
    ),
    Family(
        "measured_force",
        "the recorded forces and the masses of inverse dynamics",
        (
            "cop_offset",
            "force_latency",
            "crossed_plates",
            "belt_acceleration",
            "handrail_force",
            "segment_inertia",
            "wobbling_mass",
        ),
    ),
    Family("device", "a device that the person wears", ("ankle_foot_orthosis", "device_torque")),
)


def family_of(effect: str) -> Family:
    """Find the family of an effect by its identifier.

    Raises
    ------
    KeyError
        If the effect is in no family.
    """
    for family in FAMILIES:
        if effect in family.members:
            return family
    raise KeyError(effect)


def family_by_id(id: str) -> Family:
    """Find a family by its identifier."""
    return next(family for family in FAMILIES if family.id == id)


def family_probabilities(effects: Mapping[str, float]) -> dict[str, float]:
    """Sum the probabilities of the effects of each family; families without a testable effect are omitted."""
    total: dict[str, float] = {}
    for id, probability in effects.items():
        family = family_of(id).id
        total[family] = total.get(family, 0.0) + probability
    return total


def same_family(effects: Sequence[str]) -> bool:
    """Return whether all effects are of one family."""
    return len({family_of(id).id for id in effects}) == 1
