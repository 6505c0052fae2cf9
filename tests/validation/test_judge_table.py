"""Figures of answers to a bank of the independent simulator."""

import json

import pytest

from validation.blind.score.figures import naming_rows
from validation.diagnosis.judge_table import describe, judged_cases, table
from wrapjax.errors import InputError

TRUTHS = {
    "case001": ("single", [{"effect": "force_latency", "family": "force"}], 6.0),
    "case002": ("none", [], 0.0),
    "case003": ("outside", [{"effect": "outside_swapped_leads", "family": "emg"}], 5.0),
    "case004": ("single", [{"effect": "emg_drift", "family": "emg"}], 3.0),
}
ANSWERS = {
    "case001": {"outcome": "named", "named": ["force_latency"]},
    "case002": {"outcome": "none", "named": []},
    "case003": {"outcome": "named", "named": ["emg_drift"]},
    "case004": {"outcome": "family", "named": [], "family": {"id": "emg", "probability": 0.6, "members": []}},
}


@pytest.fixture
def bank(tmp_path):
    (tmp_path / "truth").mkdir()
    for id, (tier, causes, d_star) in TRUTHS.items():
        truth = {"id": id, "person": "P1", "tier": tier, "causes": causes, "d_star": d_star}
        (tmp_path / "truth" / f"{id}.json").write_text(json.dumps(truth))
        effects = [
            {"id": "force_latency", "probability": 0.7 if id == "case001" else 0.1},
            {"id": "emg_drift", "probability": 0.2},
            {"id": "none", "probability": 0.1 if id == "case001" else 0.7},
        ]
        folder = tmp_path / "answers" / id
        folder.mkdir(parents=True)
        answer = {**ANSWERS[id], "effects": effects, "credible_set": ["force_latency"], "ties": []}
        (folder / "gap.json").write_text(json.dumps(answer))
    return tmp_path


def test_figures_count_names_families_and_ranks(bank):
    cases = judged_cases(bank, bank / "answers")
    found = {row.key: row.figure.value for row in naming_rows(cases)}
    assert found["precision"] == 1.0 and found["false_alarms"] == 0.0 and found["wrong_outside"] == 1.0
    assert found["right_or_family"] == 1.0 and found["coverage"] == 0.5
    assert found["first_clear"] == 1.0 and found["first_plain"] == 1.0
    assert "| a named cause is right, all | 1.00 |" in table(naming_rows(cases))
    assert describe(cases[3]).startswith("case004 single: emg_drift, d* 3.0; family emg; first emg_drift")


def test_an_unanswered_case_is_refused(bank):
    (bank / "answers" / "case003" / "gap.json").unlink()
    with pytest.raises(InputError, match="1 cases are not answered, case003 first"):
        judged_cases(bank, bank / "answers")
    assert [case.truth.id for case in judged_cases(bank, bank / "answers", 2)] == ["case001", "case002"]


def test_a_folder_without_truth_is_refused(tmp_path):
    with pytest.raises(InputError, match="no bank"):
        judged_cases(tmp_path, tmp_path)
