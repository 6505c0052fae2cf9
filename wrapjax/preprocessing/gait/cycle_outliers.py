"""Gait cycles that differ from a person's others: double strides, steps on another plate, odd moments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from wrapjax.preprocessing.gait.force_plates import SIDES, FootForces, centers_of_pressure

#: Largest distance of a cycle from the median of all, in robust standard deviations.
MOST_DEVIATIONS = 5.0
#: Fewest cycles among which outliers can be found.
MIN_CYCLES = 5
#: Factor that makes the median absolute deviation a standard deviation, for a normal distribution.
_NORMAL = 1.4826
#: Smallest robust standard deviation of a duration, as a share of the median.
_SMALLEST_DURATION_SD = 0.02
#: Smallest median and robust deviation of the difference of a moment from its median curve, as a share of
#: the latter's range.
_SMALLEST_MOMENT_SD = 0.01
#: Largest share of a stance in which the center of pressure may be nearer to the other foot.
MAX_OTHER_FOOT = 0.2

Cycle = tuple[float, float]


def unusual_durations(cycles: Sequence[Cycle]) -> dict[Cycle, str]:
    """Name the cycles whose duration is beyond `MOST_DEVIATIONS` robust standard deviations.

    Parameters
    ----------
    cycles
        Start and end of each cycle, s.

    Returns
    -------
    dict
        Reason for each unusual cycle; empty if there are fewer than `MIN_CYCLES`.
    """
    if len(cycles) < MIN_CYCLES:
        return {}
    durations = np.array([end - start for start, end in cycles])
    median = float(np.median(durations))
    deviation = max(_NORMAL * float(np.median(np.abs(durations - median))), _SMALLEST_DURATION_SD * median)
    return {
        cycle: f"it lasts {duration:.3g} s, {duration / median:.2g} times the median of {median:.3g} s"
        for cycle, duration in zip(cycles, durations.tolist(), strict=True)
        if abs(duration - median) > MOST_DEVIATIONS * deviation
    }


def unusual_moments(
    cycles: Sequence[Cycle],
    time: Float[np.ndarray, " frame"],
    moments: Mapping[str, Float[np.ndarray, " frame"]],
) -> dict[Cycle, str]:
    """Name the cycles whose moments differ from the median curve by more than the others' do.

    The difference is the root mean square over the cycle, of each coordinate; a cycle is unusual where it
    exceeds the median difference by `MOST_DEVIATIONS` robust standard deviations of all differences.

    Parameters
    ----------
    cycles
        Start and end of each cycle, s.
    time, moments
        Times, s, and moments by name, N m.
    """
    if len(cycles) < MIN_CYCLES:
        return {}
    found: dict[Cycle, str] = {}
    for name, moment in moments.items():
        curves = np.array([np.interp(np.linspace(*cycle, 101), time, moment) for cycle in cycles])
        typical = np.median(curves, axis=0)
        difference = np.sqrt(np.mean((curves - typical) ** 2, axis=1))
        smallest = _SMALLEST_MOMENT_SD * float(np.ptp(typical))
        median = max(float(np.median(difference)), smallest)
        deviation = max(_NORMAL * float(np.median(np.abs(difference - median))), smallest)
        for cycle, one in zip(cycles, difference.tolist(), strict=True):
            if one > median + MOST_DEVIATIONS * deviation:
                found.setdefault(
                    cycle,
                    f"{name} differs from the median curve by {one:.3g} N m (root mean square), others by "
                    f"{median:.3g}",
                )
    return found


def steps_of_other_foot(
    cycles: Sequence[Cycle],
    side: str,
    time: Float[np.ndarray, " frame"],
    feet: Mapping[str, Float[np.ndarray, "3 frame"]],
    forces: FootForces,
    min_force: float,
) -> dict[Cycle, str]:
    """Name the cycles in which the leg's plate was trodden by the other foot, by place.

    Parameters
    ----------
    cycles
        Start and end of each cycle, s.
    side
        Side of the leg.
    time
        Times of the motion, s.
    feet
        Position of the origin of each foot's body, m, by side.
    forces
        Forces on the feet, as labelled.
    min_force
        Force above which a plate is loaded, N.
    """
    if len(feet) < 2 or side not in forces.sides:
        return {}
    wrench = forces.at(time)
    row = forces.sides.index(side)
    center = centers_of_pressure(wrench)[row]
    distance = {one: np.hypot(*(center - origin)[[0, 2]]) for one, origin in feet.items()}
    other = next(one for one in feet if one != side)
    loaded = wrench[row, 4] > min_force
    found = {}
    for cycle in cycles:
        inside = loaded & (time >= cycle[0]) & (time <= cycle[1])
        if not inside.any():
            continue
        share = float((distance[other] < distance[side])[inside].mean())
        if share > MAX_OTHER_FOOT:
            found[cycle] = (
                f"the force is nearer to the {SIDES[other]} foot in {100.0 * share:.0f} % of the contact "
                f"with the {SIDES[side]} foot's plate"
            )
    return found


def dropped_sentences(unusual: Mapping[Cycle, str]) -> list[str]:
    """Write a sentence for each cycle that was dropped, in their order."""
    return [
        f"cycle {cycle[0]:.4g} to {cycle[1]:.4g} s dropped: {reason}"
        for cycle, reason in sorted(unusual.items())
    ]
