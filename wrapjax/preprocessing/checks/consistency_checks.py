"""Checks that motion, ground reaction forces and EMG of a recording agree in time, leg and unit.

Forces and motion are compared by Newton's law: the vertical ground reaction force equals the mass of all
bodies times the vertical acceleration of the center of mass plus the weight. This reveals a time shift of 50
ms or a wrong unit, provided that all steps were on force plates, or during single support of a foot on a
plate. Forces are assigned to legs by the distance of the center of pressure from the feet, and EMG is
compared with the ankle moment. Each check reports its numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.preprocessing.gait.force_plates import (
    MAX_SWING,
    SIDES,
    FootForces,
    all_contact_measured,
    centers_of_pressure,
    find_plate_contacts,
)

#: Largest accepted time shift between forces and motion, s: two frames of a slow camera. In recorded walking
#: of two healthy adults, at 50 and 1000 Hz, the estimate is accurate to 5 ms.
MAX_LAG = 0.020
#: Time shifts of forces that are compared, s.
LAGS = np.arange(-0.250, 0.2501, 0.005)
#: A time shift is reported only if it reduces the error of the vertical force to less than this share.
MAX_ERROR_RATIO = 0.9
#: Largest accepted difference between the mean measured and required vertical force, as a share of the
#: latter.
MAX_WEIGHT_ERROR = 0.15
#: Limits of the ratio of measured to required force if a single foot was measured. They are wide, to reveal a
#: wrong unit only, as a hand on a rail can bear a part of the weight.
MIN_SINGLE_FOOT_RATIO, MAX_SINGLE_FOOT_RATIO = 0.5, 2.0
#: If a single foot was measured, a time shift is reported only if the error of the unshifted force (standard
#: deviation) exceeds this share of the required force: in slow walking, mid-stance forces vary too little to
#: determine a shift.
MIN_SINGLE_FOOT_ERROR = 0.03
#: Smallest contact time of the leg's foot with its plates in every cycle, as a share of its stance.
MIN_STANCE_SHARE = 0.5
#: Smallest number of frames for a comparison of forces with motion.
MIN_FRAMES = 10
#: Smallest force on a foot for a check of its center of pressure, as a share of body weight.
MIN_LOAD_SHARE = 0.3
#: Largest difference of measured from required vertical force, as a share of body weight, and largest share
#: of an interval in which it is exceeded.
MAX_UNSUPPORTED, MAX_UNSUPPORTED_SHARE = 0.3, 0.2
#: Largest median distance of the center of pressure from the origin of the foot's body (the heel), m.
MAX_FOOT_DISTANCE = 0.35
#: Largest accepted distance of the model's markers from the recorded ones (root mean square over all), m.
#: OpenSim recommends at most 2 cm; the faults that this check is for cause more than the width of a foot.
MAX_MARKER_ERROR = 0.06
#: Accepted lead of a calf muscle's EMG before the plantarflexion moment, s (negative: delay). Eleven cycles
#: of three people, one of them after a stroke, have -0.08 to 0.24 s; half a gait cycle is well outside.
CALF_LEADS = (-0.15, 0.30)
#: Leads that are compared, s, and the smallest correlation for which the best of them is judged.
LEADS = np.arange(-0.60, 0.6001, 0.01)
MIN_CORRELATION = 0.5


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Parameters
    ----------
    what
        Name of the check.
    found
        Result, with numbers and units.
    fault
        Expected and actual result, as a sentence without full stop; empty if the check passed.
    hint
        Suggested correction.
    """

    what: str
    found: str
    fault: str = ""
    hint: str = ""


