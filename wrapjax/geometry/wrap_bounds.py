"""How far a cylinder may be moved, turned and scaled.

The paper's own bounds of translation (its Table S8) are not public. Here a surface may move by 1 cm along
each axis, less where that leaves under half of all placements in the box usable, and more where over nine
tenths are: a placement is usable if no path jumps, in any of the poses, that does not jump in the nominal
model, and none loses a cylinder. Where even the narrowest box is not half usable it is taken all the same:
narrower ones help little, as it is turns and radii that put path points inside.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import qmc

from wrapjax.geometry.engine import ExactPaths, PosedPath, nominal_parameters, wrap_at_samples

#: Turns about x and y (rad), to either side: the paper's.
LARGEST_TURN = np.radians(20.0)
#: Smallest and largest radius in nominal ones: the paper's.
RADIUS_FACTORS = (0.8, 1.2)
#: Half widths of translation that are tried, m: narrower ones, from the usual one on, and wider ones.
USUAL_TRANSLATION = 0.01
NARROWER, WIDER = (USUAL_TRANSLATION, 0.0075, 0.005), (0.015, 0.02)
#: Shares of usable placements between which a box is kept.
LEAST_USABLE, MOST_USABLE = 0.5, 0.9
_SAMPLES = 96


def hammersley(count: int, skipped: int = 0) -> Float[np.ndarray, "sample wrap_parameter"]:
    """Spread points evenly over the unit box of six wrap parameters (Hammersley's set).

    The first coordinate counts, the others are van der Corput's in the first prime bases. With as many
    of those skipped as another set has, the points are other ones.
    """
    sequence = qmc.Halton(d=5, scramble=False)
    if skipped:
        sequence.fast_forward(skipped)
    halton = sequence.random(count)
    return np.column_stack([(np.arange(count) + 0.5) / count, halton])


def box(
    translation: float,
) -> tuple[Float[np.ndarray, " wrap_parameter"], Float[np.ndarray, " wrap_parameter"]]:
    """Give the lower and upper ends of a box of wrap parameters, by half its width along each axis (m)."""
    lower = np.array([*[-translation] * 3, -LARGEST_TURN, -LARGEST_TURN, RADIUS_FACTORS[0]])
    upper = np.array([*[translation] * 3, LARGEST_TURN, LARGEST_TURN, RADIUS_FACTORS[1]])
    return lower, upper


def translation_bounds(
    engine: ExactPaths, posed: dict[str, PosedPath], wraps: Sequence[str]
) -> dict[str, float]:
    """Find how far each cylinder may be moved along each of its axes, to either side (m).

    Parameters
    ----------
    posed
        The engine's paths in the poses that matter.
    wraps
        Names of cylinders.
    """
    return {name: _translation_bound(engine, posed, name) for name in wraps}


def _translation_bound(engine: ExactPaths, posed: dict[str, PosedPath], wrap: str) -> float:
    def share(translation: float) -> float:
        lower, upper = box(translation)
        samples = lower + (upper - lower) * hammersley(_SAMPLES)
        return float(usable_by_all(engine, posed, wrap, samples).mean())

    if share(NARROWER[0]) > MOST_USABLE:
        # The first that is no longer too easy, as long as it is usable.
        last = NARROWER[0]
        for translation in WIDER:
            found = share(translation)
            if found < LEAST_USABLE:
                break
            last = translation
            if found <= MOST_USABLE:
                break
        return last
    return next((one for one in NARROWER[:-1] if share(one) >= LEAST_USABLE), NARROWER[-1])


def usable_by_all(
    engine: ExactPaths,
    posed: dict[str, PosedPath],
    wrap: str,
    samples: Float[np.ndarray, "sample wrap_parameter"],
) -> Bool[np.ndarray, " sample"]:
    """Tell placements of a cylinder that are usable for every muscle that wraps round it."""
    usable = np.ones(len(samples), dtype=bool)
    for muscle in engine.muscles:
        wraps = engine.wraps_of(muscle)
        if wrap in wraps:
            usable &= usable_samples(posed[muscle], wraps.index(wrap), samples)
    return usable


def usable_samples(
    posed: PosedPath, place: int, samples: Float[np.ndarray, "sample wrap_parameter"]
) -> Bool[np.ndarray, " sample"]:
    """Tell placements of one cylinder for which a path behaves as with the nominal one.

    In no pose does it come to lie where its length jumps, unless it does in that pose anyway; and it
    touches the cylinder in some pose, if it does so anyway.

    Parameters
    ----------
    place
        Which of the path's cylinders is moved; the others stay where they are.
    """
    nominal = nominal_parameters(posed.surfaces.radius.shape[0])
    moved = np.tile(nominal, (len(samples), 1, 1))
    moved[:, place] = samples
    found, before = wrap_at_samples(posed, moved), wrap_at_samples(posed, nominal[None])
    jumps = np.zeros(len(samples), dtype=bool)
    for name in ("inside", "off_end", "long_wrap"):
        own, usual = getattr(found.margins, name), getattr(before.margins, name)
        jumps |= ((own < 0.0) & (usual >= 0.0)).any(axis=1)
    touched = before.touching[0, :, place].any()
    return ~jumps & (found.touching[:, :, place].any(axis=1) | ~touched)
