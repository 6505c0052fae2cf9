"""Constants are chosen so that probabilities come true, and the alarm so that nothing sets it off."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from validation.diagnosis import temperature_scaling
from validation.diagnosis.bank_cases import SEALED
from validation.diagnosis.scored_cases import Scored, ranking
from validation.diagnosis.temperature_scaling import main, read_constants, surprise, tempered
from wrapjax.diagnosis.verdict import DecisionConstants, probabilities

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
    return tempered(cases, replace(DecisionConstants.shipped(), detection_threshold=0.0))


def test_boldness_is_found(cases, found):
    start = DecisionConstants.shipped()
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
    assert np.sum(np.array(nothing) > found.detection_threshold) == 1
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
    start = DecisionConstants.shipped()
    assert tempered(families, start).detection_threshold == tempered(loud, start).detection_threshold


def test_any_of_what_the_simulator_cannot_tell_apart_is_right():
    truth = {"tier": "single", "causes": [{"id": "effect_0"}], "ties": ["effect_1"]}
    evidence = {"effect_0": 3.0, "effect_1": 3.0, "effect_2": -10.0}
    one = Scored(truth, evidence, -50.0)
    own = probabilities(evidence, -50.0, DecisionConstants.shipped())
    assert one.right(own) == pytest.approx(own.effects["effect_0"] + own.effects["effect_1"])
    assert Scored({**truth, "tier": "pair"}, evidence, 0.0).right(own) is None


def test_ranks_are_counted_by_noise():
    def case(noise, first, cause, d_star=4.0):
        truth = {
            "tier": "single",
            "causes": [{"id": cause}],
            "ties": [],
            "d_star": d_star,
            "emg_noise": noise,
        }
        evidence = {**dict.fromkeys(EFFECTS, 0.0), "effect_3": -1.0, first: 2.0}
        return Scored(truth, evidence, 0.0)

    cases = [
        case(0.05, "effect_1", "effect_1"),
        case(0.05, "effect_1", "effect_2"),
        case(0.2, "effect_1", "effect_3"),
    ]
    # Too weak to be found by anyone: not counted.
    cases.append(case(0.2, "effect_1", "effect_1", d_star=1.0))
    assert ranking(cases) == "first 1 of 3 (EMG noise: 1 of 2 at 5%, 0 of 1 at 20%), among three 2"


def test_the_command_writes_constants_that_it_reads(cases, tmp_path, capsys, monkeypatch):
    """Cases as the lines give them; only what is tempered changes, and which bank said so."""
    truth = {"d_star": 4.0, "emg_noise": 0.1}
    for one in cases:
        one.truth.update(truth)
    monkeypatch.setattr(temperature_scaling, "read", lambda bank, lines: cases)
    (tmp_path / "manifest.json").write_text("{}", encoding="utf-8")
    out = tmp_path / "constants.json"
    assert _run(monkeypatch, tmp_path, "--out", str(out)) == 0
    told = capsys.readouterr().out
    assert told.startswith("right cause first") and "tempered: temperature" in told
    found, shipped = read_constants(out), DecisionConstants.shipped()
    assert (found.bank, found.set_level) == (shipped.bank, shipped.set_level)
    assert found.sha256 != shipped.sha256 and found.temperature != shipped.temperature
    assert _run(monkeypatch, tmp_path, "--constants", str(out)) == 0
    assert f"given: temperature {found.temperature:g}" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"temperature": 1}'])
def test_other_files_are_no_constants(text, tmp_path, capsys, monkeypatch):
    file = tmp_path / "constants.json"
    file.write_text(text, encoding="utf-8")
    assert _run(monkeypatch, tmp_path, "--constants", str(file)) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_sealed_cases_teach_nothing(tmp_path, capsys, monkeypatch):
    manifest = json.loads((SEALED / "test_240.json").read_text(encoding="utf-8"))
    (tmp_path / f"{min(manifest['cases'])}.npz").touch()
    assert _run(monkeypatch, tmp_path) == 2
    assert "expected a case of a development bank" in capsys.readouterr().err


def test_without_lines_there_is_nothing_to_temper(tmp_path, capsys, monkeypatch):
    assert _run(monkeypatch, tmp_path) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_lines_without_truth_are_refused(tmp_path, capsys, monkeypatch):
    (tmp_path / "0123.npz").write_bytes(b"no archive")
    assert _run(monkeypatch, tmp_path) == 2
    assert "0123" in capsys.readouterr().err


def _run(monkeypatch, folder, *more):
    monkeypatch.setattr(sys, "argv", ["tempering", "--bank", str(folder), "--lines", str(folder), *more])
    return main()
