"""Stances on force plates, and comparison of forces with motion where all contact was measured."""

import numpy as np
import pytest

from wrapjax.preprocessing.checks.consistency_checks import check_foot_on_plates, check_forces_against_motion
from wrapjax.preprocessing.gait.force_plates import FootForces, all_contact_measured, find_plate_contacts

#: Gait period and stance, s; double support lasts 0.15 s.
PERIOD, STANCE = 1.1, 0.7
WEIGHT = 800.0
TIME = np.arange(0.0, 6.0, 0.002)
#: Strikes of the left foot; the right foot's are half a period later.
LEFT, RIGHT = 0.5 + PERIOD * np.arange(4), 1.05 + PERIOD * np.arange(4)


def required_force(time):
    """Compute the vertical force that the motion requires, N; it is smallest in single support."""
    return WEIGHT * (1.0 - 0.2 * np.cos(4.0 * np.pi * (time - 0.85) / PERIOD))


def load_share(time, strike):
    """Compute the share of the force on the foot that strikes at this time."""
    rise, fall = (
        (edge / (STANCE - PERIOD / 2)).clip(0.0, 1.0) for edge in (time - strike, strike + STANCE - time)
    )
    return rise * fall


def plates(left, right=None, gain=1.0, late=0.0):
    """Compute the forces of the measured steps; of the left foot only if ``right`` is None."""
    feet = {"l": left} if right is None else {"l": left, "r": right}
    wrench = np.zeros((len(feet), 6, TIME.size))
    for row, strikes in enumerate(feet.values()):
        wrench[row, 4] = (
            gain * required_force(TIME - late) * sum(load_share(TIME - late, strike) for strike in strikes)
        )
    return FootForces(tuple(feet), TIME, wrench)


def between(start, end):
    return (start <= TIME) & (end >= TIME)


def faults(forces, time=TIME[150:2500:5]):
    return {
        check.what: check.fault for check in check_forces_against_motion(time, required_force(time), forces)
    }


def test_steps_on_plates_are_found():
    steps = find_plate_contacts(plates(LEFT[:2], RIGHT[1:2], gain=1e-3))
    np.testing.assert_allclose(steps["l"].strikes, LEFT[:2], atol=0.02)
    np.testing.assert_allclose(steps["r"].offs, RIGHT[1:2] + STANCE, atol=0.02)
    assert steps["l"].stance == pytest.approx(STANCE, abs=0.03)


def test_a_step_at_the_edge_of_the_recording_is_incomplete():
    forces = plates(LEFT, RIGHT).during(0.7, 4.0)
    left = find_plate_contacts(forces)["l"]
    assert left.strikes[0] == pytest.approx(0.7) and not left.complete[0] and not left.complete[-1]
    assert left.complete[1:-1].all() and left.stance == pytest.approx(STANCE, abs=0.03)


@pytest.mark.parametrize(
    ("left", "right", "known", "unknown"),
    [
        # One step on each plate: known from certain swing of the right foot until the left foot may strike.
        (LEFT[1:2], RIGHT[1:2], (2.0, 2.45), (2.7, 3.2)),
        (LEFT[1:2], RIGHT[1:2], (2.0, 2.45), (1.2, 1.7)),
        # The right foot first.
        (LEFT[1:2], RIGHT[0:1], (1.45, 1.85), (2.2, 4.0)),
        # All steps.
        (LEFT, RIGHT, (0.9, 4.5), (0.0, 0.2)),
        # One foot: the middle of its stance.
        (LEFT[1:2], None, (1.8, 2.1), (2.15, 5.0)),
        # A foot without a step on a plate.
        (LEFT[1:2], (), (1.8, 2.1), (2.15, 5.0)),
        # A step of the right foot was missed between two.
        (LEFT, RIGHT[[0, 2]], (1.05, 1.7), (2.2, 2.7)),
    ],
)
def test_all_contact_is_measured_where_both_feet_are_known(left, right, known, unknown):
    steps = [foot for foot in find_plate_contacts(plates(left, right)).values() if foot.strikes.size]
    complete = all_contact_measured(TIME, steps)
    assert complete[between(*known)].all()
    middle = np.zeros(TIME.size, bool)
    for foot in steps:
        middle |= foot.single_support(TIME)
    assert not (complete & ~middle)[between(*unknown)].any()


PLATES = {
    "all steps": (LEFT, RIGHT),
    "one step a plate": (LEFT[1:2], RIGHT[1:2]),
    "the right foot first": (LEFT[1:2], RIGHT[0:1]),
    "one foot": (LEFT[1:2], None),
    "one foot, all its steps": (LEFT, None),
    "a plate without a step": (LEFT[1:2], ()),
}


@pytest.mark.parametrize("steps", PLATES)
def test_consistent_forces_are_accepted(steps):
    assert faults(plates(*PLATES[steps])) == {"weight": "", "timing of forces": ""}


@pytest.mark.parametrize("late", [0.05, -0.05])
@pytest.mark.parametrize("steps", PLATES)
def test_a_shift_of_50_ms_is_reported(steps, late):
    fault = faults(plates(*PLATES[steps], late=late))["timing of forces"]
    assert ("ms late" if late > 0.0 else "ms early") in fault


@pytest.mark.parametrize("steps", PLATES)
@pytest.mark.parametrize("gain", [1e-3, 1.0 / 9.81, 1e3])
def test_a_wrong_unit_is_reported(steps, gain):
    assert faults(plates(*PLATES[steps], gain=gain))["weight"]


def test_half_the_gain_of_a_plate_is_reported():
    forces = plates(LEFT, RIGHT)
    forces.wrench[1] *= 0.5
    assert faults(forces)["weight"]


def test_downward_forces_are_reported():
    assert faults(plates(LEFT, RIGHT, gain=-1.0))["weight"]


def test_forces_without_measured_contact_are_not_compared():
    forces = plates(LEFT[:1], RIGHT[2:3])
    time = np.arange(2.0, 2.6, 0.01)
    (check,) = check_forces_against_motion(time, required_force(time), forces)
    assert "not compared" in check.found and not check.fault


def foot_fault(forces, *cycles):
    (check,) = check_foot_on_plates(forces, "l", cycles)
    return check.fault, check.hint


def test_unmeasured_steps_of_the_leg_are_reported():
    cycle, long = (LEFT[1], LEFT[2]), (LEFT[0], LEFT[2])
    assert foot_fault(plates(LEFT[1:2]), cycle) == ("", "")
    assert foot_fault(plates(LEFT), cycle, (0.9, 2.0)) == ("", "")
    missed, hint = foot_fault(plates(LEFT[[0, 2]]), long)
    assert "off them for 1.5" in missed and "from 0.5 to 2.7 s" in missed and "list as cycles only" in hint
    assert foot_fault(plates(LEFT[:1]), cycle)[0] and foot_fault(plates(()), cycle)[0]
    assert "upward" in foot_fault(plates(LEFT, gain=-1.0), cycle)[1]
