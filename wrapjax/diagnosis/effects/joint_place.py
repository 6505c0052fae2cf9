"""Priors of errors in the places of joints that were personalised from markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from wrapjax.diagnosis.effects.effect import EffectParameter
from wrapjax.subject.joint_spread import JointSpread

#: Largest plausible error of a personalised joint, in its standard deviations.
_LIMIT = 4.0


@dataclass(frozen=True)
class JointPlace:
    """Place of a joint in its parent body, to which a parameter is an error.

    Parameters
    ----------
    stem
        Start of the names of the joint's coordinates.
    quantity
        ``translation`` along, or ``orientation`` about, the axis.
    axis
        0, 1 or 2 for x, y or z of the parent body.
    """

    stem: str
    quantity: str
    axis: int


def narrowed(
    parameter: EffectParameter, place: JointPlace, spread: Mapping[str, JointSpread]
) -> EffectParameter:
    """Narrow a parameter's priors to what markers leave open of the joint's place.

    Parameters
    ----------
    parameter
        Parameter with the priors of a scaled model.
    place
        Place of the joint.
    spread
        Standard deviations of personalised joints, by coordinate.

    Returns
    -------
    EffectParameter
        Parameter with prior and usual standard deviation no larger than that of the joint's place, and limits
        of four of these; unchanged if the joint was not personalised, or is less certain than after scaling.
    """
    joint = next((joint for name, joint in spread.items() if name.startswith(place.stem)), None)
    sd = None if joint is None else getattr(joint, place.quantity)[place.axis]
    if sd is None or sd >= parameter.prior_sd:
        return parameter
    return replace(
        parameter,
        prior_sd=sd,
        usual_sd=min(parameter.usual_sd, sd),
        limit=min(parameter.limit, _LIMIT * sd),
        source=f"joint personalised from markers; of a scaled model: {parameter.source}",
    )
