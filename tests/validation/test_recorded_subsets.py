"""Parts of untouched recordings, and contradictions between their diagnoses."""

import tomllib

import pytest

from validation.recorded import subsets
from validation.recorded.subsets import contradictions, parts_of, table, write_parts

SETTINGS = """[subject]
name = "someone"
[model]
coordinates = ["knee_angle_r", "ankle_angle_r"]   # a comment

[[trial]]
name = "slow"
use = "calibration"
speed_m_s = 0.5
cycles = [[0.0, 1.0], [1.0, 2.0],
          [2.0, 3.0]]

[[trial]]
name = "fast_1"
use = "calibration"
speed_m_s = 0.8
cycle = [0.0, 0.9]

[[trial]]
name = "fast_2"
use = "calibration"
speed_m_s = 0.8
cycle = [0.9, 1.8]

[[trial]]
name = "slow_unseen"
use = "validation"
speed_m_s = 0.5
cycle = [3.0, 4.0]
"""


@pytest.fixture(scope="module")
def parts():
    return {name: tomllib.loads(text) for name, text in parts_of(SETTINGS).items()}


def test_parts_are_halves_speeds_and_all_coordinates_but_one(parts):
    assert set(parts) == {
        *("all", "odd_cycles", "even_cycles", "speed_0.5", "speed_0.8"),
        *("without_knee_angle_r", "without_ankle_angle_r"),
    }
    assert parts["all"] == tomllib.loads(SETTINGS)


def test_halves_have_every_calibration_cycle_once_and_all_validation_cycles(parts):
    odd, even = (
        {trial["name"]: trial.get("cycles", trial.get("cycle")) for trial in parts[name]["trial"]}
        for name in ("odd_cycles", "even_cycles")
    )
    assert odd == {"slow": [[0.0, 1.0], [2.0, 3.0]], "fast_1": [0.0, 0.9], "slow_unseen": [3.0, 4.0]}
    assert even == {"slow": [[1.0, 2.0]], "fast_2": [0.9, 1.8], "slow_unseen": [3.0, 4.0]}


def test_a_speed_and_a_coordinate_are_selected(parts):
    assert [trial["name"] for trial in parts["speed_0.5"]["trial"]] == ["slow", "slow_unseen"]
    assert parts["without_knee_angle_r"]["model"]["coordinates"] == ["ankle_angle_r"]
    assert parts["without_knee_angle_r"]["trial"] == parts["all"]["trial"]


def test_parts_are_written_as_copies_of_the_subject_folder(tmp_path):
    person = tmp_path / "someone"
    person.mkdir()
    (person / "subject.toml").write_text(SETTINGS)
    (person / "model.osim").write_text("model")
    written = write_parts(person, tmp_path / "out")
    assert [part.name for part in written][:2] == ["someone.all", "someone.odd_cycles"]
    assert all((part / "model.osim").read_text() == "model" for part in written)


def test_a_folder_that_is_no_subject_is_refused(tmp_path, monkeypatch, capsys):
    nobody = tmp_path / "nobody"
    monkeypatch.setattr("sys.argv", ["subsets", "--subjects", str(nobody), "--out", str(tmp_path / "out")])
    assert subsets.main() == 2
    assert "nobody" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def gap(outcome, named=(), ties=(), family=""):
    effects = [{"id": id, "probability": 0.6} for id in named]
    return {"outcome": outcome, "named": list(named), "ties": ties, "family": family, "effects": effects}


def test_claims_contradict_each_other_where_they_share_no_effect_and_no_family():
    found = {
        "a.all": gap("named", ["emg_drift"]),
        "a.odd": gap("tie", ties=[["emg_offset", "slow_fibers"]]),
        "a.even": gap("named", ["cop_offset"]),
        "a.speed": gap("family", family="emg"),
        "a.without_knee": gap("unknown"),
        "b.all": gap("named", ["slow_fibers"]),
    }
    against = {frozenset(pair) for pair in contradictions(found)}
    assert against == {frozenset({"a.even", other}) for other in ("a.all", "a.odd", "a.speed")}
    text = table(found)
    assert "Contradicting pairs of parts: 3. Nothing named: 1 of 6." in text
    assert "| a | odd | tie | `emg_offset`, `slow_fibers` |" in text
