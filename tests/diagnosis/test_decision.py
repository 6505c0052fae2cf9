"""Probabilities, ties, credible sets and the decision on single effects."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrapjax.diagnosis.claims.decision import (
    OUTCOMES,
    TIE_DISTANCE,
    TIE_EVIDENCE,
    DecisionConstants,
    Probabilities,
    credible_set,
    decide_on_single_effect,
    describe_effect,
    probabilities,
    refused_evidence,
    tied_effects,
)

NAMES = ("one", "two", "three", "four")
TUNING = DecisionConstants("", "", 2.0, 6.0, 5.0, 0.1, 0.9, 0.9, 1.2)
nats = st.floats(-200.0, 1000.0)
errors = st.floats(0.0, 1e6)
evidences = st.dictionaries(st.sampled_from(NAMES), nats)


def found(none=0.0, unknown=0.0, **effects):
    return Probabilities(effects, none, unknown)


@settings(max_examples=100, deadline=None)
@given(evidence=evidences, error_left=errors)
def test_probabilities_sum_to_one(evidence, error_left):
    got = probabilities(evidence, error_left, TUNING)
    every = [*got.effects.values(), got.none, got.unknown]
    assert sum(every) == pytest.approx(1.0)
    assert min(every) >= 0.0
    assert set(got.effects) == set(evidence)


@settings(max_examples=100, deadline=None)
@given(
    evidence=st.dictionaries(st.sampled_from(NAMES), st.floats(-20, 20), min_size=1),
    error_left=st.floats(0.5, 2.0),
    more=st.floats(0.1, 20),
)
def test_probabilities_rise_with_their_evidence(evidence, error_left, more):
    before = probabilities(evidence, error_left, TUNING)
    for name in evidence:
        after = probabilities({**evidence, name: evidence[name] + more}, error_left, TUNING)
        assert after.effects[name] > before.effects[name]
        assert after.none < before.none
        assert all(after.effects[other] < before.effects[other] for other in evidence if other != name)
    stranger = probabilities(evidence, error_left * (1.0 + 0.1 * more), TUNING)
    assert stranger.unknown > before.unknown
    assert stranger.effects == pytest.approx(before.effects), (
        "an unknown cause reduces the probability of none only"
    )


def test_at_the_offset_an_effect_is_as_probable_as_none():
    got = probabilities({"one": TUNING.offset}, 1.0, TUNING)
    assert got.effects["one"] == pytest.approx(0.5)
    assert got.none == pytest.approx(0.25) == got.unknown
    bolder = probabilities({"one": TUNING.offset + 2.0 * TUNING.temperature}, 0.0, TUNING)
    assert bolder.effects["one"] / bolder.none == pytest.approx(np.exp(2.0))


def alike(*pairs):
    apart = np.full((4, 4), 10.0 * TIE_DISTANCE)
    for one, other in pairs:
        apart[NAMES.index(one), NAMES.index(other)] = apart[NAMES.index(other), NAMES.index(one)] = 1.0
    return apart


def test_every_pair_of_a_tie_is_indistinguishable():
    level = dict(zip(NAMES, (10.0, 9.0, 8.0, 7.0), strict=True))
    chain = alike(("one", "two"), ("two", "three"), ("three", "four"))
    assert tied_effects("one", NAMES, chain, level) == ("one", "two")
    ring = alike(("one", "two"), ("two", "three"), ("one", "three"))
    assert tied_effects("one", NAMES, ring, level) == ("one", "two", "three")
    assert tied_effects("one", NAMES, alike(), level) == ("one",)


def test_a_tie_needs_both_distances_small_and_similar_evidence():
    apart = alike(("one", "two"), ("one", "three"), ("two", "three"))
    apart[1, 0] = 10.0 * TIE_DISTANCE
    level = dict(zip(NAMES, (10.0, 9.0, 10.0 - TIE_EVIDENCE, 7.0), strict=True))
    assert tied_effects("one", NAMES, apart, level) == ("one", "three")
    level["three"] -= 0.1
    assert tied_effects("one", NAMES, apart, level) == ("one",)


def test_of_two_distinguishable_effects_the_stronger_joins_the_tie():
    level = dict(zip(NAMES, (10.0, 8.0, 9.0, 7.0), strict=True))
    apart = alike(("one", "two"), ("one", "three"))
    assert tied_effects("one", NAMES, apart, level) == ("one", "three")


def test_a_credible_set_contains_the_most_probable():
    got = found(one=0.5, two=0.3, three=0.05, none=0.1, unknown=0.05)
    assert credible_set(got, ("one",), 0.5) == ("one",)
    assert credible_set(got, ("one",), 0.7) == ("one", "two")
    assert credible_set(got, ("one",), 0.9) == ("one", "two", "none_of_these")
    assert credible_set(got, (), 0.97) == ("one", "two", "none_of_these", "three")
    silent = found(one=0.2, none=0.5, unknown=0.3)
    assert credible_set(silent, ("one",), 0.75) == ("none_of_these",)


def test_a_tie_enters_the_credible_set_as_a_whole():
    got = found(one=0.3, two=0.35, three=0.3, none=0.05)
    assert credible_set(got, ("one", "three"), 0.5) == ("one", "three")


@settings(max_examples=60, deadline=None)
@given(evidence=evidences, error_left=errors, level=st.floats(0.0, 0.999))
def test_a_credible_set_has_its_probability(evidence, error_left, level):
    got = probabilities(evidence, error_left, TUNING)
    members = credible_set(got, (), level)
    shares = {**got.effects, "none_of_these": got.none + got.unknown}
    assert sum(shares[name] for name in members) >= level - 1e-9
    assert len(set(members)) == len(members)


EVIDENCE = {"one": 20.0, "two": 18.0}


def test_each_outcome_follows_from_its_condition():
    clear = decide_on_single_effect(found(one=0.8, two=0.1, none=0.1), EVIDENCE, ("one",), 5.0, ())
    assert (clear.outcome, clear.named, clear.tie) == ("named", ("one",), ())
    tied = decide_on_single_effect(found(one=0.4, two=0.35, none=0.25), EVIDENCE, ("one", "two"), 5.0, ())
    assert (tied.outcome, tied.named, tied.tie) == ("tie", (), ("one", "two"))
    strange = decide_on_single_effect(
        found(one=0.2, two=0.1, none=0.2, unknown=0.5), EVIDENCE, ("one",), 5.0, ()
    )
    quiet = decide_on_single_effect(
        found(one=0.2, two=0.1, none=0.5, unknown=0.2), EVIDENCE, ("one",), 5.0, ()
    )
    empty = decide_on_single_effect(found(none=1.0), {}, (), 5.0, ())
    assert [one.outcome for one in (strange, quiet, empty)] == ["unknown", "none", "none"]
    for one in (clear, tied, strange, quiet, empty):
        assert one.outcome in OUTCOMES
        assert one.reason


def test_no_effect_is_named_below_the_detection_threshold():
    """Whatever its probability relative to other effects."""
    got = decide_on_single_effect(found(one=0.9, two=0.05, none=0.05), EVIDENCE, ("one",), 20.0, ())
    assert (got.outcome, got.named) == ("none", ())


def test_a_strongest_negative_control_means_an_unknown_cause():
    shares = found(one=0.9, two=0.05, none=0.05)
    got = decide_on_single_effect(shares, EVIDENCE, ("one",), 5.0, ("one",))
    assert (got.outcome, got.named, got.tie) == ("unknown", (), ())
    assert "one" in got.reason
    assert decide_on_single_effect(shares, EVIDENCE, ("one", "two"), 5.0, ("one",)).outcome == "unknown"
    assert decide_on_single_effect(shares, EVIDENCE, ("one",), 5.0, ("two",)).outcome == "named"
    assert decide_on_single_effect(shares, EVIDENCE, ("one",), 30.0, ("one",)).outcome == "none"


def test_the_description_of_an_effect_follows_its_detectability():
    assert "best" in describe_effect(20.0, 1.0, 5.0, named=True)
    assert "too weak" in describe_effect(4.0, 1.0, 5.0, named=False)
    assert "not named" in describe_effect(20.0, 1.0, 5.0, named=False), "larger than expected, so it shows"
    assert "not named" in describe_effect(20.0, 8.0, 5.0, named=False)
    assert "not named" in describe_effect(4.0, 1.0, 5.0, named=False, refused=True), "a claim was tested"
    assert "missed" in describe_effect(1.0, 3.0, 5.0, named=False)
    assert describe_effect(1.0, 8.0, 5.0, named=False) == "not seen; one of expected size would be"


def test_shipped_constants_are_usable():
    constants = DecisionConstants.shipped()
    assert constants.temperature >= 1.0, "evidence is scaled down, never up"
    assert constants.unknown_scale > 0.0
    assert 0.5 < constants.set_level < 1.0 and 0.5 < constants.family_level < 1.0
    assert constants.least_detection_threshold > 0.0
    silent = probabilities(dict.fromkeys(NAMES, 0.0), 0.9, constants)
    assert silent.none > 0.5, "without evidence, no effect is the most probable"


def test_an_undetectable_effect_is_not_named():
    found = Probabilities({"one": 0.9}, none=0.06, unknown=0.04)
    assert decide_on_single_effect(found, {"one": 20.0}, ("one",), 5.0, ()).outcome == "named"
    verdict = decide_on_single_effect(found, {"one": 20.0}, ("one",), 5.0, (), ("one",))
    assert verdict.outcome == "unknown" and "could not show" in verdict.reason and not verdict.named


def test_an_effect_that_does_not_improve_held_out_cycles_is_not_named():
    """One of five blocks can lose, two of eight; the sum must gain."""
    got = found(one=0.9, two=0.05, none=0.05)
    for gains, outcome in (
        ((1.0, 2.0, 0.5, 1.0, 3.0), "named"),
        ((1.0, 2.0, -0.5, 1.0, 3.0), "named"),
        ((1.0, 2.0, -0.5, 0.0, 3.0), "unknown"),
        ((1.0, 2.0, -0.5, -0.1, 3.0, 1.0, 1.0, 1.0), "named"),
        ((1.0, 2.0, -0.5, -0.1, 3.0, 1.0, 0.0, 1.0), "unknown"),
        ((0.1, 0.1, -3.0, 0.1, 0.1), "unknown"),
    ):
        verdict = decide_on_single_effect(
            got, EVIDENCE, ("one",), 5.0, (), (), {"one": gains, "two": (-1.0,) * 5}
        )
        assert verdict.outcome == outcome
    assert "held-out cycles" in verdict.reason
    assert (
        decide_on_single_effect(got, EVIDENCE, ("one",), 5.0, (), (), {"two": (-1.0,) * 5}).outcome == "named"
    )


def test_refused_evidence_is_limited_and_keeps_its_order():
    """However large the evidence, no effect is more probable than no effect and an unknown cause together."""
    evidence = {"a": 74.0, "b": 28.0, "c": 6.0, "d": 0.02, "e": -0.7}
    limited = refused_evidence(evidence, 5.0)
    assert list(sorted(limited, key=lambda id: -limited[id])) == list(evidence)
    assert all(value < 5.0 for value in limited.values())
    assert limited["d"] == pytest.approx(0.02, rel=0.01) and limited["e"] == -0.7
    shares = probabilities(limited, 1.0, TUNING)
    assert shares.none + shares.unknown > max(shares.effects.values())
    assert max(refused_evidence(evidence, -1.0).values()) < 1e-8
