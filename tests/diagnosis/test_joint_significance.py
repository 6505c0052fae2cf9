"""Effects are jointly significant where each is significant beside the others, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from wrapjax.diagnosis.claims.decision import Decision, each_effect_improves, may_name_jointly
from wrapjax.diagnosis.evidence.linearization import Candidate
from wrapjax.diagnosis.evidence.score import jointly_significant_effects
from wrapjax.diagnosis.evidence.score_test import project, score_projected
from wrapjax.diagnosis.null_hypotheses.null_covariance import Null

ROWS, THRESHOLD = 60, 4.5


def directions(count, seed=3):
    """Orthogonal signatures of length one."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(ROWS, count)))[0].T


def effect(name, *signatures):
    return Candidate(
        name, (np.array(signatures),), np.full(len(signatures), 5.0), np.zeros(len(signatures), bool)
    )


def found(residual, candidates, scales=(1.0, 1.5)):
    """Jointly significant effects, and the evidence of each alone."""
    seen = [project(residual[None], Null(scale * np.eye(ROWS)), candidates) for scale in scales]
    (scored,) = score_projected(seen, candidates)
    scores = {one.id: one for one in sorted(scored.scores, key=lambda one: -one.evidence)}
    return jointly_significant_effects(seen, candidates, scores, THRESHOLD), {
        id: one.evidence for id, one in scores.items()
    }


def other_effects():
    return [effect(f"other_{place}", row) for place, row in enumerate(directions(9)[5:])]


def test_two_causes_are_found_the_stronger_first():
    a, b, *_ = directions(9)
    together, _ = found(6.0 * a + 8.0 * b, [effect("a", a), effect("b", b), *other_effects()])
    assert together == ("b", "a")


def test_three_causes_are_found():
    a, b, c, *_ = directions(9)
    together, _ = found(
        9.0 * a + 8.0 * b + 7.0 * c, [effect("a", a), effect("b", b), effect("c", c), *other_effects()]
    )
    assert together == ("a", "b", "c")


def test_an_effect_beyond_its_limit_is_not_significant_beside_another():
    a, b, *_ = directions(9)
    held = replace(effect("b", b), limit=0.5)
    candidates = [effect("a", a), held, *other_effects()]
    assert found(9.0 * a + 8.0 * b, candidates)[0] == ()


def test_a_second_cause_needs_more_evidence_than_a_first():
    """It is selected among many pairs, so that the threshold of one effect is too low."""
    a, b, *_ = directions(9)
    candidates = [effect("a", a), effect("b", b), *other_effects()]
    together, alone = found(9.0 * a + 4.0 * b, candidates, (1.0,))
    assert alone["b"] > THRESHOLD and together == ()
    assert found(9.0 * a + 6.0 * b, candidates, (1.0,))[0] == ("a", "b")


@pytest.mark.parametrize("effect_size", [0.0, 8.0])
def test_one_cause_or_none_gives_no_joint_effects(effect_size):
    a, b, *_ = directions(9)
    together, _ = found(effect_size * a, [effect("a", a), effect("b", b), *other_effects()])
    assert together == ()


def test_an_effect_similar_to_a_cause_is_not_significant_beside_it():
    a, b, *_ = directions(9)
    like = np.cos(0.2) * a + np.sin(0.2) * b
    together, alone = found(8.0 * a, [effect("a", a), effect("like", like), *other_effects()])
    assert alone["like"] > THRESHOLD and together == ()


def test_a_mixture_that_is_strongest_alone_is_replaced_by_its_two_causes():
    """Forward selection would keep it, as it explains most alone."""
    a, b, c, *_ = directions(9)
    mixture = (a + b + 0.4 * c) / np.linalg.norm(a + b + 0.4 * c)
    candidates = [effect("mixture", mixture), effect("a", a), effect("b", b), *other_effects()]
    together, alone = found(9.0 * a + 9.0 * b, candidates)
    assert max(alone, key=alone.get) == "mixture" and set(together) == {"a", "b"}


@pytest.mark.parametrize("seed", [308, 337, 368])
def test_a_third_that_makes_one_of_two_unnecessary_is_not_added(seed):
    """Four partly similar effects: the third would be significant beside the two."""
    generator = np.random.default_rng(seed)
    mixtures = [generator.normal(size=4) for _ in range(4)]
    basis = directions(9)[:4]
    candidates = [
        effect(f"mixture_{place}", weights / np.linalg.norm(weights) @ basis)
        for place, weights in enumerate(mixtures)
    ]
    together, _ = found((generator.normal(size=4) * 9.0) @ basis, candidates)
    assert len(together) == 2


def test_causes_that_hide_each_other_are_found():
    """Each alone explains little of their difference, as both are nearly the same."""
    a, b, *_ = directions(9)
    near = np.cos(0.35) * a + np.sin(0.35) * b
    candidates = [effect("a", a), effect("near", near), *other_effects()]
    together, alone = found(20.0 * (near - a), candidates)
    assert max(alone.values()) < THRESHOLD and set(together) == {"a", "near"}


@pytest.mark.parametrize(
    ("verdict", "excluded", "may"),
    [
        (Decision("named", "", named=("a",)), (), True),
        (Decision("named", "", named=("c",)), (), False),
        (Decision("none", ""), (), True),
        (Decision("none", ""), ("b",), False),
        (Decision("unknown", ""), (), False),
        (Decision("tie", "", tie=("a", "c")), (), False),
    ],
)
def test_the_decision_on_single_effects_decides_whether_several_may_be_named(verdict, excluded, may):
    assert may_name_jointly(verdict, ("a", "b"), excluded) is may
    assert may_name_jointly(verdict, (), excluded) is False


def test_each_effect_has_to_improve_held_out_cycles_beside_the_other():
    both, one = [3.0, 2.0, 4.0, 1.0, 2.0], [1.0, 1.0, 1.0, 0.5, 1.0]
    gains = {("a", "b"): both, ("a",): one, ("b",): one}
    assert each_effect_improves(("a", "b"), gains)
    assert not each_effect_improves(("a", "b"), gains | {("b",): both})
    assert not each_effect_improves(("a", "b"), gains | {("a",): [4.0, 3.0, 1.0, 0.0, 0.0]})
    # Unseen cycles do not test the first effect: the second has to improve on the model without both.
    untested = gains | {("a",): ()}
    assert each_effect_improves(("a", "b"), untested | {("b",): both})
    assert not each_effect_improves(("a", "b"), untested | {("a", "b"): [-1.0, *both[1:-1], -2.0]})
