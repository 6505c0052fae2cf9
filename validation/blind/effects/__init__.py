"""Every cause that a case can have, by the catalogue's names."""

from validation.blind.effects import chain, drive, fiber, joint
from validation.blind.effects.effect import Effect as Effect
from validation.blind.effects.effect import Variant as Variant

EFFECTS: dict[str, Effect] = {
    effect.id: effect for module in (fiber, drive, joint, chain) for effect in module.EFFECTS
}

#: Catalogued, and in no case: why.
LEFT_OUT = {
    "curve_family": "nuisance: every case has other curves than the diagnosis; never an answer",
    "activation_family": "nuisance: every case has other activation dynamics; never an answer",
    "emg_smoothing": "nuisance: every case's envelopes are filtered; never an answer",
    "short_range_stiffness": "negative control: nothing in steady walking",
    "handrail_force": "negative control; the folder has no rail",
    "spasticity_recorded": "negative control: the recorded EMG holds it already",
    "device_torque": "the folder has no device log",
    "belt_acceleration": "the folder has no belt",
    "knee_laxity": "the knee has one degree of freedom",
}
