"""Do motion, forces and EMG belong together: in time, by leg, in unit? Each check gives its numbers.

Forces belong to motion by Newton's law: what the ground pushes up with is the mass of all bodies times the
acceleration of their common center, gravity included. That tells a shift of 50 ms and a wrong unit, as long
as all steps were on plates, or while one foot that was bears the body alone. The feet tell whose force is
whose.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.preprocessing.force_plates import SIDES, FootForces, centers_of_pressure
from wrapjax.preprocessing.measured_steps import LONGEST_SWING, all_measured, measured_steps

#: Largest time in s by which forces may be late or early: two frames of slow cameras. On recorded walking of
#: two healthy adults, at 50 and 1000 frames a second, the estimate is within 5 ms.
MOST_LAG = 0.020
#: Lags tried, s.
LAGS = np.arange(-0.250, 0.2501, 0.005)
#: A lag is real if there the vertical force fits so much better than unshifted.
BETTER = 0.9
#: By how much the mean vertical force may differ from the model's weight.
MOST_WEIGHT_ERROR = 0.15
#: Of one foot that bears the body alone this tells no more than a unit: a hand on a rail bears some, too.
LEAST_ALONE, MOST_ALONE = 0.5, 2.0
#: And there a lag is real only if unshifted forces are off by so much of the weight (standard deviation):
#: below that, in slow walking, forces change too little in the middle of a stance to tell.
LEAST_MISFIT_ALONE = 0.03
#: Share of a stance that the leg's own foot must be on its plates in every cycle.
LEAST_STANCE = 0.5
#: Frames from which forces are compared with motion.
LEAST_FRAMES = 10
#: Share of the model's weight that must be borne by a foot for its center of pressure to be judged.
LOADED = 0.3
#: Farthest that a foot's center of pressure may be from its own body's origin (the heel), m, by the median.
MOST_FOOT_DISTANCE = 0.35
#: Largest distance of the model's markers from those recorded, m, root mean square over all: OpenSim advises
#: at most 2 cm, and what is wrong here is off by more than a foot's width.
MOST_MARKER_ERROR = 0.06
#: By how much EMG of the calf may lead the moment it makes (negative: lag behind), s. Eleven cycles of three
#: people, one after a stroke, have -0.08 to 0.24 s; half a gait cycle is well outside.
CALF_LEADS = (-0.15, 0.30)
#: Leads tried, s, and the correlation from which the best of them counts.
LEADS = np.arange(-0.60, 0.6001, 0.01)
LEAST_CORRELATION = 0.5


@dataclass(frozen=True)
class Check:
    """One check and what it found.

    Parameters
    ----------
    what
        What was compared.
    found
        What was found, with numbers and units.
    fault
        What was expected and found, as a sentence without full stop; empty where nothing is wrong.
    hint
        What would mend it.
    """

    what: str
    found: str
    fault: str = ""
    hint: str = ""


def own_steps_measured(
    forces: FootForces, side: str, cycles: Sequence[tuple[float, float]]
) -> Iterator[Check]:
    """Look for steps of the leg's own foot beside the plates, whose moments would be wrong.

    Parameters
    ----------
    forces
        Filtered, of one foot or both.
    side
        Of the leg, one of those measured.
    cycles
        Start and end of each gait cycle in s.

    Yields
    ------
    Check
        One, of all cycles.
    """
    steps = measured_steps(forces)[side]
    foot = f"the {SIDES[side]} foot"
    off = {cycle: steps.times_off(*cycle) for cycle in cycles}
    longest = {cycle: float(times.max()) for cycle, times in off.items()}
    # Without any step a stance is NaN, and nothing is less than that.
    missed = [
        (start, end)
        for (start, end), times in off.items()
        if not times.max() <= LONGEST_SWING * steps.stance
        or not end - start - times.sum() >= LEAST_STANCE * steps.stance
    ]
    found = f"{foot} is off its plates for at most {max(longest.values()):.3g} s of a cycle"
    found += f", and on them for {steps.stance:.3g} s a step" if steps.strikes.size else ""
    fault = hint = ""
    if missed:
        start, end = missed[0]
        fault = f"expected {foot} on its plates in every cycle, found it off them for"
        fault = f"{fault} {longest[start, end]:.3g} s of the cycle from {start:.4g} to {end:.4g} s"
        upward = forces.vertical(side).sum() > 0.0
        hint = "list as cycles those whose steps were on plates" if upward else _unit_hint(0.0)
    yield Check(f"steps of the {SIDES[side]} foot", found, fault, hint)


def forces_against_motion(
    time: Float[np.ndarray, " frame"],
    required: Float[np.ndarray, " frame"],
    forces: FootForces,
) -> Iterator[Check]:
    """Compare the whole vertical force with what the moving bodies need, while plates measured all of it.

    Parameters
    ----------
    time
        s, of motion.
    required
        Vertical force that carries and accelerates all bodies of the model, N.
    forces
        Filtered as motion was, upward positive in N; of one foot or both.

    Yields
    ------
    Check
        Of the weight, then of the timing; or one that says why neither can be told.
    """
    total = forces.wrench[:, 4].sum(axis=0)
    steps = [foot for foot in measured_steps(forces).values() if foot.strikes.size]
    # Without any step something else is amiss, which the mean force tells.
    whole = all_measured(time, steps) if steps else np.ones(time.size, bool)
    inside = whole & (time + LAGS[0] >= forces.time[0]) & (time + LAGS[-1] <= forces.time[-1])
    inside = inside if inside.sum() >= LEAST_FRAMES else whole
    if inside.sum() < LEAST_FRAMES:
        found = "forces are not compared with motion, since there are hardly any frames in which all steps"
        yield Check("weight and timing of forces", f"{found} are known to have been on plates")
        return
    at, needed = time[inside], required[inside]
    alone = len(steps) == 1

    measured = float(np.interp(at, forces.time, total).mean())
    ratio = measured / float(needed.mean())
    found = f"the ground's vertical force is {measured:.4g} N on average, {ratio:.3g} times the"
    found = f"{found} {needed.mean():.4g} N that the model's bodies need in this motion"
    found += " while one foot bears them alone" if alone else ""
    heavy = not LEAST_ALONE < ratio < MOST_ALONE if alone else abs(ratio - 1.0) > MOST_WEIGHT_ERROR
    yield Check(
        "weight",
        found,
        f"expected forces that bear the model's weight, found that {found}" if heavy else "",
        _unit_hint(ratio),
    )
    if heavy:
        return

    def misfit(lag: float) -> float:
        error = np.interp(at + lag, forces.time, total) - needed
        return float(np.std(error))

    misfits = np.array([misfit(lag) for lag in LAGS])
    lag, least, unshifted = float(LAGS[misfits.argmin()]), float(misfits.min()), misfit(0.0)
    by = round(abs(lag) * 1e3)
    away = f"{unshifted:.3g} N (standard deviation) from what the bodies need"
    found = f"forces fit motion best as they were recorded: the vertical force is then {away}"
    if by:
        late = "late" if lag > 0.0 else "early"
        found = f"forces fit motion best {by} ms {late}: as recorded the vertical force is {away}, and then"
        found = f"{found} {least:.3g} N"
    shifted = abs(lag) > MOST_LAG + 1e-9 and least < BETTER * unshifted
    if alone:
        shifted &= unshifted > LEAST_MISFIT_ALONE * float(needed.mean())
    yield Check(
        "timing of forces",
        found,
        f"expected motion and forces to be in time within {MOST_LAG * 1e3:.0f} ms, found that {found}"
        if shifted
        else "",
        "check triggers, resampling and filters of both" if shifted else "",
    )


def _unit_hint(ratio: float) -> str:
    if ratio <= 0.0:
        return "forces must be those of the ground on the person, upward positive"
    for factor, words in ((1000.0, "N, not mN"), (0.001, "N, not kN"), (1 / 9.81, "N, not kg")):
        if abs(ratio / factor - 1.0) < 0.3:
            return f"give forces in {words}"
    hint = (
        "check the gain of the plates, and whether the model weighs what the person does; were steps of the"
    )
    return f"{hint} other foot beside its plates, or a hand on a rail? Then leave out that foot's forces"


def legs_of_forces(
    time: Float[np.ndarray, " frame"],
    feet: Mapping[str, Float[np.ndarray, "3 frame"]],
    forces: FootForces,
    weight: float,
) -> Iterator[Check]:
    """Compare where each force acts with where the feet are.

    Parameters
    ----------
    time
        s, of motion.
    feet
        Origin of each foot's body, m, by side.
    forces
        Of one foot or both.
    weight
        N.
    """
    wrench = forces.at(time)
    centers = centers_of_pressure(wrench)
    for row, side in enumerate(forces.sides):
        loaded = wrench[row, 4] > LOADED * weight
        if not loaded.any():
            continue
        distance = {
            foot: float(np.median(np.hypot(*(centers[row] - origin)[[0, 2]][:, loaded])))
            for foot, origin in feet.items()
        }
        own = distance[side]
        others = {foot: far for foot, far in distance.items() if foot != side}
        found = f"the {SIDES[side]} foot's center of pressure is {own:.3g} m from the {SIDES[side]} foot"
        found += "".join(f" and {far:.3g} m from the {SIDES[foot]} one" for foot, far in others.items())
        fault = hint = ""
        if any(far < own for far in others.values()):
            fault = f"expected each force under its own foot, found that {found}"
            hint = "the legs are swapped: exchange [forces.l] and [forces.r], or left and right markers"
        elif own > MOST_FOOT_DISTANCE:
            fault = f"expected forces within {MOST_FOOT_DISTANCE:g} m of the foot, found that {found}"
            hint = (
                "check the unit of the point (m), its origin and axes, and that motion and forces share them"
            )
        yield Check(f"place of the {SIDES[side]} force", found, fault, hint)


def calf_against_moment(
    time: Float[np.ndarray, " frame"],
    plantarflexion: Float[np.ndarray, " frame"],
    channel: str,
    emg_time: Float[np.ndarray, " sample"],
    envelope: Float[np.ndarray, " sample"],
) -> Check:
    """Compare the timing of a calf muscle's EMG with the plantarflexion moment of its leg.

    A muscle's delay differs between people and channels, so this tells the other leg's EMG and shifts of
    more than some 0.2 s, and not 50 ms.

    Parameters
    ----------
    time, plantarflexion
        s; moment that the calf makes, positive, N m.
    channel
        Its name.
    emg_time, envelope
        s; anything, positive.
    """
    shape = np.clip(plantarflexion, 0.0, None)

    def correlation(lead: float) -> float:
        at = time - lead
        inside = (at >= emg_time[0]) & (at <= emg_time[-1])
        pair = shape[inside], np.interp(at[inside], emg_time, envelope)
        if inside.sum() < 0.7 * time.size or min(map(np.std, pair)) == 0.0:
            return -1.0
        return float(np.corrcoef(*pair)[0, 1])

    correlations = np.array([correlation(lead) for lead in LEADS])
    # Steps repeat: of leads about as good as the best the shortest is meant.
    good = np.flatnonzero(correlations > correlations.max() - 0.02)
    place = int(good[np.abs(LEADS[good]).argmin()])
    lead, best = float(LEADS[place]), float(correlations[place])
    direction = "before" if lead >= 0.0 else "after"
    found = f"'{channel}' is active {abs(lead) * 1e3:.0f} ms {direction} the ankle's plantarflexion moment"
    found = f"{found} (correlation {best:.2f} there, {correlation(0.0):.2f} unshifted)"
    amiss = not CALF_LEADS[0] <= lead <= CALF_LEADS[1] and best > LEAST_CORRELATION
    least, most = (f"{edge * 1e3:.0f}" for edge in CALF_LEADS)
    return Check(
        f"timing of EMG channel {channel}",
        found,
        f"expected EMG of the calf {least} to {most} ms before its moment, found that {found}"
        if amiss
        else "",
        "check the trigger of the EMG, and whether the electrode is on the other leg" if amiss else "",
    )


def markers_followed(
    names: tuple[str, ...],
    recorded: Float[np.ndarray, "marker frame 3"],
    followed: Float[np.ndarray, "marker frame 3"],
    most: float = MOST_MARKER_ERROR,
) -> Check:
    """Compare where the model's markers are with where they were recorded.

    Parameters
    ----------
    names, recorded, followed
        Markers; m, NaN where not seen.
    most
        Largest root mean square distance in m, over all markers, of a model that fits the person.
    """
    distance = np.linalg.norm(recorded - followed, axis=-1)
    of_marker = np.sqrt(np.nanmean(distance**2, axis=1))
    whole = float(np.sqrt(np.nanmean(distance**2)))
    order = np.argsort(-of_marker)[:3]
    worst = ", ".join(f"'{names[place]}' {of_marker[place] * 1e3:.0f} mm" for place in order)
    found = (
        f"the model's markers are {whole * 1e3:.3g} mm from those recorded (root mean square; worst: {worst})"
    )
    return Check(
        "markers",
        found,
        f"expected at most {most * 1e3:.0f} mm, found that {found}" if whole > most else "",
        "check scaling, marker names (left and right?), unit and axes ([laboratory])" if whole > most else "",
    )
