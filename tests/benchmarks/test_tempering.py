"""Constants are chosen so that probabilities come true, and the alarm so that nothing sets it off."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.tempering import Scored, surprise, tempered
from wrapjax.gap.conclude.verdict import Tuning, probabilities

EFFECTS = tuple(f"effect_{number}" for number in range(6))


@pytest.fixture(scope="module")
def cases():
    """What a score would say that is three times too bold; of nothing and of what is unknown as well."""
    generator = np.random.default_rng(5)
    found = []
    for number in range(200):
        tier = ("single", "single", "none", "outside", "pair")[number % 5]
        true = {id: float(generator.normal()) for id in EFFECTS}
        causes = []
        if tier == "single":
            cause = EFFECTS[number % 6]
            true[cause] += 4.0
            causes = [{"id": cause}]
        structured = 40.0 * (tier == "outside") + 5.0 * generator.normal()
        evidence = {id: 3.0 * one for id, one in true.items()}
        found.append(Scored({"tier": tier, "causes": causes, "ties": []}, evidence, structured))
    return found


@pytest.fixture(scope="module")
def found(cases):
    return tempered(cases, replace(Tuning.shipped(), alarm=0.0))


def test_boldness_is_found(cases, found):
    start = Tuning.shipped()
    # Evidence of 4 beside a deviation of 1 is worth its square's half for each nat: a quarter of it.
    assert 0.5 < found.temperature < 1.2
    assert surprise(cases, found) < 0.7 * surprise(cases, start)
    # What is unknown has 40 nats, nothing has none.
    assert found.structured_offset < 20.0 and found.structured_scale < 20.0


def test_probabilities_come_true(cases, found):
    said, right = [], []
    for one in cases:
        share = one.right(own := probabilities(one.evidence, one.structured, found))
        if share is not None:
            every = {**own.effects, "none": own.none, "unknown": own.unknown}
            said.append(max(every.values()))
            right.append(np.isclose(share, max(every.values())))
    assert abs(np.mean(said) - np.mean(right)) < 0.07


def test_the_alarm_is_rarely_reached_where_nothing_is_amiss(cases, found):
    nothing = [max(one.evidence.values()) for one in cases if one.truth["tier"] == "none"]
    assert np.sum(np.array(nothing) > found.alarm) == 1
    unknown = [one.structured > found.structured_offset for one in cases if one.truth["tier"] == "none"]
    assert np.mean(unknown) == pytest.approx(0.1)


def test_the_alarm_is_that_of_the_worst_family(cases):
    """Evidence where nothing is amiss is larger in one family: the other's quiet does not hide it."""
    families = [
        replace(
            one,
            truth={**one.truth, "world": ("quiet", "loud")[number % 2]},
            evidence={id: (1.0 + number % 2) * own for id, own in one.evidence.items()},
        )
        for number, one in enumerate(cases)
    ]
    loud = [one for one in families if one.truth["world"] == "loud"]
    start = Tuning.shipped()
    assert tempered(families, start).alarm == tempered(loud, start).alarm


def test_any_of_what_the_simulator_cannot_tell_apart_is_right():
    truth = {"tier": "single", "causes": [{"id": "effect_0"}], "ties": ["effect_1"]}
    evidence = {"effect_0": 3.0, "effect_1": 3.0, "effect_2": -10.0}
    one = Scored(truth, evidence, -50.0)
    own = probabilities(evidence, -50.0, Tuning.shipped())
    assert one.right(own) == pytest.approx(own.effects["effect_0"] + own.effects["effect_1"])
    assert Scored({**truth, "tier": "pair"}, evidence, 0.0).right(own) is None
