"""The measurement chain: what inverse dynamics were given, and so what they say was measured.

Data stay as they are; it is their prediction that changes. By how much, only inverse dynamics of the
whole leg can say: whoever builds a `Context` puts, under an effect's id, the exact change of the moments
with its amounts into ``measured_changes``, zero at zero. What is not there is not testable. Muscles took the
paths of the person's joints, not of those that the laboratory's model has: by how much those differ is in
``path_changes``, to first order.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.diagnosis.context import Context, MeasuredChange, change_id, known_shape
from wrapjax.diagnosis.effects.effect import Effect, EffectParameter, NotTestable, Variant
from wrapjax.diagnosis.effects.geometry import added_to_paths
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import Alteration

#: Name, unit, prior deviation, sign, meaning, limit.
_Row = tuple[str, str, float, int, str, float]

#: Effects on the measurement chain: parameters, and where their priors come from.
CHAIN: dict[str, tuple[str, tuple[_Row, ...]]] = {
    "cop_offset": (
        "plates in treadmills, PMC2665306",
        (
            ("anterior_m", "m", 0.010, 0, "centre of pressure recorded too far forward", 0.05),
            ("lateral_m", "m", 0.010, 0, "centre of pressure recorded too far outward", 0.05),
        ),
    ),
    "hip_center_offset": (
        "Stagni et al. 2000, doi:10.1016/S0021-9290(00)00093-2",
        (
            ("anterior_m", "m", 0.015, 0, "hip centre placed too far forward", 0.06),
            ("superior_m", "m", 0.015, 0, "hip centre placed too far up", 0.06),
            ("lateral_m", "m", 0.015, 0, "hip centre placed too far outward", 0.06),
        ),
    ),
    "joint_axis_rotation": (
        "5 to 15 degrees",
        (
            ("knee_rad", "rad", 0.12, 0, "knee axis turned outward in the horizontal plane", 0.5),
            ("knee_tilt_rad", "rad", 0.12, 0, "knee axis with its outer end too high", 0.5),
            ("ankle_rad", "rad", 0.12, 0, "ankle axis turned outward in the horizontal plane", 0.5),
            ("ankle_tilt_rad", "rad", 0.12, 0, "ankle axis with its outer end too high", 0.5),
            ("subtalar_rad", "rad", 0.12, 0, "subtalar axis turned outward in the horizontal plane", 0.5),
            ("subtalar_pitch_rad", "rad", 0.12, 0, "subtalar axis with its front end too high", 0.5),
        ),
    ),
    "force_latency": (
        "10 to 15 ms",
        (("latency", "s", 0.010, 0, "forces recorded later than motion", 0.05),),
    ),
    "segment_inertia": (
        "10 to 20 % of anthropometric tables",
        tuple(
            (
                f"{quantity}_fraction_{segment}",
                "1",
                0.15,
                0,
                f"{quantity} of the {segment}: by what fraction of the model's the person's is larger",
                0.6,
            )
            for segment in ("thigh", "shank", "foot")
            for quantity in ("mass", "inertia")
        ),
    ),
    "crossed_plates": (
        "0 to 20 % of a foot's force",
        (
            ("other_share", "1", 0.10, 0, "share of the other foot's force, where that foot is", 0.5),
            ("leaked_share", "1", 0.10, 0, "share of the other foot's force, taken to act on this one", 0.5),
            ("own_share", "1", 0.10, 0, "share of this foot's own force in double support", 0.5),
        ),
    ),
    "belt_acceleration": (
        "Hnat & van den Bogert 2014, 12 N m RMS",
        (("moment_scale", "1", 0.5, 0, "plate's pitching moment that was not taken off", 2.0),),
    ),
    "handrail_force": (
        "negative control: inverse dynamics from the ground up do not see it",
        (("share", "1", 0.5, 1, "share of the rail's force", 2.0),),
    ),
    "foot_deformation": (
        "ankle angles off by up to 7.3 degrees, PMC8085108",
        (
            (
                "bend",
                "rad",
                0.06,
                0,
                "ankle recorded too far in dorsiflexion where the foot is loaded most",
                0.3,
            ),
        ),
    ),
    "wobbling_mass": (
        "0 to 10 % of the cycle",
        (
            ("hip_impulse", "N m s", 0.5, 0, "impulse of soft tissue at impact, about hip flexion", 5.0),
            ("knee_impulse", "N m s", 0.5, 0, "impulse of soft tissue at impact, about the knee", 5.0),
        ),
    ),
    "device_torque": (
        "the device's log",
        (("scale", "1", 0.5, 0, "share of the commanded torque that acts", 2.0),),
    ),
    "knee_laxity": (
        "varus and valgus under load",
        (("lever_m", "m", 0.01, 0, "change of the vertical force's lever about the hip and knee", 0.05),),
    ),
}
#: They act on nothing that these recordings hold, and must stay quiet.
_NEGATIVE_CONTROLS = ("handrail_force",)

#: What a recording would need beside ground reaction forces and never has.
_NEEDS = {
    "belt_acceleration": "no belt speed is recorded",
    "handrail_force": "no handrail force is recorded",
    "device_torque": "no torque of a device is recorded",
}


def of_chain(id: str) -> Callable[[Context], Effect | NotTestable]:
    """Give what says of a subject how an effect of `CHAIN` changes what is measured of it."""
    return partial(_of_chain, id)


def _of_chain(id: str, context: Context) -> Effect | NotTestable:
    changes = {
        shape: change
        for known, change in context.measured_changes.items()
        if (shape := known_shape(known, id)) is not None
    }
    if not changes:
        return NotTestable(id, _NEEDS.get(id, context.no_measured_changes))
    source, rows = CHAIN[id]
    return Effect(
        id=id,
        family="measurement",
        parameters=tuple(
            EffectParameter(name, unit, sd, sign, meaning, source, limit, part=name.split("_")[0])
            for name, unit, sd, sign, meaning, limit in rows
        ),
        variants=tuple(
            Variant(Partial(_added, change, _paths_of(id, shape, context)), shape)
            for shape, change in changes.items()
        ),
        negative_control=id in _NEGATIVE_CONTROLS,
    )


def _paths_of(id: str, shape: str, context: Context) -> PathState | None:
    """By how much paths differ: as this shape has it, or as all shapes do."""
    return context.path_changes.get(change_id(id, shape), context.path_changes.get(id))


def _added(
    change: MeasuredChange, slopes: PathState | None, effect_sizes: Float[Array, " parameter"]
) -> Alteration:
    if slopes is None:
        return Alteration(moment=change(effect_sizes))
    by_amounts = jax.tree.map(lambda leaf: jnp.einsum("p,mp...->m...", effect_sizes, leaf), slopes)
    return Alteration(moment=change(effect_sizes), paths=Partial(added_to_paths, by_amounts))