def check_foot_on_plates(
    forces: FootForces, side: str, cycles: Sequence[tuple[float, float]]
) -> Iterator[Check]:
    """Check that the leg's foot is on its plates in every cycle; otherwise its moments would be wrong.

    Parameters
    ----------
    forces
        Filtered forces on one foot or both.
    side
        Side of the leg, which must be measured.
    cycles
        Start and end of each gait cycle in s.

    Yields
    ------
    Check
        One check of all cycles.
    """
    steps = find_plate_contacts(forces)[side]
    foot = f"the {SIDES[side]} foot"
    off = {cycle: steps.durations_off_plate(*cycle) for cycle in cycles}
    longest = {cycle: float(durations.max()) for cycle, durations in off.items()}
    # Without any step the stance is NaN; the negated comparisons are then true, so that the cycle is
    # reported.
    missed = [
        (start, end)
        for (start, end), durations in off.items()
        if not durations.max() <= MAX_SWING * steps.stance
        or not end - start - durations.sum() >= MIN_STANCE_SHARE * steps.stance
    ]
    found = f"{foot} is off its plates for at most {max(longest.values()):.3g} s of a cycle"
    found += f", and on them for {steps.stance:.3g} s a step" if steps.strikes.size else ""
    fault = hint = ""
    if missed:
        start, end = missed[0]
        fault = f"expected {foot} on its plates in every cycle, found it off them for"
        fault = f"{fault} {longest[start, end]:.3g} s of the cycle from {start:.4g} to {end:.4g} s"
        upward = forces.vertical(side).sum() > 0.0
        hint = "list as cycles only those with all steps on plates" if upward else _unit_hint(0.0)
    yield Check(f"steps of the {SIDES[side]} foot", found, fault, hint)


def check_forces_against_motion(
    time: Float[np.ndarray, " frame"],
    required: Float[np.ndarray, " frame"],
    forces: FootForces,
) -> Iterator[Check]:
    """Compare the total vertical force with that required by the motion, where plates measured all contact.

    Parameters
    ----------
    time
        Times of the motion, s.
    required
        Vertical force that supports and accelerates all bodies of the model, N.
    forces
        Forces on one foot or both, filtered like the motion, upward positive.

    Yields
    ------
    Check
        Check of the weight, then of the timing; or a single one that states why they cannot be compared.
    """
    total = forces.wrench[:, 4].sum(axis=0)
    steps = [foot for foot in find_plate_contacts(forces).values() if foot.strikes.size]
    # Without any step all frames are compared, and the mean force reveals the fault.
    complete = all_contact_measured(time, steps) if steps else np.ones(time.size, bool)
    inside = complete & (time + LAGS[0] >= forces.time[0]) & (time + LAGS[-1] <= forces.time[-1])
    inside = inside if inside.sum() >= MIN_FRAMES else complete
    if inside.sum() < MIN_FRAMES:
        found = "forces are not compared with motion: all contact is known to be on plates in too few frames"
        yield Check("weight and timing of forces", found)
        return
    times, required = time[inside], required[inside]
    single_foot = len(steps) == 1

    measured = float(np.interp(times, forces.time, total).mean())
    ratio = measured / float(required.mean())
    found = f"the vertical ground reaction force is {measured:.4g} N on average, {ratio:.3g} times the"
    found = f"{found} {required.mean():.4g} N that the motion of the model requires"
    if steps:
        found += " during single support" if single_foot else " while all contact is known to be on plates"
    wrong = abs(ratio - 1.0) > MAX_WEIGHT_ERROR
    if single_foot:
        wrong = not MIN_SINGLE_FOOT_RATIO < ratio < MAX_SINGLE_FOOT_RATIO
    yield Check(
        "weight",
        found,
        f"expected forces that support the weight of the model, found that {found}" if wrong else "",
        _unit_hint(ratio),
    )
    if wrong:
        return

    def error_at(lag: float) -> float:
        error = np.interp(times + lag, forces.time, total) - required
        return float(np.std(error))

    errors = np.array([error_at(lag) for lag in LAGS])
    lag, smallest, unshifted = float(LAGS[errors.argmin()]), float(errors.min()), error_at(0.0)
    milliseconds = round(abs(lag) * 1e3)
    error = f"differs by {unshifted:.3g} N (standard deviation) from the required force"
    found = f"forces agree best with motion as recorded: the vertical force {error}"
    if milliseconds:
        late = "late" if lag > 0.0 else "early"
        found = (
            f"forces agree best with motion if taken as {milliseconds} ms {late}: as recorded the vertical"
        )
        found = f"{found} force {error}, and with this correction by {smallest:.3g} N"
    shifted = abs(lag) > MAX_LAG + 1e-9 and smallest < MAX_ERROR_RATIO * unshifted
    if single_foot:
        shifted &= unshifted > MIN_SINGLE_FOOT_ERROR * float(required.mean())
    yield Check(
        "timing of forces",
        found,
        f"expected forces within at most {MAX_LAG * 1e3:.0f} ms of motion, found that {found}"
        if shifted
        else "",
        "check triggers, resampling and filters of both" if shifted else "",
    )


