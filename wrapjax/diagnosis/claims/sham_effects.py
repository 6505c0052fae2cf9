"""Sham effects: signatures without a mechanism, with which the shrinkage by an effect is compared.

Any flexible signature reduces an error that repeats, on cycles that it has not seen as well. How far an
effect shrinks the error on unseen cycles therefore says little by itself. Sham effects have as many
parameters as the effect, and change the moments as much: smooth functions of angle, velocity and phase of one
coordinate, and smooth forces of one muscle.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.claims.residual_fit import ResidualModel, ScaledSignatures

#: Number of sham effects.
SHAMS = 60
# Harmonics of the gait cycle in a smooth force; random waves in a smooth function of angle, velocity, phase.
_HARMONICS, _WAVES = 4, 12


def sham_effects(
    parameters: int,
    angles: Float[np.ndarray, "cycle coordinate phase"],
    velocities: Float[np.ndarray, "cycle coordinate phase"],
    muscle_arms: Float[np.ndarray, "muscle cycle coordinate phase"],
    count: int = SHAMS,
    seed: int = 0,
) -> list[ScaledSignatures]:
    """Draw sham effects; half are functions of a coordinate, half are forces of a muscle.

    Parameters
    ----------
    parameters
        Number of parameters of each.
    angles, velocities
        Recorded angles (rad) and angular velocities (rad/s) of the coordinates.
    muscle_arms
        Moment by one unit of normalised force of each muscle, N m.
    count, seed
        Number of sham effects, and seed.

    Returns
    -------
    list
        Signatures of each, of any size.
    """
    generator = np.random.default_rng(seed)
    shams = []
    for number in range(count):
        draw = _of_coordinate if number % 2 else _of_muscle
        shams.append(np.stack([draw(generator, angles, velocities, muscle_arms) for _ in range(parameters)]))
    return shams


def scaled_like(
    sham: ScaledSignatures, signatures: ScaledSignatures, model: ResidualModel
) -> ScaledSignatures:
    """Scale a sham effect so that it changes the moments as much as the given signatures, in noise units."""
    own, wanted = (float(np.linalg.norm(model.whitened(one))) for one in (sham, signatures))
    return sham * (wanted / own if own > 0.0 else 0.0)


def _of_coordinate(generator, angles, velocities, muscle_arms) -> Float[np.ndarray, "cycle coordinate phase"]:
    """Draw a smooth function of angle, velocity and phase of one coordinate."""
    cycles, coordinates, phases = angles.shape
    place = int(generator.integers(coordinates))
    angle, velocity = (
        (values[:, place] - values[:, place].mean()) / max(float(values[:, place].std()), 1e-9)
        for values in (angles, velocities)
    )
    phase = 2.0 * np.pi * np.arange(phases) / phases
    total = np.zeros((cycles, phases))
    for _ in range(_WAVES):
        by_angle, by_velocity = generator.normal(0.0, 1.0, 2)
        harmonic = int(generator.integers(0, 3))
        shift, weight = generator.uniform(0.0, 2.0 * np.pi), generator.normal()
        total += weight * np.cos(by_angle * angle + by_velocity * velocity + harmonic * phase[None] + shift)
    signature = np.zeros(angles.shape)
    signature[:, place] = total
    return signature


def _of_muscle(generator, angles, velocities, muscle_arms) -> Float[np.ndarray, "cycle coordinate phase"]:
    """Draw a smooth periodic force of one muscle."""
    arms = muscle_arms[int(generator.integers(len(muscle_arms)))]
    phases = arms.shape[-1]
    phase = 2.0 * np.pi * np.arange(phases) / phases
    harmonics = np.arange(_HARMONICS + 1)[:, None]
    weights = generator.normal(size=(2, _HARMONICS + 1, 1)) / (1.0 + harmonics)
    force = np.sum(weights[0] * np.cos(harmonics * phase) + weights[1] * np.sin(harmonics * phase), axis=0)
    return np.asarray(arms * force)
