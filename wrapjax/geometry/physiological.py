"""Which placements of its cylinders leave a muscle path physiological.

The paper names three criteria, deviation, variability and smoothness; its definitions (its Table S6) are
not public, and these are ours. Beside them stand what only an engine can tell: a path whose length
jumps, and one that never touches a cylinder it lies on in the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.geometry.wrapping import WrappedPath

# Smaller deviations over poses (m) count as this: the ratio of two tiny ones says nothing.
_LEAST_DEVIATION = 1e-3


@dataclass(frozen=True)
class PhysiologicalThresholds:
    """What a path may differ by from the nominal one before it counts as not physiological.

    The defaults lie beyond what paths of s1_left's model do that neither jump nor lose contact (their
    99th percentile stays below, but for the arms of the iliacus), and below what those do that jump.

    Parameters
    ----------
    length_deviation
        In any pose, m.
    moment_arm_deviation
        In any pose and about any coordinate, m.
    variability
        Ratio of standard deviations over poses, either way, of length or of any moment arm.
    length_step
        Of the difference from the nominal length, from frame to frame of a recorded cycle, m.
    moment_arm_step
        Likewise of moment arms, m.
    """

    length_deviation: float = 0.025
    moment_arm_deviation: float = 0.020
    variability: float = 3.0
    length_step: float = 0.001
    moment_arm_step: float = 0.003


DEFAULT_THRESHOLDS = PhysiologicalThresholds()


@dataclass(frozen=True)
class PathMeasures:
    """How samples of a path differ from the nominal path; what `PhysiologicalThresholds` are held to.

    ``jumps`` marks samples that in some pose come to lie where length jumps (a path point inside the
    cylinder, the path off its end, more than half a turn) though the nominal path does not in that pose;
    ``never_touches`` those that lie in no pose on a cylinder that the nominal path lies on.
    """

    length_deviation: Float[np.ndarray, " sample"]
    moment_arm_deviation: Float[np.ndarray, " sample"]
    variability: Float[np.ndarray, " sample"]
    length_step: Float[np.ndarray, " sample"]
    moment_arm_step: Float[np.ndarray, " sample"]
    jumps: Bool[np.ndarray, " sample"]
    never_touches: Bool[np.ndarray, " sample"]

    def faults(
        self, thresholds: PhysiologicalThresholds = DEFAULT_THRESHOLDS
    ) -> dict[str, Bool[np.ndarray, " sample"]]:
        """Say by criterion which samples fail it."""
        limited = {name: getattr(self, name) > limit for name, limit in vars(thresholds).items()}
        return {"jumps": self.jumps, "never_touches": self.never_touches, **limited}

    def physiological(
        self, thresholds: PhysiologicalThresholds = DEFAULT_THRESHOLDS
    ) -> Bool[np.ndarray, " sample"]:
        """Say which samples fail no criterion."""
        return ~np.any(list(self.faults(thresholds).values()), axis=0)


def measure_paths(found: WrappedPath, nominal: WrappedPath, cycle: slice) -> PathMeasures:
    """Compare samples of a path with the nominal path.

    Parameters
    ----------
    found
        NumPy arrays that lead with ``sample pose``, from `wrap_at_samples`.
    nominal
        The same with one sample, in the same poses.
    cycle
        The poses that are the frames of one recorded cycle, in order, its repeated last one left out.
    """
    length, usual_length = np.asarray(found.length), np.asarray(nominal.length)
    arm, usual_arm = np.asarray(found.moment_arm), np.asarray(nominal.moment_arm)
    touching, usually_touching = np.asarray(found.touching), np.asarray(nominal.touching)
    change, arm_change = length - usual_length, arm - usual_arm
    jumps = np.zeros(len(change), dtype=bool)
    for name in ("inside", "off_end", "long_wrap"):
        own, usual = getattr(found.margins, name), getattr(nominal.margins, name)
        jumps |= np.asarray((own < 0.0) & (usual >= 0.0)).any(axis=1)
    return PathMeasures(
        length_deviation=np.abs(change).max(axis=1),
        moment_arm_deviation=np.abs(arm_change).max(axis=(1, 2), initial=0.0),
        variability=np.maximum(
            _ratio(length.std(axis=1), usual_length.std(axis=1)),
            _ratio(arm.std(axis=1), usual_arm.std(axis=1)).max(axis=1, initial=1.0),
        ),
        length_step=np.abs(_steps(change[:, cycle])).max(axis=1, initial=0.0),
        moment_arm_step=np.abs(_steps(arm_change[:, cycle])).max(axis=(1, 2), initial=0.0),
        jumps=jumps,
        never_touches=np.any(np.any(usually_touching, axis=1) & ~np.any(touching, axis=1), axis=1),
    )


def _steps(values: Float[np.ndarray, "sample frame *coordinate"]) -> Float[np.ndarray, "..."]:
    """From each frame to the next, and from the last to the first."""
    return np.roll(values, -1, axis=1) - values


def _ratio(one: Float[np.ndarray, "..."], other: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    ratio = (one + _LEAST_DEVIATION) / (other + _LEAST_DEVIATION)
    return np.maximum(ratio, 1.0 / ratio)
