"""Simulated effects by the ids of the catalogue."""

from validation.blind.effects import chain, drive, fiber, joint
from validation.blind.effects.effect import Effect as Effect
from validation.blind.effects.effect import Variant as Variant

EFFECTS: dict[str, Effect] = {
    effect.id: effect for module in (fiber, drive, joint, chain) for effect in module.EFFECTS
}

#: Catalogue entries that are not simulated, with the reason.
NOT_SIMULATED = {
    "curve_family": "nuisance: all cases have other muscle curves; never a correct answer",
    "activation_family": "nuisance: all cases have other activation dynamics; never a correct answer",
    "joint_center_spread": "nuisance: joint centers of all people differ; never a correct answer",
    "emg_smoothing": "nuisance: the envelopes of every case are filtered; never a correct answer",
    "short_range_stiffness": "negative control: no effect in steady walking",
    "handrail_force": "negative control: the folder has no data of a handrail",
    "spasticity_recorded": "negative control: the recorded EMG contains it",
    "device_torque": "the folder has no recording of a device",
    "belt_acceleration": "the folder has no belt speed",
    "knee_laxity": "the simulated knee has one degree of freedom",
}
