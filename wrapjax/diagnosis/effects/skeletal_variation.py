"""Spread of joint centers, joint axes and segment masses about the scaled model's, as nuisance parameters.

No scaled model has exactly the skeleton of the person. Inverse dynamics with it gives moments that differ
from the person's in every recording, by the same levers of the same forces in every cycle. Without these
differences in the null hypotheses, effects that move a joint or a force would be found in everybody. With
them, such an effect is named only where it is larger than the spread that studies found.
"""

from __future__ import annotations

import numpy as np

from wrapjax.diagnosis.effects.definition import EffectDefinition
from wrapjax.diagnosis.effects.effect import EffectParameter
from wrapjax.diagnosis.effects.scaled_model import (
    AXIS_ROTATIONS,
    moments_by_inertia,
    moments_by_joint_axes,
    moments_by_joint_center,
)
from wrapjax.diagnosis.recorded_inputs.recorded_gait import MomentDerivatives, RecordedGait

_LANDMARKS = (
    "anatomical landmarks between examiners: Della Croce et al. 2005, doi:10.1016/j.gaitpost.2004.05.003"
)
_HIP = "12 mm between regression and computed tomography: Mantovani et al. 2016, Gait & Posture 44:48-54"
_ANKLE_AXES = "39 and 23 degrees of range: Isman and Inman 1969, Bull. Prosthet. Res. 10-11:97-129"
_MASSES = "differences of anthropometric tables: Rao et al. 2006, doi:10.1016/j.jbiomech.2005.04.014"

#: Start of the coordinate's name of each joint, standard deviation of its center along each axis (m), source.
_CENTERS = (("hip_", 0.007, _HIP), ("knee_angle", 0.005, _LANDMARKS), ("ankle_angle", 0.003, _LANDMARKS))
#: Standard deviation of each rotation of `AXIS_ROTATIONS`, rad, and source.
_AXES = (
    (0.07, _LANDMARKS),
    (0.035, _LANDMARKS),
    (0.10, _ANKLE_AXES),
    (0.07, _ANKLE_AXES),
    (0.15, _ANKLE_AXES),
    (0.12, _ANKLE_AXES),
)
#: Standard deviation of the mass and of the moment of inertia of a segment, as a fraction.
_INERTIA_SD = 0.1
_DIRECTIONS = ("anterior", "superior", "lateral")


def _moments(gait: RecordedGait) -> dict[str, MomentDerivatives]:
    """Compute the change of the moments by each parameter, with the foot held in place by markers."""
    centers = [moments_by_joint_center(gait, stem) for stem, _, _ in _CENTERS]
    return {"": np.concatenate([*centers, moments_by_joint_axes(gait), moments_by_inertia(gait)])}


SKELETAL_VARIATION = EffectDefinition(
    id="skeletal_variation",
    meaning="joints and segment masses differ from the scaled model's by the usual spread between people",
    family="geometry",
    parameters=(
        *(
            EffectParameter(
                name=f"{stem.split('_')[0]}_{direction}_m",
                unit="m",
                prior_sd=sd,
                sign=0,
                meaning=f"{stem.split('_')[0]} center of the model too far {direction}",
                source=source,
            )
            for stem, sd, source in _CENTERS
            for direction in _DIRECTIONS
        ),
        *(
            EffectParameter(
                name=f"{stem.split('_')[0]}_axis_about_{'xyz'[axis]}_rad",
                unit="rad",
                prior_sd=sd,
                sign=0,
                meaning=f"axis of {stem} turned about {'xyz'[axis]} of the body that carries it",
                source=source,
            )
            for (stem, axis), (sd, source) in zip(AXIS_ROTATIONS, _AXES, strict=True)
        ),
        *(
            EffectParameter(
                name=f"{quantity}_fraction_{segment}",
                unit="1",
                prior_sd=_INERTIA_SD,
                sign=0,
                meaning=f"{quantity} of the {segment} that the model lacks, as a fraction of the model's",
                source=_MASSES,
            )
            for segment in ("thigh", "shank", "foot")
            for quantity in ("mass", "inertia")
        ),
    ),
    moment_derivatives=_moments,
    nuisance=True,
)
