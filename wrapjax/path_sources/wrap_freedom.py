"""Wraps that PGA frees, with the bounds and priors of their parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wrapjax.geometry.wrap_bounds import parameter_box
from wrapjax.geometry.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.model.freedom import FreedWraps

_UNITS = ("m", "m", "m", "rad", "rad", "1")
#: Choices of the wraps that PGA frees: those that some muscle touches in a recorded frame, or all.
SURFACES = ("touched", "all")
#: Error messages by this choice where there is no such wrap.
NO_WRAPS_TO_FREE = {
    "touched": "no driven muscle touches a cylinder in the recorded cycles: PGA frees nothing",
    "all": "no driven muscle has a cylinder that could be moved: PGA frees nothing",
}
# Prior standard deviation in half widths of the bounds: wide, because the bounds limit the parameters.
_PRIOR_WIDTH = 2.0


def freed_wraps(wraps_of: Sequence[Sequence[str]], translations: Mapping[str, float]) -> FreedWraps:
    """Free wraps within the bounds of their parameters (see `parameter_box`), with nominal prior means.

    Parameters
    ----------
    wraps_of
        Names of the wraps of each muscle, in the order of its path.
    translations
        Largest translation along each axis of each freed wrap, m.

    Returns
    -------
    FreedWraps
        Freed wraps, in the order of ``translations``.
    """
    names = tuple(translations)
    places = np.full((len(wraps_of), max(map(len, wraps_of), default=0)), -1)
    for row, wraps in enumerate(wraps_of):
        for place, wrap in enumerate(wraps):
            if wrap in names:
                places[row, place] = names.index(wrap)
    bounds = np.reshape([parameter_box(translations[name]) for name in names], (-1, 2, len(NOMINAL)))
    lower, upper = bounds[:, 0] - NOMINAL, bounds[:, 1] - NOMINAL
    half_width = 0.5 * (upper - lower)
    return FreedWraps(
        names=names,
        quantities=WRAP_PARAMETERS,
        units=_UNITS,
        places=places,
        lower=lower,
        upper=upper,
        scale=half_width,
        prior_sd=_PRIOR_WIDTH * half_width,
    )
