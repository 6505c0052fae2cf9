"""What calibrations may change of cylinders, whatever the source of the paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wrapjax.geometry.surfaces import NOMINAL, WRAP_PARAMETERS
from wrapjax.geometry.wrap_boxes import box
from wrapjax.model import FreedWraps

_UNITS = ("m", "m", "m", "rad", "rad", "1")
#: Which cylinders PGA frees: those that some muscle lies on in at least one recorded frame, or all.
SURFACES = ("touched", "all")
#: What is said where there are none.
NO_CYLINDER = {
    "touched": "no driven muscle touches a cylinder in the recorded cycles: PGA frees nothing",
    "all": "no driven muscle has a cylinder that could be moved: PGA frees nothing",
}
# Prior deviations, in half widths: the box says where cylinders can be, the prior only breaks ties.
_PRIOR = 2.0


def freed_wraps(wraps_of: Sequence[Sequence[str]], translations: Mapping[str, float]) -> FreedWraps:
    """Free cylinders within their boxes; what is expected is nominal, within a box's width.

    Parameters
    ----------
    wraps_of
        The cylinders of each muscle, in the order of its path.
    translations
        Half width of the box of each freed cylinder, m.
    """
    names = tuple(translations)
    places = np.full((len(wraps_of), max(map(len, wraps_of), default=0)), -1)
    for row, wraps in enumerate(wraps_of):
        for place, wrap in enumerate(wraps):
            if wrap in names:
                places[row, place] = names.index(wrap)
    boxes = np.reshape([box(translations[name]) for name in names], (-1, 2, len(NOMINAL)))
    lower, upper = boxes[:, 0] - NOMINAL, boxes[:, 1] - NOMINAL
    half = 0.5 * (upper - lower)
    return FreedWraps(
        names=names,
        quantities=WRAP_PARAMETERS,
        units=_UNITS,
        places=places,
        lower=lower,
        upper=upper,
        scale=half,
        prior_sd=_PRIOR * half,
    )
