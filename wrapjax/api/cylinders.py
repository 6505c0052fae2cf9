"""What calibrations may change of cylinders, whatever the source of the paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wrapjax.geometry.surfaces import NOMINAL, WRAP_PARAMETERS
from wrapjax.geometry.wrap_boxes import box
from wrapjax.model import FreedWraps

# Spread of the prior on wrap parameters, in half widths of their boxes: the box says what is possible, and
# the prior only that of two equally good cylinders the nearer one is likelier.
_PRIOR = 4.0
_UNITS = ("m", "m", "m", "rad", "rad", "1")


def freed_wraps(wraps_of: Sequence[Sequence[str]], translations: Mapping[str, float]) -> FreedWraps:
    """Free cylinders within their boxes.

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
