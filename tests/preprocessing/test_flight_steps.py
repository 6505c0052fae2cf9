"""Steps of running: assigned by place, wherever they tread; cycles with a step of each foot."""

import numpy as np
import pytest

from wrapjax.preprocessing.gait.flight_steps import (
    assign_steps,
    find_flight_contacts,
    flight_cycles,
    forces_of_steps,
    is_flight,
    stride_time,
)
from wrapjax.preprocessing.gait.force_plates import FootForces

#: Duration of a stance and of a flight, s.
STANCE, FLIGHT = 0.26, 0.12
STEPS = 12
TIME = np.arange(0.0, 0.3 + STEPS * (STANCE + FLIGHT), 0.01)
PEAK = 1500.0


def strike(number):
    return 0.2 + number * (STANCE + FLIGHT)


def side_of(number):
    return "lr"[number % 2]


def walker_feet():
    """Positions of the heels: the foot of a step is under the body, the other one behind and above it."""
    feet = {"l": np.zeros((3, TIME.size)), "r": np.zeros((3, TIME.size))}
    for side, lateral in (("l", -0.06), ("r", 0.06)):
        feet[side][:] = np.array([-0.4, 0.3, lateral])[:, None]
    for number in range(STEPS):
        inside = (strike(number) - 0.02 <= TIME) & (strike(number) + STANCE + 0.02 >= TIME)
        lateral = -0.06 if side_of(number) == "l" else 0.06
        feet[side_of(number)][:, inside] = np.array([-0.1, 0.05, lateral])[:, None]
    return feet


def running(shares=None, missing=()):
    """Forces on the plates labelled l and r; ``shares`` is the part of a step that the other plate bears."""
    wrench = np.zeros((2, 6, TIME.size))
    for number in range(STEPS):
        if number in missing:
            continue
        phase = (TIME - strike(number)) / STANCE
        force = np.where((phase > 0.0) & (phase < 1.0), PEAK * np.sin(np.pi * np.clip(phase, 0.0, 1.0)), 0.0)
        lateral = -0.06 if side_of(number) == "l" else 0.06
        own = "lr".index(side_of(number))
        other = (shares or {}).get(number, 0.0)
        for row, share in ((own, 1.0 - other), (1 - own, other)):
            wrench[row, 4] += share * force
            wrench[row, 0] += -lateral * share * force
    return FootForces(("l", "r"), TIME, wrench)


def assigned(forces, stated=None):
    contacts = find_flight_contacts(forces)
    return assign_steps(forces, contacts, TIME, walker_feet(), stated or {})


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_step_belongs_to_the_nearest_foot_wherever_it_treads(share):
    forces = running({4: share, 7: share})
    steps = assigned(forces)
    assert "".join(step.side for step in steps) == "lr" * (STEPS // 2)
    found = forces_of_steps(forces, steps)
    np.testing.assert_allclose(found.wrench, running().wrench, atol=1e-9)
    assert sum(step.other_share > 0.05 for step in steps) == (2 if share else 0)


def test_a_person_can_state_the_foot_of_a_step():
    steps = assigned(running(), {"r": [(strike(2) - 0.05, strike(2) + STANCE)]})
    assert [step.side for step in steps][:4] == ["l", "r", "r", "r"]


def test_landing_on_both_feet_is_no_step_of_one():
    forces = running()
    inside = (strike(5) < TIME) & (strike(5) + STANCE > TIME)
    both = forces.wrench.copy()
    both[:, 4, inside] = 800.0
    both[0, 0, inside], both[1, 0, inside] = 0.06 * 800.0, -0.06 * 800.0
    feet = walker_feet()
    for side, lateral in (("l", -0.06), ("r", 0.06)):
        feet[side][:, inside] = np.array([-0.1, 0.05, lateral])[:, None]
    landing = FootForces(("l", "r"), TIME, both)
    steps = assign_steps(landing, find_flight_contacts(landing), TIME, feet, {})
    assert steps[5].side == ""
    cycles, dropped = flight_cycles(steps, "l", 0.0, TIME[-1])
    assert len(cycles) == 4 and "contact of both feet" in dropped[0]


def test_cycles_have_one_step_of_each_foot():
    cycles, dropped = flight_cycles(assigned(running()), "r", 0.0, TIME[-1])
    assert len(cycles) == STEPS // 2 - 1 and not dropped
    np.testing.assert_allclose([start for start, _ in cycles], strike(np.arange(1, STEPS - 2, 2)), atol=0.011)
    cycles, dropped = flight_cycles(assigned(running(missing=(6,))), "r", 0.0, TIME[-1])
    assert len(cycles) == STEPS // 2 - 2
    assert len(dropped) == 1 and "found 0 steps" in dropped[0] and "left foot" in dropped[0]


def test_walking_has_no_flight():
    forces = running()
    walking = FootForces(("l", "r"), TIME, forces.wrench + 0.0)
    walking.wrench[0, 4] += 400.0
    assert find_flight_contacts(walking) == ()
    one = FootForces(("r",), TIME, forces.wrench[1:])
    assert find_flight_contacts(one) == ()


def test_a_gap_in_which_the_body_is_supported_is_no_flight():
    contacts = find_flight_contacts(running())
    assert stride_time(contacts) == pytest.approx(2.0 * (STANCE + FLIGHT), abs=0.02)
    assert is_flight(TIME, np.full(TIME.size, 20.0), contacts, 600.0)
    assert not is_flight(TIME, np.full(TIME.size, 600.0), contacts, 600.0)
