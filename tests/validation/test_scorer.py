"""The scorer says what is known of answerers: one knows all, others guess, tie, keep silent, are sure."""

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


def test_perfect(scored):
    found = values(scored, "perfect")
    assert found["first_clear"] == found["first_all"] == found["three_plain"] == found["precision"] == 1.0
    assert found["coverage"] == found["withheld"] == found["set_coverage"] == found["pair_both"] == 1.0
    assert found["false_alarms"] == found["wrong_outside"] == found["false_unknown"] == 0.0
    assert found["set_size"] == 1.0 and found["parameters"] == 0.0 and found["unknown_auroc"] == 1.0
    assert abs(found["calibration"]) < 1e-12
    table = scored["perfect"]["confusion"]
    assert all(set(row) == {family} for family, row in table.items() if family not in ("none", "outside"))
    assert set(table["outside"]) == {"(unknown)"}


def test_guessing_is_as_good_as_chance(scored):
    found = values(scored, "guessing")
    assert found["first_strict"] < 0.15
    assert found["false_alarms"] == found["wrong_outside"] == 1.0
    assert abs(found["calibration"]) < 0.06  # it never claimed to know


def test_tying_everything_earns_nothing(scored):
    found = values(scored, "tying")
    assert found["precision"] == 0.0 and found["withheld"] == 0.0 and found["false_alarms"] == 1.0
    assert found["set_coverage"] == 1.0 and found["set_size"] == len(NAMES)
    assert rows(scored, "tying")["set_size"].verdict == FAILED


def test_silence_is_safe_and_useless(scored):
    found = values(scored, "silent")
    assert found["false_alarms"] == found["wrong_outside"] == found["coverage"] == found["first_all"] == 0.0
    assert found["withheld"] == 1.0 and found["precision"] is None
    assert found["calibration"] > 0.5  # it was sure that there was nothing
    assert rows(scored, "silent")["coverage"].verdict == FAILED


def test_confidence_is_punished(scored):
    found = values(scored, "confident")
    assert found["calibration"] > 0.7 and found["precision"] < 0.2 and found["false_alarms"] == 1.0
    assert rows(scored, "confident")["calibration"].verdict == FAILED


def test_generators_ties_are_right_and_not_withheld_faults(bank, tmp_path):
    """Naming what the generator cannot tell from the cause is right, and no fault with the cause withheld."""
    folder, truths = bank
    for truth in truths:
        told = perfect(truth)
        if truth["ties"]:
            (tie,) = truth["ties"]
            told = {**told, "named": [tie], "effects": [{"id": tie, "probability": 1.0}]}
        answer(tmp_path / "answers", truth, told)
        if truth["tier"] == "single":
            answer(tmp_path / "withheld", truth, told)
    result = score(folder, {"it": tmp_path / "answers"}, {"it": tmp_path / "withheld"})
    found = values(result, "it")
    tied = sum(bool(t["ties"]) for t in truths)
    singles = [t for t in truths if t["tier"] == "single"]
    assert found["first_clear"] == found["precision"] == 1.0 > found["first_strict"]
    assert found["withheld"] == pytest.approx(tied / len(singles))


def test_moments_shrinkage_and_map(bank, tmp_path):
    """An answerer 2 N m off before and 1 N m after, at a floor of 1: the truth is (5 - 2)/(5 - 1)."""
    folder, truths = bank
    time = np.arange(0.5, 12.0, 0.005)
    for order, truth in enumerate(truths):
        told = perfect(truth)
        if order % 8 == 2 and truth["tier"] == "single":
            told["shrinkage"] = {
                k: {"estimate": 0.70, "ci95": [0.6, 0.8]} for k in ("held_out_cycles", "held_out_speed")
            }
            grid = [(c, p, v) for c in COORDINATES for p in range(0, 100, 5) for v in SPEEDS]
            keys = ("coordinate", "phase_percent", "speed_m_s", "explainable_rms_Nm")
            told["where"] = [
                dict(zip(keys, (c, [p, p + 5], v, 2 + 0.01 * p), strict=True)) for c, p, v in grid
            ]
        answer(tmp_path, truth, told)
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
    assert found["map"].figure.n > 300 and found["map"].figure.value < 0.5  # the truth is flat


def test_nothing_is_printed_before_all_is_answered(bank, tmp_path):
    folder, truths = bank
    for truth in truths[1:]:
        answer(tmp_path, truth, perfect(truth))
    with pytest.raises(NotReady, match="1 cases are without an answer"):
        score(folder, {"it": tmp_path})


def test_the_first_few_can_be_judged_while_the_others_stay_sealed(tmp_path):
    """By their ids, which are hashes: no choice is left to who asks."""
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


def test_what_was_left_can_be_judged_without_those_that_judged_before(tmp_path):
    truths = sorted(write_bank(tmp_path / "bank", single=4, other=2), key=lambda truth: truth["id"])
    manifest = tmp_path / "committed.json"
    manifest.write_text((tmp_path / "bank" / "manifest.json").read_text())
    for truth in truths[2:]:
        answer(tmp_path / "it", truth, perfect(truth))
    left = CaseSelection(after=truths[1]["id"])
    whole = score(tmp_path / "bank", {"it": tmp_path / "it"}, manifest=manifest, selection=left)["it"]
    for truth in truths[:2]:  # only the selected cases are present
        shutil.rmtree(tmp_path / "bank" / "cases" / truth["id"])
        for kind in ("json", "npy"):
            (tmp_path / "bank" / "truth" / f"{truth['id']}.{kind}").unlink()
    alone = score(tmp_path / "bank", {"it": tmp_path / "it"}, manifest=manifest, selection=left)["it"]
    assert whole["cases"] == alone["cases"] == len(truths) - 2 and whole["rows"] == alone["rows"]


@pytest.mark.parametrize("what", ["truth", "clean", "case", "extra"])
def test_a_broken_seal_is_seen(tmp_path, what):
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


def test_runs_are_logged_and_results_are_text(scored, bank):
    log = (bank[0] / "score_log.jsonl").read_text().splitlines()
    assert set(json.loads(log[0])["answers"]) == {answerer.__name__ for answerer in ANSWERERS}
    assert "right cause first" in as_markdown(scored)
    assert json.loads(as_json(scored))["perfect"]["rows"][0]["verdict"] == MET


def test_shares_of_few_people_are_less_certain():
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
