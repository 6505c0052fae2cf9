"""Effects of errors of the scaled model's segments in inverse dynamics: mass, inertia, soft tissue."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.effects.definition import EffectDefinition
from wrapjax.diagnosis.effects.effect import EffectParameter
from wrapjax.diagnosis.effects.experiments import KNOWN_MASS_AT_SHANK
from wrapjax.diagnosis.inputs.recorded_movement import MomentDerivatives, RecordedMovement

# ---- Segment inertia

_SEGMENTS = ("thigh", "shank", "foot")


def _moments_by_inertia(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute the moments of a segment's mass, and of its inertia about the center of mass.

    A positive effect size is a person whose segment has more than the model's: the measured moments lack it.
    """
    derivatives = [
        movement.mechanics.moments(
            np.einsum("kb,bwp->kwp", movement.mechanics.moves[:, segment], wrench[segment])
        )
        for segment in _bodies_of_segments(movement)
        for wrench in (movement.mechanics.mass_wrench, movement.mechanics.inertia_wrench)
    ]
    return {"": -np.stack(derivatives)}


def _bodies_of_segments(movement: RecordedMovement) -> tuple[list[int], list[int], list[int]]:
    """Find the bodies of `_SEGMENTS` by the joints that move them; a patella is in none."""
    mechanics = movement.mechanics

    def first_moved(stem: str) -> list[int]:
        """Find the bodies at the near end of what a coordinate moves."""
        rows = movement.rows_of(stem)
        moved: list[int] = np.flatnonzero(mechanics.moves[rows[0]]).tolist() if rows else []
        names = [mechanics.bodies[body] for body in moved]
        return [body for body in moved if mechanics.parents[body] not in names]

    thigh, shank = first_moved("hip_"), first_moved("knee_")
    ankle = movement.rows_of("ankle_")
    foot = np.flatnonzero(mechanics.moves[ankle[0]]).tolist() if ankle else []
    return thigh, shank, foot


SEGMENT_INERTIA = EffectDefinition(
    id="segment_inertia",
    meaning="thigh, shank or foot are heavier or lighter than in the model",
    family="measured_force",
    parameters=tuple(
        EffectParameter(
            name=f"{quantity}_fraction_{segment}",
            unit="1",
            prior_sd=0.15,
            sign=0,
            meaning=f"{quantity} of the {segment} that the model lacks, as a fraction of the model's",
            source="10 to 20 % of anthropometric tables; usual: differences between tables, Rao et al. 2006, "
            "doi:10.1016/j.jbiomech.2005.04.014",
            limit=0.6,
            part=quantity,
            usual_sd=0.1,
        )
        for segment in _SEGMENTS
        for quantity in ("mass", "inertia")
    ),
    moment_derivatives=_moments_by_inertia,
    experiment=KNOWN_MASS_AT_SHANK,
)


# ---- Wobbling mass

#: Share of the gait cycle in which soft tissue comes to rest after impact.
_IMPACT = 0.1
_WOBBLING_SOURCE = (
    "0 to 10 % of the cycle; usual: about 4 N m at the peak (no published size), as filters that differ "
    "between forces and motion leave at impact, Bisseling and Hof 2006, PMID 16209869; Edwards et al. 2011, "
    "doi:10.1016/j.gaitpost.2011.06.006"
)
#: Standard deviation of the impulse of such artifacts in everybody, N m s.
_USUAL_IMPULSE = 0.25


def _moments_by_wobbling_mass(movement: RecordedMovement) -> dict[str, MomentDerivatives]:
    """Compute moments of soft tissue about hip flexion and about the knee.

    At impact, or at every change of the vertical force; 1 N m s in total while the foot is being loaded. The
    times of impacts are known in gait alone.
    """
    in_contact = movement.in_contact.reshape(movement.time.shape)
    strikes = in_contact & ~np.roll(in_contact, 1, axis=1)
    # Without a strike, the cycle starts with one.
    start = np.where(strikes.any(axis=1), strikes.argmax(axis=1), 0)
    duration = movement.time[:, -1] - movement.time[:, 0]
    since = np.mod(movement.time - movement.time[np.arange(start.size), start][:, None], duration[:, None])
    length = _IMPACT * duration[:, None]
    pulse = np.where(since < length, 2.0 / length * np.sin(np.pi * since / length) ** 2, 0.0)
    vertical = movement.force[1].reshape(movement.time.shape)
    rate = np.gradient(vertical, axis=-1) / (movement.time[:, 1] - movement.time[:, 0])[:, None]
    largest = vertical.max(axis=1, keepdims=True)
    if not movement.is_gait:
        reference = movement.reference
        largest = reference.force[1].reshape(reference.time.shape).max(axis=1).mean()
    shapes = {"impact": movement.is_gait * pulse, "every change of load": rate / largest}
    return {label: _about_hip_and_knee(movement, shape) for label, shape in shapes.items()}


def _about_hip_and_knee(
    movement: RecordedMovement, moment: Float[np.ndarray, "trial frame"]
) -> MomentDerivatives:
    derivatives = movement.no_change(2)
    for number, stem in enumerate(("hip_flexion", "knee_angle")):
        derivatives[number, movement.rows_of(stem)] = moment.ravel()
    return derivatives


WOBBLING_MASS = EffectDefinition(
    id="wobbling_mass",
    meaning="soft tissue swings after the foot's impact",
    family="measured_force",
    parameters=(
        EffectParameter(
            name="hip_impulse",
            unit="N m s",
            prior_sd=0.5,
            sign=0,
            meaning="impulse of soft tissue at impact, about hip flexion",
            source=_WOBBLING_SOURCE,
            limit=5.0,
            part="hip",
            usual_sd=_USUAL_IMPULSE,
        ),
        EffectParameter(
            name="knee_impulse",
            unit="N m s",
            prior_sd=0.5,
            sign=0,
            meaning="impulse of soft tissue at impact, about the knee",
            source=_WOBBLING_SOURCE,
            limit=5.0,
            part="knee",
            usual_sd=_USUAL_IMPULSE,
        ),
    ),
    moment_derivatives=_moments_by_wobbling_mass,
    experiment=KNOWN_MASS_AT_SHANK,
)