def check_support(
    time: Float[np.ndarray, " frame"],
    required: Float[np.ndarray, " frame"],
    forces: FootForces,
    intervals: Sequence[tuple[float, float]],
    weight: float,
) -> Iterator[Check]:
    """Check that the plates measured the force that a movement requires, in every interval.

    Parameters
    ----------
    time, required
        Times, s, and vertical force that supports and accelerates all bodies of the model, N.
    forces
        Forces on one foot or both, filtered like the motion, upward positive.
    intervals
        Start and end of each interval, s.
    weight
        Body weight, N.

    Yields
    ------
    Check
        One check of all intervals; none if a single foot was measured, whose share is not known.
    """
    if len(forces.sides) < 2:
        return
    measured = np.interp(time, forces.time, forces.wrench[:, 4].sum(axis=0))
    missing = np.abs(measured - required) > MAX_UNSUPPORTED * weight
    shares = {
        one: float(missing[inside].mean())
        for one in intervals
        if (inside := (time >= one[0]) & (time <= one[1])).any()
    }
    if not shares:
        return
    worst = max(shares, key=lambda one: shares[one])
    difference = f"{100.0 * MAX_UNSUPPORTED:.0f} % of body weight"
    found = f"the plates' vertical force differs from what the motion requires by more than {difference}"
    found = (
        f"{found} in {100.0 * shares[worst]:.0f} % of the interval from {worst[0]:.4g} to {worst[1]:.4g} s"
    )
    wrong = shares[worst] > MAX_UNSUPPORTED_SHARE
    yield Check(
        "support",
        found,
        f"expected all contact with the ground on plates, found that {found}" if wrong else "",
        "was a foot beside its plate, or a hand on a rail, or is the force in another unit?" if wrong else "",
    )


def _unit_hint(ratio: float) -> str:
    if ratio <= 0.0:
        return "give the forces of the ground on the person, upward positive"
    for factor, words in ((1000.0, "N, not mN"), (0.001, "N, not kN"), (1 / 9.81, "N, not kg")):
        if abs(ratio / factor - 1.0) < 0.3:
            return f"give forces in {words}"
    hint = "check the gain of the plates, and whether the mass of the model is that of the person; were"
    hint = f"{hint} steps of the other foot beside its plates, or a hand on a rail?"
    return f"{hint} Then leave out that foot's forces"


def check_force_sides(
    time: Float[np.ndarray, " frame"],
    feet: Mapping[str, Float[np.ndarray, "3 frame"]],
    forces: FootForces,
    weight: float,
) -> Iterator[Check]:
    """Check that the center of pressure of each force is near the foot of the same side.

    Parameters
    ----------
    time
        Times of the motion, s.
    feet
        Position of the origin of each foot's body, m, by side.
    forces
        Forces on one foot or both.
    weight
        Body weight, N.

    Yields
    ------
    Check
        Check of each measured foot that bears weight.
    """
    wrench = forces.at(time)
    centers = centers_of_pressure(wrench)
    for row, side in enumerate(forces.sides):
        loaded = wrench[row, 4] > MIN_LOAD_SHARE * weight
        if not loaded.any():
            continue
        distance = {
            foot: float(np.median(np.hypot(*(centers[row] - origin)[[0, 2]][:, loaded])))
            for foot, origin in feet.items()
        }
        same_side = distance[side]
        others = {foot: other for foot, other in distance.items() if foot != side}
        name = f"the {SIDES[side]} foot"
        found = f"{name}'s center of pressure is {same_side:.3g} m from {name}"
        found += "".join(f" and {other:.3g} m from the {SIDES[foot]} one" for foot, other in others.items())
        fault = hint = ""
        if any(other < same_side for other in others.values()):
            fault = f"expected each force under the foot of its side, found that {found}"
            hint = "the legs are swapped: exchange [forces.l] and [forces.r], or left and right markers"
        elif same_side > MAX_FOOT_DISTANCE:
            fault = f"expected forces within {MAX_FOOT_DISTANCE:g} m of the foot, found that {found}"
            hint = (
                "check the unit of the point (m), its origin and axes, and that motion and forces share them"
            )
        yield Check(f"place of the {SIDES[side]} force", found, fault, hint)


