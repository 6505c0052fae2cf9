"""The catalogue: every effect by its id, and which of them a subject's recording can show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.gap.context import Context
from wrapjax.gap.effect import Effect, NotTestable
from wrapjax.gap.effects import (
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

#: What gives an effect for a subject, by id. Effects that are composed act in this order.
CATALOGUE: dict[str, Callable[[Context], Effect | NotTestable]] = {
    "tendon_compliance": tendon.tendon_compliance,
    "slow_fibers": fiber.slow_fibers,
    "activation_dependent_fiber_length": fiber.activation_dependent_fiber_length,
    "curve_family": fiber.curve_family,
    "force_enhancement": fiber.force_enhancement,
    "short_range_stiffness": fiber.short_range_stiffness,
    "force_sharing": tendon.force_sharing,
    "contracture": fiber.contracture,
    "passive_joint_moment": joint.passive_joint_moment,
    "joint_damping": joint.joint_damping,
    "biarticular_spring": joint.biarticular_spring,
    "ankle_foot_orthosis": joint.ankle_foot_orthosis,
    "missing_drive": drive.missing_drive,
    "speed_dependent_delay": emg.speed_dependent_delay,
    "emg_drift": emg.emg_drift,
    "emg_smoothing": emg.emg_smoothing,
    "emg_crosstalk": emg.emg_crosstalk,
    "activation_family": activation.activation_family,
    "emg_nonlinearity": activation.emg_nonlinearity,
    "posture_dependent_gain": emg.posture_dependent_gain,
    "emg_offset": emg.emg_offset,
    "spasticity_unrecorded": drive.spasticity_unrecorded,
    "spasticity_recorded": drive.spasticity_recorded,
    "deactivation_asymmetry": activation.deactivation_asymmetry,
    "soft_tissue_artifact": kinematics.soft_tissue_artifact,
    "event_jitter": kinematics.event_jitter,
    "wrap_surface": geometry.wrap_surface,
    "muscle_attachment": geometry.muscle_attachment,
    "bound_pressure": bounds.bound_pressure,
    **measurement.FACTORIES,
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
    return tuple(factory(context) for id, factory in CATALOGUE.items() if id not in without)


def refuse_unknown(ids: Sequence[str]) -> None:
    """Raise `InputError` if any of these is no effect of the catalogue."""
    unknown = [id for id in ids if id not in CATALOGUE]
    if unknown:
        raise InputError(
            Problem("--without", f"there is no effect '{id}'", hint=nearest_name(id, tuple(CATALOGUE)))
            for id in unknown
        )


def effects_in(entries: Sequence[Effect | NotTestable]) -> tuple[Effect, ...]:
    """Keep what is testable."""
    return tuple(entry for entry in entries if isinstance(entry, Effect))
