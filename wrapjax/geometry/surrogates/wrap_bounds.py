"""Bounds of wrap parameters, and the exact criterion for parameters to be usable.

The bounds of translation of Ao, Fregly et al. (Table S8) are not public. Here a wrap may be translated by 1
cm along each axis; by less if under half of the samples in this box are usable, and by more if over nine
tenths are. Samples are usable if in no pose a path is beyond a discontinuity of length where the nominal path
is not, and if every path still touches the wrap in some pose. The narrowest box is used even if under half of
its samples are usable: narrower boxes help little, because path points get inside by rotations and larger
radii.

The bounds of rotations and of ``radius_factor``, which Ao, Fregly et al. published for cylinders, apply to
the parameters of the same names of all surfaces, and that of rotations to ``rotation_z_rad`` of ellipsoids.
No bounds are published for shapes of ellipsoids and tori. Factors of their second and third size are here
within half the range of ``radius_factor``, so that the surface keeps the shape that the model's authors chose
more closely than its size.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import qmc

from wrapjax.geometry.exact_paths.engine import ExactPaths, PosedPath, nominal_parameters, wrap_at_samples
from wrapjax.geometry.exact_paths.wrapping import (
    NOMINAL_PARAMETERS,
    PARAMETERS,
    PARAMETERS_OF,
    WRAP_PARAMETERS,
)

#: Largest rotation about x and y (rad) in either direction, after Ao, Fregly et al.
MAX_ROTATION = np.radians(20.0)
#: Smallest and largest radius as multiples of the nominal radius, after Ao, Fregly et al.
RADIUS_FACTORS = (0.8, 1.2)
#: Smallest and largest further factor of the second and third size.
SHAPE_FACTORS = (0.9, 1.1)
#: Largest translation along each axis (m) that is tried first.
USUAL_TRANSLATION = 0.01
#: Smaller bounds, from the usual one on, and larger bounds that are tried next (m).
NARROWER_TRANSLATIONS, WIDER_TRANSLATIONS = (USUAL_TRANSLATION, 0.0075, 0.005), (0.015, 0.02)
#: Shares of usable samples below and above which another bound is tried.
MIN_USABLE_SHARE, MAX_USABLE_SHARE = 0.5, 0.9
#: OpenSim's class of cylinders.
CYLINDER = "WrapCylinder"
# Places of moved samples and of the nominal path in one array.
_NOMINAL, _MOVED = slice(0, 1), slice(1, None)
# Samples by which the share is estimated.
_SAMPLES = 96


def hammersley(
    count: int, skipped: int = 0, dimensions: int = len(WRAP_PARAMETERS)
) -> Float[np.ndarray, "sample wrap_parameter"]:
    """Compute evenly distributed points of the unit cube of wrap parameters (Hammersley set).

    The first coordinate of point i is ``(i + 1/2) / count``; the others are van der Corput sequences in the
    first prime bases.

    Parameters
    ----------
    count
        Number of points.
    skipped
        Number of elements of the van der Corput sequences to skip, by which sets become different.
    dimensions
        Number of wrap parameters.
    """
    sequence = qmc.Halton(d=dimensions - 1, scramble=False)
    if skipped:
        sequence.fast_forward(skipped)
    halton = sequence.random(count)
    return np.column_stack([(np.arange(count) + 0.5) / count, halton])


def parameter_box(
    translation: float, wrap_class: str = CYLINDER, names: Sequence[str] = WRAP_PARAMETERS
) -> tuple[Float[np.ndarray, " wrap_parameter"], Float[np.ndarray, " wrap_parameter"]]:
    """Compute lower and upper bounds of wrap parameters.

    Parameters
    ----------
    translation
        Largest translation along each axis, m.
    wrap_class
        OpenSim's class of the surface.
    names
        Names of the parameters. Those on which paths do not depend (`PARAMETERS_OF`) are held: both of their
        bounds are the nominal value.
    """
    limits = {
        **dict.fromkeys(WRAP_PARAMETERS[:3], (-translation, translation)),
        **dict.fromkeys(
            ("rotation_x_rad", "rotation_y_rad", "rotation_z_rad"), (-MAX_ROTATION, MAX_ROTATION)
        ),
        "radius_factor": RADIUS_FACTORS,
        **dict.fromkeys(("second_size_factor", "third_size_factor"), SHAPE_FACTORS),
    }
    nominal = dict(zip(PARAMETERS, NOMINAL_PARAMETERS, strict=True))
    freed = PARAMETERS_OF[wrap_class]
    lower, upper = np.array([limits[name] if name in freed else (nominal[name],) * 2 for name in names]).T
    return lower, upper


def translation_bounds(
    engine: ExactPaths, posed: dict[str, PosedPath], wraps: Sequence[str]
) -> dict[str, float]:
    """Find the largest translation of each wrap along each of its axes (m).

    Parameters
    ----------
    engine
        Engine of the muscles.
    posed
        The engine's paths in the poses to consider.
    wraps
        Names of the wraps.
    """
    return {name: _translation_bound(engine, posed, name) for name in wraps}


def _translation_bound(engine: ExactPaths, posed: dict[str, PosedPath], wrap: str) -> float:
    wrap_class, names = engine.model.wrap(wrap).kind, engine.parameters

    def usable_share(translation: float) -> float:
        lower, upper = parameter_box(translation, wrap_class, names)
        samples = lower + (upper - lower) * hammersley(_SAMPLES, dimensions=len(names))
        return float(usable_for_all_muscles(engine, posed, wrap, samples).mean())

    if usable_share(NARROWER_TRANSLATIONS[0]) > MAX_USABLE_SHARE:
        # Widen until the share is no longer too high, unless it becomes too low.
        last = NARROWER_TRANSLATIONS[0]
        for translation in WIDER_TRANSLATIONS:
            share = usable_share(translation)
            if share < MIN_USABLE_SHARE:
                break
            last = translation
            if share <= MAX_USABLE_SHARE:
                break
        return last
    return next(
        (one for one in NARROWER_TRANSLATIONS[:-1] if usable_share(one) >= MIN_USABLE_SHARE),
        NARROWER_TRANSLATIONS[-1],
    )


def usable_for_all_muscles(
    engine: ExactPaths,
    posed: dict[str, PosedPath],
    wrap: str,
    samples: Float[np.ndarray, "sample wrap_parameter"],
) -> Bool[np.ndarray, " sample"]:
    """Identify parameters of a wrap that are usable for every muscle that wraps round it.

    Parameters
    ----------
    engine
        Engine of the muscles.
    posed
        The engine's paths in the poses to consider.
    wrap
        Name of the wrap.
    samples
        Parameters of the wrap.
    """
    usable = np.ones(len(samples), dtype=bool)
    for muscle in engine.muscles:
        wraps = engine.wraps_of(muscle)
        if wrap in wraps:
            usable &= usable_samples(posed[muscle], wraps.index(wrap), samples)
    return usable


def usable_samples(
    posed: PosedPath, place: int, samples: Float[np.ndarray, "sample wrap_parameter"]
) -> Bool[np.ndarray, " sample"]:
    """Identify parameters of one wrap for which a path is as regular as the nominal path.

    In no pose is the path beyond a discontinuity of its length, unless the nominal path is in that pose. It
    touches the wrap in some pose, if the nominal path does.

    Parameters
    ----------
    posed
        Path in the poses to consider.
    place
        Number of the wrap in the order of the path; the other wraps stay nominal.
    samples
        Parameters of the wrap.
    """
    nominal = nominal_parameters(posed.surfaces.radius.shape[0], samples.shape[1])
    moved = np.tile(nominal, (len(samples) + 1, 1, 1))
    moved[1:, place] = samples
    # In one array: another number of samples would require another compilation.
    both = wrap_at_samples(posed, moved)
    found, unchanged = (jax.tree.map(lambda leaf, part=part: leaf[part], both) for part in (_MOVED, _NOMINAL))
    jumps = np.zeros(len(samples), dtype=bool)
    for name in ("inside", "off_end", "long_wrap"):
        margin, nominal_margin = getattr(found.margins, name), getattr(unchanged.margins, name)
        jumps |= ((margin < 0.0) & (nominal_margin >= 0.0)).any(axis=1)
    touched = unchanged.touching[0, :, place].any()
    return ~jumps & (found.touching[:, :, place].any(axis=1) | ~touched)
