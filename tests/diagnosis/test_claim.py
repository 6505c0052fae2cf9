"""What remains of a claim that fails a gate; families."""

from dataclasses import replace

import pytest

from wrapjax.diagnosis.claims.claim import apply_gates, claimed_effects, with_family
from wrapjax.diagnosis.claims.decision import Decision, Probabilities, credible_families
from wrapjax.diagnosis.claims.gates import Adequate, Gates, Plausible, Specific, Stable
from wrapjax.diagnosis.effects.catalogue import (
    CATALOGUE,
    family_members,
    family_of,
    family_probabilities,
    same_family,
)
from wrapjax.diagnosis.effects.effect import FAMILIES

GOOD = Gates(
    Adequate(1.0, 2.0),
    Plausible("cop_offset anterior_m", 0.01, 0.05),
    Stable(1.0, {"odd cycles": "cop_offset", "even cycles": "cop_offset"}),
    Specific(0.5, 0.2),
)
NAMED = Decision("named", "one effect explains the error best", named=("cop_offset",))


def disagreeing(*others):
    return replace(GOOD, stable=Stable(0.5, {"first half": "cop_offset", **{id: id for id in others}}))


def test_a_claim_that_passes_all_gates_stays():
    decision = apply_gates(NAMED, GOOD, ["cop_offset"])
    assert decision == replace(NAMED, gates=GOOD)
    assert GOOD.failed == ()


@pytest.mark.parametrize(
    "gates",
    [
        replace(GOOD, adequate=Adequate(3.0, 2.0)),
        replace(GOOD, plausible=Plausible("cop_offset anterior_m", -0.05, 0.05)),
        replace(GOOD, specific=Specific(0.5, 0.6)),
        disagreeing("joint_damping", "emg_drift", "tendon_compliance"),
    ],
    ids=["adequate", "plausible", "specific", "stable"],
)
def test_a_failed_gate_leaves_no_name(gates):
    decision = apply_gates(NAMED, gates, ["cop_offset"])
    assert decision.outcome == "unknown" and not decision.accepted
    assert decision.best_partial == ("cop_offset",)
    assert "cop_offset" in decision.reason or "parts of the recording" in decision.reason


def test_an_implausible_size_is_given_with_its_unit():
    gates = replace(GOOD, plausible=Plausible("cop_offset anterior", -0.06, 0.05, "m"))
    reason = apply_gates(NAMED, gates, ["cop_offset"]).reason
    assert reason == "cop_offset: anterior would have to be -0.06 m; up to 0.05 m is plausible"


def test_parts_that_disagree_within_a_family_leave_the_family():
    decision = apply_gates(NAMED, disagreeing("force_latency"), ["cop_offset"])
    assert (decision.outcome, decision.family, decision.named) == ("family", "measured_force", ())


def test_few_parts_that_disagree_leave_a_tie():
    decision = apply_gates(NAMED, disagreeing("joint_damping"), ["cop_offset"])
    assert decision.outcome == "tie" and decision.tie == ("cop_offset", "joint_damping")


def test_nothing_amiss_is_said_only_of_an_adequate_model():
    none = Decision("none", "no effect has more evidence than null replicates show")
    assert apply_gates(none, Gates(Adequate(1.0, 2.0)), []).outcome == "none"
    assert apply_gates(none, Gates(Adequate(3.0, 2.0)), []).outcome == "unknown"


def test_a_family_is_claimed_where_its_members_share_the_probability():
    shares = Probabilities({"cop_offset": 0.4, "force_latency": 0.35, "joint_damping": 0.1}, 0.1, 0.05)
    undecided = Decision("none", "no effect has more evidence", probabilities=shares)
    evidence = {"cop_offset": 9.0, "force_latency": 8.7, "joint_damping": 6.0}
    decision = with_family(undecided, evidence, 5.0)
    assert (decision.outcome, decision.family) == ("family", "measured_force")
    assert claimed_effects(decision, evidence) == (("cop_offset",), ("cop_offset", "force_latency"))
    assert with_family(undecided, evidence, 10.0).outcome == "none"
    reasoned = replace(undecided, outcome="unknown")
    assert with_family(reasoned, evidence, 5.0) == reasoned
    assert with_family(replace(NAMED, probabilities=shares), evidence, 5.0).outcome == "named"


def test_every_effect_that_can_be_named_has_one_family():
    members = [id for family in FAMILIES for id in family_members(family)]
    assert len(members) == len(set(members))
    assert set(members) == {id for id, one in CATALOGUE.items() if not one.nuisance}
    assert all(id in family_members(family_of(id)) for id in members)
    with pytest.raises(KeyError):
        family_members("measurement")


def test_family_probabilities_and_sets():
    effects = {"cop_offset": 0.3, "force_latency": 0.3, "joint_damping": 0.2}
    assert family_probabilities(effects) == pytest.approx({"measured_force": 0.6, "passive": 0.2})
    found = Probabilities(effects, 0.15, 0.05)
    assert set(credible_families(found, 0.9)) == {"measured_force", "passive", "none_of_these"}
    assert credible_families(found, 0.55) == ("measured_force",)
    assert same_family(["cop_offset", "force_latency"]) and not same_family(["cop_offset", "joint_damping"])
