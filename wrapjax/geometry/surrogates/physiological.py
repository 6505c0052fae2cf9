"""Criteria by which wrap parameters give a physiological muscle path.

Ao, Fregly et al. name three criteria: deviation, variability and smoothness. Their definitions (Table S6) are
not public; those used here are our own. Two criteria are added that need the exact engine: a path must have
no discontinuity of length that the nominal path does not have, and must touch every wrap that the nominal
path touches. Where surfaces of bones are given, a wrap must also stay near the bones of its body.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.exact_paths.wrapping import Surface, WrappedPath
from wrapjax.geometry.surfaces.wrap_methods import CYLINDER, clearance
from wrapjax.geometry.vectors import safe_sqrt, vector

# Added (m) to both standard deviations of a ratio, because the ratio of two very small ones is meaningless.
_DEVIATION_OFFSET = 1e-3


@dataclass(frozen=True)
class PhysiologicalThresholds:
    """Largest differences from the nominal path for a path to count as physiological.

    The defaults are above the 99th percentile of paths of the model s1_left that neither jump nor lose
    contact (except for moment arms of the iliacus), and below the values of paths that jump.

    Parameters
    ----------
    length_deviation
        Change of length in any pose, m.
    moment_arm_deviation
        Change of a moment arm in any pose and about any coordinate, m.
    variability
        Ratio, or its inverse if larger, of the standard deviations over poses of length or any moment arm.
    length_step
        Change of the difference from the nominal length between consecutive frames of a recorded cycle, m.
    moment_arm_step
        Change of the difference from any nominal moment arm between consecutive frames, m.
    new_contact
        Share of the poses in which a path touches a wrap that the nominal path touches in no pose; by default
        paths may begin to touch any wrap of theirs.
    bone_distance
        Increase of a wrap's distance from the nearest bone of its body over that of the nominal wrap, m; it
        counts where surfaces of bones are given, see `distance_from_bones`.
    """

    length_deviation: float = 0.025
    moment_arm_deviation: float = 0.020
    variability: float = 3.0
    length_step: float = 0.001
    moment_arm_step: float = 0.003
    new_contact: float = 1.0
    bone_distance: float = 0.005


DEFAULT_THRESHOLDS = PhysiologicalThresholds()


@dataclass(frozen=True)
class PathMeasures:
    """Differences of samples of a path from the nominal path, to compare with `PhysiologicalThresholds`.

    Fields with the names of thresholds are the largest values over poses and coordinates.

    Parameters
    ----------
    jumps
        Whether the sample, but not the nominal path, is beyond a discontinuity of length in some pose: a path
        point inside the cylinder, contact off its end, or more than half a turn.
    never_touches
        Whether the sample touches in no pose a wrap that the nominal path touches.
    """

    length_deviation: Float[np.ndarray, " sample"]
    moment_arm_deviation: Float[np.ndarray, " sample"]
    variability: Float[np.ndarray, " sample"]
    length_step: Float[np.ndarray, " sample"]
    moment_arm_step: Float[np.ndarray, " sample"]
    new_contact: Float[np.ndarray, " sample"]
    jumps: Bool[np.ndarray, " sample"]
    never_touches: Bool[np.ndarray, " sample"]

    def failed_criteria(
        self, thresholds: PhysiologicalThresholds = DEFAULT_THRESHOLDS
    ) -> dict[str, Bool[np.ndarray, " sample"]]:
        """Identify the samples that fail each criterion, by the criterion's name."""
        measured = {field.name for field in fields(self)}
        limited = {
            name: getattr(self, name) > limit for name, limit in vars(thresholds).items() if name in measured
        }
        return {"jumps": self.jumps, "never_touches": self.never_touches, **limited}

    def physiological(
        self, thresholds: PhysiologicalThresholds = DEFAULT_THRESHOLDS
    ) -> Bool[np.ndarray, " sample"]:
        """Identify the samples that fail no criterion."""
        return ~np.any(list(self.failed_criteria(thresholds).values()), axis=0)


