"""The catalogue of effects and their families, and which effects a subject's recording can show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from wrapjax.diagnosis.effects.activation import ACTIVATION_FAMILY, DEACTIVATION_ASYMMETRY, EMG_NONLINEARITY
from wrapjax.diagnosis.effects.calibration_bounds import BOUND_PRESSURE
from wrapjax.diagnosis.effects.definition import EffectDefinition
from wrapjax.diagnosis.effects.effect import FAMILIES, Effect, NotTestable
from wrapjax.diagnosis.effects.emg import (
    EMG_CROSSTALK,
    EMG_DRIFT,
    EMG_OFFSET,
    EMG_SMOOTHING,
    POSTURE_DEPENDENT_GAIN,
    SPEED_DEPENDENT_DELAY,
)
from wrapjax.diagnosis.effects.emg_channels import EMG_CHANNEL_LOSS, EMG_CHANNEL_SWAP
from wrapjax.diagnosis.effects.fiber import (
    ACTIVATION_DEPENDENT_FIBER_LENGTH,
    FORCE_ENHANCEMENT,
    SHORT_RANGE_STIFFNESS,
    SLOW_FIBERS,
)
from wrapjax.diagnosis.effects.force_curves import CONTRACTURE, CURVE_FAMILY
from wrapjax.diagnosis.effects.geometry import MUSCLE_ATTACHMENT, WRAP_SURFACE
from wrapjax.diagnosis.effects.joint import (
    ANKLE_FOOT_ORTHOSIS,
    BIARTICULAR_SPRING,
    JOINT_DAMPING,
    PASSIVE_JOINT_MOMENT,
)
from wrapjax.diagnosis.effects.measured_forces import (
    BELT_ACCELERATION,
    COP_OFFSET,
    CROSSED_PLATES,
    DEVICE_TORQUE,
    FORCE_LATENCY,
    HANDRAIL_FORCE,
)
from wrapjax.diagnosis.effects.measured_motion import EVENT_JITTER, FOOT_DEFORMATION, SOFT_TISSUE_ARTIFACT
from wrapjax.diagnosis.effects.scaled_model import (
    HIP_CENTER_OFFSET,
    JOINT_AXIS_ROTATION,
    JOINT_CENTER_SPREAD,
    KNEE_LAXITY,
)
from wrapjax.diagnosis.effects.segment_masses import SEGMENT_INERTIA, WOBBLING_MASS
from wrapjax.diagnosis.effects.tendon import FORCE_SHARING, TENDON_COMPLIANCE
from wrapjax.diagnosis.effects.unrecorded_excitation import (
    MISSING_DRIVE,
    SPASTICITY_RECORDED,
    SPASTICITY_UNRECORDED,
)
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.errors import InputError, Problem, nearest_name

# Definitions of all effects. Several effects at once alter a stage of the model in this order.
_DEFINITIONS = (
    TENDON_COMPLIANCE,
    SLOW_FIBERS,
    ACTIVATION_DEPENDENT_FIBER_LENGTH,
    CURVE_FAMILY,
    FORCE_ENHANCEMENT,
    SHORT_RANGE_STIFFNESS,
    FORCE_SHARING,
    CONTRACTURE,
    PASSIVE_JOINT_MOMENT,
    JOINT_DAMPING,
    BIARTICULAR_SPRING,
    ANKLE_FOOT_ORTHOSIS,
    MISSING_DRIVE,
    SPEED_DEPENDENT_DELAY,
    EMG_CHANNEL_SWAP,
    EMG_CHANNEL_LOSS,
    EMG_DRIFT,
    EMG_SMOOTHING,
    EMG_CROSSTALK,
    ACTIVATION_FAMILY,
    EMG_NONLINEARITY,
    POSTURE_DEPENDENT_GAIN,
    EMG_OFFSET,
    SPASTICITY_UNRECORDED,
    SPASTICITY_RECORDED,
    DEACTIVATION_ASYMMETRY,
    SOFT_TISSUE_ARTIFACT,
    EVENT_JITTER,
    WRAP_SURFACE,
    MUSCLE_ATTACHMENT,
    BOUND_PRESSURE,
    COP_OFFSET,
    HIP_CENTER_OFFSET,
    JOINT_AXIS_ROTATION,
    FORCE_LATENCY,
    SEGMENT_INERTIA,
    CROSSED_PLATES,
    BELT_ACCELERATION,
    HANDRAIL_FORCE,
    FOOT_DEFORMATION,
    WOBBLING_MASS,
    DEVICE_TORQUE,
    KNEE_LAXITY,
    JOINT_CENTER_SPREAD,
)
#: Definitions of all effects by identifier, in this order; `register_effect` adds to them.
CATALOGUE: dict[str, EffectDefinition] = {definition.id: definition for definition in _DEFINITIONS}
# Identifiers that mean something else in a result.
_RESERVED = ("none", "unknown", "none_of_these")


def register_effect(definition: EffectDefinition) -> None:
    """Add an effect of one's own to the catalogue, so that every later diagnosis of this process tests it.

    Results and reports find an effect's meaning and family by its identifier. Commands run in a process of
    their own and do not know the effect. The constants of the decision were fitted without it.

    Parameters
    ----------
    definition
        Definition of the effect. It replaces one of the same identifier that was registered before.

    Raises
    ------
    ValueError
        If the identifier is no Python identifier, or that of an effect of this package; or if there is no
        such family.
    """
    id = definition.id
    if not id.isidentifier() or id in _RESERVED or id in {one.id for one in _DEFINITIONS}:
        raise ValueError(f"'{id}' cannot name an effect of one's own: it is taken, or no identifier")
    if definition.family not in FAMILIES:
        raise ValueError(f"{id}: there is no family '{definition.family}'; there are {', '.join(FAMILIES)}")
    CATALOGUE[id] = definition


def catalogue(context: Context, without: Sequence[str] = ()) -> tuple[Effect | NotTestable, ...]:
    """Build every effect for a subject, or give the reason why its recording cannot show it.

    Parameters
    ----------
    context
        Subject and its cycles.
    without
        Identifiers of effects to leave out.

    Raises
    ------
    InputError
        If an effect to be left out is not in the catalogue.
    """
    refuse_unknown(without)
    return tuple(one.build(context) for id, one in CATALOGUE.items() if id not in without)


def refuse_unknown(ids: Sequence[str]) -> None:
    """Raise `InputError` if an identifier is not in the catalogue."""
    unknown = [id for id in ids if id not in CATALOGUE]
    if unknown:
        raise InputError(
            Problem("--without", f"there is no effect '{id}'", hint=nearest_name(id, tuple(CATALOGUE)))
            for id in unknown
        )


def effect_meanings() -> dict[str, str]:
    """Give the meaning of every effect that a diagnosis tests.

    Returns
    -------
    dict
        What differs in the person or the recording, a clause, by identifier of the effect.
    """
    return {definition.id: definition.meaning for definition in CATALOGUE.values()}


def available_effects(entries: Sequence[Effect | NotTestable]) -> tuple[Effect, ...]:
    """Select the effects of a catalogue that the subject's recording can show."""
    return tuple(entry for entry in entries if isinstance(entry, Effect))


def family_of(effect: str) -> str:
    """Return the identifier of an effect's family.

    Raises
    ------
    KeyError
        If there is no such effect.
    """
    return CATALOGUE[effect].family


def family_members(family: str) -> tuple[str, ...]:
    """List the effects of a family that can be named, in the order of the catalogue.

    Raises
    ------
    KeyError
        If there is no such family.
    """
    if family not in FAMILIES:
        raise KeyError(family)
    return tuple(id for id, one in CATALOGUE.items() if one.family == family and not one.nuisance)


def family_probabilities(effects: Mapping[str, float]) -> dict[str, float]:
    """Sum the probabilities of the effects of each family; families without a testable effect are omitted."""
    total: dict[str, float] = {}
    for id, probability in effects.items():
        family = family_of(id)
        total[family] = total.get(family, 0.0) + probability
    return total


def same_family(effects: Sequence[str]) -> bool:
    """Return whether all effects are of one family."""
    return len({family_of(id) for id in effects}) == 1
