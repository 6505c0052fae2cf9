"""Decisions on the cases of a world by constants from the others."""

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import SHAPE, lines
from validation.diagnosis.left_out_worlds import ablations, decide_by_world, table
from validation.diagnosis.scored_cases import decision_on, score_case
from wrapjax.diagnosis.claims.decision import DecisionConstants
from wrapjax.diagnosis.claims.gates import Adequate, Plausible, Specific

CYCLES, COORDINATES, PHASES = SHAPE
PHASE = 2.0 * np.pi * np.arange(PHASES) / PHASES
WAVES = {
    id: np.broadcast_to(np.stack([first, second], axis=1), (CYCLES, PHASES, COORDINATES))
    for id, first, second in (
        ("cop_offset", np.sin(PHASE), 0 * PHASE),
        ("joint_damping", 0 * PHASE, np.cos(2 * PHASE)),
        ("emg_drift", np.cos(3 * PHASE), np.sin(3 * PHASE)),
    )
}
NONE = np.zeros((CYCLES, PHASES, COORDINATES))


def truth(world, cause=None, d_star=8.0, **more):
    tier = "none" if cause is None else "single"
    causes = [] if cause is None else [{"id": cause}]
    return {"world": world, "tier": tier, "causes": causes, "ties": [], "d_star": d_star, **more}


@pytest.fixture(scope="module")
def cases():
    found = []
    for number, world in enumerate(("one", "two", "three")):
        found.append(score_case(truth(world), lines(NONE, WAVES)))
        for cause in list(WAVES)[: number + 1]:
            found.append(score_case(truth(world, cause), lines(3.0 * WAVES[cause], WAVES)))
    return found


@pytest.mark.slow
def test_constants_come_from_the_other_worlds(cases):
    start = DecisionConstants.shipped()
    before = decide_by_world(cases, start)
    # Louder cases with nothing amiss raise the threshold of the other worlds alone.
    loud = [
        replace(one, evidence=dict.fromkeys(one.evidence, 1e5))
        if one.nothing_amiss and one.truth["world"] == "one"
        else one
        for one in cases
    ]
    after = decide_by_world(loud, start)

    def named(decided, world):
        return [one.named for one in decided[world] if one.case.truth["tier"] == "single"]

    assert named(after, "one") == named(before, "one") == [("cop_offset",)]
    assert named(after, "two") == [(), ()]


def test_a_strong_cause_is_named_and_the_table_counts_it(cases):
    decided = decide_by_world(cases, DecisionConstants.shipped())
    assert all(one.right for world in decided.values() for one in world if one.case.clear)
    (row,) = [line for line in table(decided).splitlines() if line.startswith("| two")]
    assert row.split("|")[3:8] == [" 2 of 2 ", " 2 of 2 ", " 2 of 2 ", " 0 of 0 ", " 2 of 2 "]
    assert "| 0 of 1 | 0 of 0 | 0 of 0 | 0 of 0 | 3 of 3 |" in row


def test_a_claim_that_fails_a_gate_is_not_named(cases):
    strong = next(one for one in cases if one.clear)
    constants = DecisionConstants.shipped()
    assert decision_on(strong, constants).outcome == "named"
    gates = replace(strong.claim.gates, adequate=Adequate(5.0, 1.0))
    inadequate = replace(strong, claim=replace(strong.claim, gates=gates))
    refused = decision_on(inadequate, constants)
    assert refused.outcome == "unknown"
    before, after = decision_on(strong, constants).probabilities, refused.probabilities
    cause = strong.ranked[0]
    assert before == strong.stated(constants) and before.effects[cause] > 0.9
    assert after == inadequate.stated(constants)
    assert after.effects[cause] == pytest.approx(after.none + after.unknown)
    assert max(after.effects, key=lambda id: after.effects[id]) == cause


def test_an_ignored_gate_is_passed_and_has_its_row(cases):
    strong = next(one for one in cases if one.clear)
    constants = DecisionConstants.shipped()
    bad = {
        "adequate": Adequate(5.0, 1.0),
        "plausible": Plausible("size", 2.0, 1.0),
        "specific": Specific(0, 1),
    }
    for name, gate in bad.items():
        gates = replace(strong.claim.gates, **{name: gate})
        failing = replace(strong, claim=replace(strong.claim, gates=gates))
        assert decision_on(failing, constants).outcome == "unknown"
        assert decision_on(failing, constants, [name]).outcome == "named"
    rows = ablations(cases, decide_by_world(cases, constants)).splitlines()[2:]
    assert [row.split("|")[1].strip() for row in rows] == [
        "complete",
        *(f"without the gate {name}" for name in ("adequate", "plausible", "stable", "specific")),
        "without gates",
        "constants from one world",
    ]


def test_constants_of_one_world_ignore_all_others(cases):
    """Those of world one come from two, whatever three has."""
    start = DecisionConstants.shipped()
    loud = [
        replace(one, evidence=dict.fromkeys(one.evidence, 1e5))
        if one.nothing_amiss and one.truth["world"] == "three"
        else one
        for one in cases
    ]

    def named(some, world):
        decided = decide_by_world(some, start, from_one_world=True)[world]
        return [one.named for one in decided if one.case.truth["tier"] == "single"]

    assert named(loud, "one") == named(cases, "one") and any(named(cases, "one"))
    assert named(loud, "two") == [(), ()] != named(cases, "two")


def test_a_detectable_background_is_scored_apart(cases):
    quiet = next(one for one in cases if one.nothing_amiss)
    other = replace(quiet, truth=truth("one", background={"d_star": 5.0}))
    assert not other.nothing_amiss
    assert replace(quiet, truth=truth("one", background={"d_star": 1.0})).nothing_amiss
