"""Scores of synthetic answerers: perfect, guessing, tying, silent and overconfident."""

import json
import shutil

import numpy as np
import pytest

from tests.validation.synthetic_bank import ANSWERERS, NAMES, SPEEDS, answer, perfect, write_bank, write_table
from validation.blind.anatomy import COORDINATES
from validation.blind.case_selection import CaseSelection
from validation.blind.score.intervals import FAILED, MET, UNCLEAR, Figure, Target, share, verdict
from validation.blind.score.report import NotReady, as_json, as_markdown, score


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bank")
    return folder, write_bank(folder)


@pytest.fixture(scope="module")
def scored(bank, tmp_path_factory):
    folder, truths = bank
    answers, withheld = {}, {}
    for answerer in ANSWERERS:
        name = answerer.__name__
        answers[name] = tmp_path_factory.mktemp(name)
        withheld[name] = tmp_path_factory.mktemp(f"{name}_withheld")
        for truth in truths:
            answer(answers[name], truth, answerer(truth))
            if truth["tier"] == "single":
                answer(withheld[name], truth, answerer(truth, withheld=True))
    return score(folder, answers, withheld)


def rows(scored, name):
    return {row.key: row for row in scored[name]["rows"]}


def values(scored, name):
    return {key: row.figure.value for key, row in rows(scored, name).items()}


def test_perfect_answerer(scored):
    found = values(scored, "perfect")
    assert found["first_clear"] == found["first_all"] == found["three_plain"] == found["precision"] == 1.0
    assert found["coverage"] == found["withheld"] == found["set_coverage"] == found["pair_both"] == 1.0
    assert found["false_alarms"] == found["wrong_outside"] == found["false_unknown"] == 0.0
    assert found["set_size"] == 1.0 and found["parameters"] == 0.0 and found["unknown_auroc"] == 1.0
    assert abs(found["calibration"]) < 1e-12
    table = scored["perfect"]["confusion"]
    assert all(set(row) == {family} for family, row in table.items() if family not in ("none", "outside"))
    assert set(table["outside"]) == {"(unknown)"}


def test_guessing_scores_at_chance(scored):
    found = values(scored, "guessing")
    assert found["first_strict"] < 0.15
    assert found["false_alarms"] == found["wrong_outside"] == 1.0
    assert abs(found["calibration"]) < 0.06  # its probabilities are uniform


def test_tie_of_all_effects_scores_zero_precision(scored):
    found = values(scored, "tying")
    assert found["precision"] == 0.0 and found["withheld"] == 0.0 and found["false_alarms"] == 1.0
    assert found["set_coverage"] == 1.0 and found["set_size"] == len(NAMES)
    assert rows(scored, "tying")["set_size"].verdict == FAILED


def test_silent_answerer_has_no_false_alarms_and_no_coverage(scored):
    found = values(scored, "silent")
    assert found["false_alarms"] == found["wrong_outside"] == found["coverage"] == found["first_all"] == 0.0
    assert found["withheld"] == 1.0 and found["precision"] is None
    assert found["calibration"] > 0.5  # it was certain of no effect
    assert rows(scored, "silent")["coverage"].verdict == FAILED


def test_overconfidence_is_miscalibrated(scored):
    found = values(scored, "confident")
    assert found["calibration"] > 0.7 and found["precision"] < 0.2 and found["false_alarms"] == 1.0
    assert rows(scored, "confident")["calibration"].verdict == FAILED


def test_tied_effects_are_correct(bank, tmp_path):
    """Check that naming a tied effect is correct, also with the cause withheld."""
    folder, truths = bank
    for truth in truths:
        content = perfect(truth)
        if truth["ties"]:
            (tie,) = truth["ties"]
            content = {**content, "named": [tie], "effects": [{"id": tie, "probability": 1.0}]}
        answer(tmp_path / "answers", truth, content)
        if truth["tier"] == "single":
            answer(tmp_path / "withheld", truth, content)
    result = score(folder, {"it": tmp_path / "answers"}, {"it": tmp_path / "withheld"})
    found = values(result, "it")
    tied = sum(bool(t["ties"]) for t in truths)
    singles = [t for t in truths if t["tier"] == "single"]
    assert found["first_clear"] == found["precision"] == 1.0 > found["first_strict"]
    assert found["withheld"] == pytest.approx(tied / len(singles))


def test_moments_shrinkage_and_map(bank, tmp_path):
    """Check moments 2 N m off before and 1 N m after, with a floor of 1: shrinkage (5 - 2)/(5 - 1)."""
    folder, truths = bank
    time = np.arange(0.5, 12.0, 0.005)
    for order, truth in enumerate(truths):
        content = perfect(truth)
        if order % 8 == 2 and truth["tier"] == "single":
            content["shrinkage"] = {
                k: {"estimate": 0.70, "ci95": [0.6, 0.8]} for k in ("held_out_cycles", "held_out_speed")
            }
            grid = [(c, p, v) for c in COORDINATES for p in range(0, 100, 5) for v in SPEEDS]
            keys = ("coordinate", "phase_percent", "speed_m_s", "explainable_rms_Nm")
            content["where"] = [
                dict(zip(keys, (c, [p, p + 5], v, 2 + 0.01 * p), strict=True)) for c, p, v in grid
            ]
        answer(tmp_path, truth, content)
        if order % 8 == 2 and truth["tier"] == "single":
            clean = np.load(folder / "truth" / f"{truth['id']}.npy")
            (tmp_path / truth["id"] / "moments").mkdir()
            for recording in range(3):
                at = np.array([np.interp(time, np.arange(1300) / 100, row) for row in clean[recording]])
                for use in ("calibration", "validation"):
                    columns = {"time": time}
                    for c, row in zip(COORDINATES, at, strict=True):
                        columns |= {f"{c}_moment_before": row - 2.0, f"{c}_moment_after": row - 1.0}
                    write_table(
                        tmp_path / truth["id"] / "moments" / f"walk_{recording + 1}_{use}.sto", columns
                    )
    found = rows(score(folder, {"it": tmp_path}), "it")
    assert found["shrinkage"].figure.value == pytest.approx(0.05, abs=0.01)
    assert found["shrinkage_intervals"].figure.value == 1.0
    assert found["map"].figure.n > 300 and found["map"].figure.value < 0.5  # the true map is constant


