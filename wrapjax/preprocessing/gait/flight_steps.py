"""Steps of gait with flight phases: which foot was on the ground, by force and place.

In running one foot at a time is on the ground, and between steps none. The sum of all plates is then the
force on that foot, whichever belt it treads, and also where it treads two. The foot is the one that is
nearest to the center of pressure of the sum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from wrapjax.preprocessing.gait.force_plates import SIDES, FootForces, centers_of_pressure
from wrapjax.preprocessing.gait.gait_events import (
    CONTACT_FORCE,
    MIN_PHASE_DURATION,
    without_short_runs,
)

#: Shortest flight, s. Forces that were low-pass filtered have shorter ones than the person.
MIN_FLIGHT = 0.03
#: Longest flight, s; longer intervals without force contain a step beside the plates.
MAX_FLIGHT = 0.6
#: Fewest flights of a recording with flight phases.
MIN_FLIGHTS = 3
#: In flight the motion requires less than this share of body weight, in the median.
MAX_FLIGHT_FORCE = 0.35
#: Share of the impulse of a contact on each plate above which both feet may have been on the ground.
SHARED_IMPULSE = 0.2
#: Share of the impulse on the other foot's plate above which a step is counted as on it.
MIN_OTHER_SHARE = 0.05
#: Shortest running cycle, s.
MIN_RUNNING_CYCLE = 0.35

Side = str


@dataclass(frozen=True)
class FlightStep:
    """One contact with the ground between two flights.

    Parameters
    ----------
    start, end
        First and last time of the contact, s.
    side
        Foot on the ground, ``l`` or ``r``; empty if both were.
    distances
        Mean distance of the center of pressure from each foot, m, by side.
    other_share
        Share of the impulse that the plate of the other foot measured, as labelled.
    """

    start: float
    end: float
    side: Side
    distances: Mapping[Side, float]
    other_share: float


def find_flight_contacts(forces: FootForces) -> tuple[tuple[float, float], ...]:
    """Find the contacts of gait with flight phases in the sum of all forces; empty for gait without them.

    Parameters
    ----------
    forces
        Recorded forces on both feet, not filtered.

    Returns
    -------
    tuple of (float, float)
        Start and end of each contact, s.
    """
    if len(forces.sides) < 2:
        return ()
    total = forces.wrench[:, 4].sum(axis=0)
    on = without_short_runs(forces.time, total > CONTACT_FORCE, MIN_FLIGHT)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    contacts = [
        (float(forces.time[first]), float(forces.time[min(after, total.size - 1)]))
        for first, after in edges.reshape(-1, 2)
        if first > 0 and after < total.size
    ]
    contacts = [one for one in contacts if one[1] - one[0] >= MIN_PHASE_DURATION]
    flights = np.array([second[0] - first[1] for first, second in pairwise(contacts)])
    if (flights <= MAX_FLIGHT).sum() < MIN_FLIGHTS:
        return ()
    return tuple(contacts)


def stride_time(contacts: Sequence[tuple[float, float]]) -> float:
    """Compute the median time of two steps, s."""
    return 2.0 * float(np.median(np.diff([start for start, _ in contacts])))


def is_flight(
    time: Float[np.ndarray, " frame"],
    required: Float[np.ndarray, " frame"],
    contacts: Sequence[tuple[float, float]],
    weight: float,
) -> bool:
    """Return whether the body was in the air between contacts, by the force that its motion requires (N)."""
    between = np.zeros(time.size, dtype=bool)
    for (_, end), (start, _) in pairwise(contacts):
        if start - end <= MAX_FLIGHT:
            between |= (time > end) & (time < start)
    return bool(between.any()) and float(np.median(required[between])) < MAX_FLIGHT_FORCE * weight


def assign_steps(
    forces: FootForces,
    contacts: Sequence[tuple[float, float]],
    time: Float[np.ndarray, " frame"],
    feet: Mapping[Side, Float[np.ndarray, "3 frame"]],
    stated: Mapping[Side, Sequence[tuple[float, float]]],
) -> tuple[FlightStep, ...]:
    """Find the foot of each contact: the nearest to the center of pressure over the contact.

    Parameters
    ----------
    forces
        Recorded forces on both feet.
    contacts
        Contacts from `find_flight_contacts`.
    time
        Times of the motion, s.
    feet
        Position of the origin of each foot's body, m, by side.
    stated
        Intervals in which a contact's middle lies if a person has stated its foot, s, by side.
    """
    total = replace(forces, wrench=forces.wrench.sum(axis=0, keepdims=True))
    sampled, by_plate = total.at(time)[0], forces.at(time)
    center = centers_of_pressure(sampled[None])[0]
    plate_centers = centers_of_pressure(by_plate)
    steps = []
    for start, end in contacts:
        inside = (time >= start) & (time <= end)
        if not inside.any():
            continue
        load = np.maximum(sampled[4, inside], 0.0)
        distances = {side: _mean_distance(center, origin, inside, load) for side, origin in feet.items()}
        side = min(distances, key=lambda one: distances[one])
        shares = np.maximum(by_plate[:, 4, inside], 0.0).sum(axis=1) / max(load.sum(), 1e-9)
        if (shares > SHARED_IMPULSE).all():
            nearest = {
                min(
                    feet,
                    key=lambda one: _mean_distance(
                        plate_centers[row], feet[one], inside, np.maximum(by_plate[row, 4, inside], 0.0)
                    ),
                )
                for row in range(len(forces.sides))
            }
            side = "" if len(nearest) > 1 else side
        middle = 0.5 * (start + end)
        for one, intervals in stated.items():
            if any(first <= middle <= last for first, last in intervals):
                side = one
        others = [row for row, one in enumerate(forces.sides) if side and one != side]
        steps.append(FlightStep(start, end, side, distances, float(shares[others].sum())))
    return tuple(steps)


def _mean_distance(
    center: Float[np.ndarray, "3 frame"],
    origin: Float[np.ndarray, "3 frame"],
    inside: np.ndarray,
    load: Float[np.ndarray, " loaded"],
) -> float:
    """Compute the mean distance of a foot from the center of pressure, weighted by the load, m."""
    distance = np.linalg.norm((center - origin)[:, inside], axis=0)
    return float((distance * load).sum() / max(load.sum(), 1e-9))


def forces_of_steps(forces: FootForces, steps: Sequence[FlightStep]) -> FootForces:
    """Assign the sum of all plates to the foot on the ground, from the middle of one flight to the next.

    Contacts of both feet keep the forces of the plates as labelled.
    """
    wrench = forces.wrench.copy()
    total = forces.wrench.sum(axis=0)
    ends = [0.5 * (first.end + second.start) for first, second in pairwise(steps)]
    limits = [-np.inf, *ends, np.inf]
    for step, first, last in zip(steps, limits[:-1], limits[1:], strict=True):
        if not step.side:
            continue
        own = (forces.time >= first) & (forces.time < last)
        for row, side in enumerate(forces.sides):
            wrench[row][:, own] = total[:, own] if side == step.side else 0.0
    return replace(forces, wrench=wrench)


def flight_cycles(
    steps: Sequence[FlightStep], side: Side, start: float, end: float
) -> tuple[tuple[tuple[float, float], ...], tuple[str, ...]]:
    """Find the cycles of one foot, from strike to strike with one step of the other foot in between.

    Parameters
    ----------
    steps
        Steps of both feet, in their order.
    side
        Side of the leg.
    start, end
        First and last time that all recordings cover, s.

    Returns
    -------
    cycles, dropped
        Start and end of each cycle, s, and a sentence for each strike that begins none.
    """
    cycles, dropped = [], []
    own = [number for number, step in enumerate(steps) if step.side == side]
    for first, second in pairwise(own):
        limits = (steps[first].start, steps[second].start)
        if limits[0] < start or limits[1] > end:
            continue
        between = steps[first + 1 : second]
        duration = limits[1] - limits[0]
        if len(between) != 1 or not between[0].side:
            found = (
                "a contact of both feet" if any(not one.side for one in between) else f"{len(between)} steps"
            )
            other = SIDES["l" if side == "r" else "r"]
            dropped.append(_dropped(limits, f"expected one step of the {other} foot in it, found {found}"))
        elif duration < MIN_RUNNING_CYCLE:
            dropped.append(_dropped(limits, f"it lasts {duration:.3g} s"))
        else:
            cycles.append(limits)
    return tuple(cycles), tuple(dropped)


def _dropped(cycle: tuple[float, float], reason: str) -> str:
    return f"cycle {cycle[0]:.4g} to {cycle[1]:.4g} s dropped: {reason}"