def measure_paths(found: WrappedPath, nominal: WrappedPath, cycle: slice) -> PathMeasures:
    """Compare samples of a path with the nominal path.

    Parameters
    ----------
    found
        Samples of the path from `wrap_at_samples`: NumPy arrays whose first axes are ``sample pose``.
    nominal
        The nominal path as a single sample, in the same poses.
    cycle
        Poses that are the frames of one recorded cycle in order, without its repeated last frame.
    """
    length, nominal_length = np.asarray(found.length), np.asarray(nominal.length)
    arm, nominal_arm = np.asarray(found.moment_arm), np.asarray(nominal.moment_arm)
    touching, nominal_touching = np.asarray(found.touching), np.asarray(nominal.touching)
    change, arm_change = length - nominal_length, arm - nominal_arm
    jumps = np.zeros(len(change), dtype=bool)
    for name in ("inside", "off_end", "long_wrap"):
        margin, nominal_margin = getattr(found.margins, name), getattr(nominal.margins, name)
        jumps |= np.asarray((margin < 0.0) & (nominal_margin >= 0.0)).any(axis=1)
    return PathMeasures(
        length_deviation=np.abs(change).max(axis=1),
        moment_arm_deviation=np.abs(arm_change).max(axis=(1, 2), initial=0.0),
        variability=np.maximum(
            _ratio(length.std(axis=1), nominal_length.std(axis=1)),
            _ratio(arm.std(axis=1), nominal_arm.std(axis=1)).max(axis=1, initial=1.0),
        ),
        length_step=np.abs(_steps(change[:, cycle])).max(axis=1, initial=0.0),
        moment_arm_step=np.abs(_steps(arm_change[:, cycle])).max(axis=(1, 2), initial=0.0),
        new_contact=np.mean(touching & ~np.any(nominal_touching, axis=1)[:, None], axis=1).max(
            axis=1, initial=0.0
        ),
        jumps=jumps,
        never_touches=np.any(np.any(nominal_touching, axis=1) & ~np.any(touching, axis=1), axis=1),
    )


def distance_from_bones(
    wrap: Surface,
    kind: str,
    bones: Float[np.ndarray, "vertex 3"],
    parameters: Float[np.ndarray, "sample wrap_parameter"],
) -> Float[np.ndarray, " sample"]:
    """Compute the distance between a displaced wrap surface and the nearest vertex of a bone.

    Parameters
    ----------
    wrap
        Nominal surface, without further axes.
    kind
        Its kind; see `wrapjax.geometry.surfaces.wrap_methods.kind_of`.
    bones
        Vertices of the bones of the body that carries the surface, in that body's frame, m.
    parameters
        Samples of the wrap parameters.

    Returns
    -------
    distance
        m; zero where a vertex is inside the surface. That of a cylinder is to the part between its ends; that
        of an ellipsoid is measured towards its center.
    """
    points = vector(jnp.asarray(bones))

    def nearest(sample: Float[Array, " wrap_parameter"]) -> Float[Array, ""]:
        surface = wrap.placed(sample)
        own = surface.to_surface_frame(points)
        outside = jnp.maximum(clearance(own, surface, kind), 0.0)
        if kind == CYLINDER:
            beyond_end = jnp.maximum(jnp.abs(own.z) - surface.half_length, 0.0)
            outside = safe_sqrt(outside**2 + beyond_end**2)
        return outside.min()

    return np.asarray(jax.jit(lambda samples: jax.lax.map(nearest, samples))(jnp.asarray(parameters)))


def _steps(values: Float[np.ndarray, "sample frame *coordinate"]) -> Float[np.ndarray, "..."]:
    """Differences between consecutive frames, and from the last frame to the first."""
    return np.roll(values, -1, axis=1) - values


def _ratio(one: Float[np.ndarray, "..."], other: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Ratio of two standard deviations, or its inverse if that is larger."""
    ratio = (one + _DEVIATION_OFFSET) / (other + _DEVIATION_OFFSET)
    return np.maximum(ratio, 1.0 / ratio)
