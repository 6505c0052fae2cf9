"""Families of effects: what kind of thing differs from the model, where an effect alone cannot be told."""

from __future__ import annotations

#: What the effects of each family have in common, by identifier: a clause for reports, without a full stop.
FAMILIES: dict[str, str] = {
    "emg": "the recorded EMG differs from the excitation of the muscles",
    "activation_and_muscle": "muscles activate or make force in another way than the model's",
    "tendon": "tendons stretch, or pass force between muscles",
    "passive": "tissue resists motion without muscle activity",
    "geometry": "muscle paths, joint centers or joint axes lie elsewhere than in the model",
    "measured_motion": "the recorded motion is not that of the bones",
    "measured_force": "ground forces or segment masses in inverse dynamics are wrong",
    "device": "a device acts on the leg",
    "control": "the person activates muscles that were not recorded, or with another delay",
}