def test_scoring_requires_all_answers(bank, tmp_path):
    folder, truths = bank
    for truth in truths[1:]:
        answer(tmp_path, truth, perfect(truth))
    with pytest.raises(NotReady, match="1 cases are without an answer"):
        score(folder, {"it": tmp_path})


def test_first_cases_can_be_scored_alone(tmp_path):
    """Check the selection by id, which is a hash and so cannot be chosen."""
    truths = sorted(write_bank(tmp_path / "bank", single=4, other=2), key=lambda truth: truth["id"])
    for truth in truths[:5]:
        answer(tmp_path / "it", truth, perfect(truth))
    (tmp_path / "bank" / "truth" / f"{truths[6]['id']}.npy").unlink()  # not made yet
    assert (
        score(tmp_path / "bank", {"it": tmp_path / "it"}, selection=CaseSelection(first=5))["it"]["cases"]
        == 5
    )
    with pytest.raises(NotReady, match="is missing"):
        score(tmp_path / "bank", {"it": tmp_path / "it"})
    with pytest.raises(NotReady, match="without an answer"):
        score(tmp_path / "bank", {"it": tmp_path / "it"}, selection=CaseSelection(first=6))
    log = (tmp_path / "bank" / "score_log.jsonl").read_text().splitlines()
    assert json.loads(log[0])["cases"] == 5


def test_remaining_cases_can_be_scored_alone(tmp_path):
    truths = sorted(write_bank(tmp_path / "bank", single=4, other=2), key=lambda truth: truth["id"])
    manifest = tmp_path / "committed.json"
    manifest.write_text((tmp_path / "bank" / "manifest.json").read_text())
    for truth in truths[2:]:
        answer(tmp_path / "it", truth, perfect(truth))
    remaining = CaseSelection(after=truths[1]["id"])
    complete = score(tmp_path / "bank", {"it": tmp_path / "it"}, manifest=manifest, selection=remaining)["it"]
    for truth in truths[:2]:  # only the selected cases are present
        shutil.rmtree(tmp_path / "bank" / "cases" / truth["id"])
        for kind in ("json", "npy"):
            (tmp_path / "bank" / "truth" / f"{truth['id']}.{kind}").unlink()
    alone = score(tmp_path / "bank", {"it": tmp_path / "it"}, manifest=manifest, selection=remaining)["it"]
    assert complete["cases"] == alone["cases"] == len(truths) - 2 and complete["rows"] == alone["rows"]


@pytest.mark.parametrize("what", ["truth", "clean", "case", "extra"])
def test_changed_bank_is_rejected(tmp_path, what):
    truths = write_bank(tmp_path, single=2, other=1)
    name = truths[0]["id"]
    if what == "truth":
        path = tmp_path / "truth" / f"{name}.json"
        path.write_text(path.read_text().replace('"single"', '"none"'))
    elif what == "clean":
        np.save(tmp_path / "truth" / f"{name}.npy", np.zeros((3, 6, 1300), np.float32))
    elif what == "case":
        (tmp_path / "cases" / name / "hint.txt").write_text("tendon")
    else:
        (tmp_path / "truth" / "ffff.json").write_text("{}")
    with pytest.raises(NotReady, match="seal is broken"):
        score(tmp_path, {})


def test_runs_are_logged_and_formatted(scored, bank):
    log = [json.loads(line) for line in (bank[0] / "score_log.jsonl").read_text().splitlines()]
    assert {answerer.__name__ for answerer in ANSWERERS} in [set(one["answers"]) for one in log]
    assert "right cause first" in as_markdown(scored)
    assert json.loads(as_json(scored))["perfect"]["rows"][0]["verdict"] == MET


def test_bounds_are_wider_for_few_persons():
    hits = np.repeat([1, 1, 0, 1, 0, 1, 1, 1], 20)
    same, apart = np.repeat(np.arange(8), 20), np.arange(160)
    clustered, plain = share(hits, same), share(hits, apart)
    assert clustered.value == plain.value == 0.75
    assert clustered.lower < plain.lower - 0.1 and clustered.upper > plain.upper + 0.05
    # Three alarms of 120 by as many people: Clopper and Pearson, one-sided.
    assert share(np.arange(120) < 3, np.arange(120)).upper == pytest.approx(0.0635, abs=2e-3)


def test_verdicts():
    target = Target(least=0.7)
    assert verdict(Figure(0.8, 0.72, 0.9, 9), target) == MET
    assert verdict(Figure(0.8, 0.65, 0.9, 9), target) == UNCLEAR
    assert verdict(Figure(0.5, 0.40, 0.6, 9), target) == FAILED
    assert verdict(Figure(0.99, 0.97, 1.0, 9), Target(0.85, 0.95)) == FAILED
    assert verdict(Figure(None), target) == ""