def check_calf_emg_against_moment(
    time: Float[np.ndarray, " frame"],
    plantarflexion: Float[np.ndarray, " frame"],
    channel: str,
    emg_time: Float[np.ndarray, " sample"],
    envelope: Float[np.ndarray, " sample"],
) -> Check:
    """Compare the timing of a calf muscle's EMG with the plantarflexion moment of its leg.

    Delays differ between people and channels, so that this check reveals EMG of the other leg and time shifts
    of more than about 0.2 s, but not of 50 ms.

    Parameters
    ----------
    time
        Times of the moment, s.
    plantarflexion
        Ankle moment, plantarflexion positive, N m.
    channel
        Name of the EMG channel.
    emg_time
        Times of the EMG, s.
    envelope
        EMG envelope, not negative, in any unit.
    """
    moment = np.clip(plantarflexion, 0.0, None)

    def correlation(lead: float) -> float:
        at = time - lead
        inside = (at >= emg_time[0]) & (at <= emg_time[-1])
        pair = moment[inside], np.interp(at[inside], emg_time, envelope)
        if inside.sum() < 0.7 * time.size or min(map(np.std, pair)) == 0.0:
            return -1.0
        return float(np.corrcoef(*pair)[0, 1])

    correlations = np.array([correlation(lead) for lead in LEADS])
    # Gait is periodic: of leads with nearly the same correlation, the smallest in magnitude is taken.
    candidates = np.flatnonzero(correlations > correlations.max() - 0.02)
    index = int(candidates[np.abs(LEADS[candidates]).argmin()])
    lead, best = float(LEADS[index]), float(correlations[index])
    direction = "before" if lead >= 0.0 else "after"
    found = f"'{channel}' is active {abs(lead) * 1e3:.0f} ms {direction} the ankle's plantarflexion moment"
    found = f"{found} (correlation {best:.2f} there, {correlation(0.0):.2f} unshifted)"
    wrong = not CALF_LEADS[0] <= lead <= CALF_LEADS[1] and best > MIN_CORRELATION
    earliest, latest = (f"{edge * 1e3:.0f}" for edge in CALF_LEADS)
    return Check(
        f"timing of EMG channel {channel}",
        found,
        f"expected EMG of the calf {earliest} to {latest} ms before its moment, found that {found}"
        if wrong
        else "",
        "check the trigger of the EMG, and whether the electrode is on the other leg" if wrong else "",
    )


def check_marker_errors(
    names: tuple[str, ...],
    recorded: Float[np.ndarray, "marker frame 3"],
    modelled: Float[np.ndarray, "marker frame 3"],
    max_error: float = MAX_MARKER_ERROR,
) -> Check:
    """Check the distance of the model's markers from the recorded ones after inverse kinematics.

    Parameters
    ----------
    names
        Names of the markers.
    recorded
        Recorded positions, m; NaN where a marker was not visible.
    modelled
        Positions of the model's markers, m.
    max_error
        Largest accepted distance, m (root mean square over all markers and frames).
    """
    distance = np.linalg.norm(recorded - modelled, axis=-1)
    marker_error = np.sqrt(np.nanmean(distance**2, axis=1))
    error = float(np.sqrt(np.nanmean(distance**2)))
    wrong = error > max_error
    order = np.argsort(-marker_error)[:3]
    worst = ", ".join(f"'{names[index]}' {marker_error[index] * 1e3:.0f} mm" for index in order)
    found = (
        f"the model's markers are {error * 1e3:.3g} mm from those recorded (root mean square; worst: {worst})"
    )
    return Check(
        "markers",
        found,
        f"expected at most {max_error * 1e3:.0f} mm, found that {found}" if wrong else "",
        "check scaling, marker names (left and right?), unit and axes ([laboratory])" if wrong else "",
    )
