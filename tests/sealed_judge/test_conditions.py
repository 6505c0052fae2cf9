"""Defends: pairs of conditions differ in the cause and in chance alone, and answers are judged by both."""

import json

import numpy as np
import pytest

from validation.diagnosis.condition_pairs import judged, table
from validation.sealed_judge.bank import make, plan, with_conditions
from wrapjax.io.storage import read_storage
from wrapjax.subject.conditions import load_conditions

#: Seed of a bank whose first case has a cause that a condition can have.
SEED = 2


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("banks")
    make(folder / "walking", 1, SEED, 1)
    with_conditions(folder / "walking", folder / "pairs", 1)
    return folder


@pytest.mark.slow
def test_one_person_walks_in_both_conditions(pair):
    case = pair / "pairs" / "cases" / "case001"
    whole = pair / "walking" / "cases" / "case001"
    for file in whole.rglob("*.*"):
        assert (case / "with" / file.relative_to(whole)).read_bytes() == file.read_bytes()
    assert (case / "with" / "model.osim").read_bytes() == (case / "without" / "model.osim").read_bytes()
    subject, names = load_conditions(case / "with", case / "without")
    assert names == ("with", "without")
    moments = [
        subject.trials.moments[np.array(subject.trials.conditions) == name].mean(axis=(0, 2))
        for name in names
    ]
    assert np.abs(moments[0] - moments[1]).max() < 0.15 * np.abs(subject.trials.moments).max()


@pytest.mark.slow
def test_units_of_emg_are_those_of_the_case(pair):
    """The largest envelope of the case is one, and the other condition's is near that."""
    case = pair / "pairs" / "cases" / "case001"
    largest = {
        name: np.max(
            [read_storage(file).values.max(axis=0) for file in (case / name).rglob("emg.sto")], axis=0
        )
        for name in ("with", "without")
    }
    np.testing.assert_allclose(largest["with"], 1.0, atol=0.05)
    assert (np.abs(np.log(largest["without"])) < np.log(2.5)).all()


@pytest.mark.slow
def test_the_manifest_lists_the_pairs(pair):
    manifest = json.loads((pair / "pairs" / "manifest.json").read_text())
    assert plan(1, SEED)[0]["tier"] == "single" and set(manifest["sha256"]) == {"case001"}


TRUTH = {"causes": [{"effect": "cop_offset"}], "d_star": 6.0}
ORDER = [("emg_drift", "with"), ("cop_offset", "without"), ("cop_offset", "with")]


def answer(outcome, *leading):
    listed = [{"id": id, "condition": condition} for id, condition in leading]
    return {
        "outcome": outcome,
        "named": listed if outcome == "named" else [],
        "ties": listed if outcome == "tie" else [],
        "effects": [{"id": id, "condition": condition} for id, condition in ORDER],
    }


def test_a_name_is_right_in_the_condition_that_has_the_cause():
    wrong, right = (
        judged(TRUTH, answer("named", ("cop_offset", condition))) for condition in ("without", "with")
    )
    assert (wrong.right, right.right, right.rank) == (False, True, 3)
    null = judged({"causes": [], "d_star": 0.0}, answer("tie", *ORDER[:2]))
    lines = table({"a": wrong, "b": right, "c": null})
    assert "| a | `cop_offset` (6.0) | named, `cop_offset without` | 3 | `emg_drift with` |" in lines
    assert "nothing amiss: a name or tie in 1 of 1" in lines
    assert "d* above 2: right first in 0 of 2, in the first three in 2" in lines
    assert "named: 1 right of 2" in lines
