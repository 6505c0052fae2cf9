"""Fit of constants to cases with known causes: calibrated probabilities and detection threshold."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from validation.diagnosis import temperature_scaling
from validation.diagnosis.bank_cases import SEALED
from validation.diagnosis.scored_cases import ScoredCase, ranking
from validation.diagnosis.temperature_scaling import (
    covering_level,
    fit_constants,
    main,
    negative_log_probability,
    read_constants,
)
from wrapjax.diagnosis.claims.decision import DecisionConstants, probabilities
from wrapjax.diagnosis.claims.gates import Adequate

#: Of six families.
EFFECTS = ("tendon_compliance", "slow_fibers", "joint_damping", "emg_drift", "cop_offset", "missing_drive")


@pytest.fixture(scope="module")
def cases():
    """Simulate scores of all tiers whose evidence is three times too large."""
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
        left = 1.4 ** (tier == "outside") * (0.8 + 0.05 * generator.normal())
        evidence = {id: 3.0 * one for id, one in true.items()}
        truth = {"tier": tier, "causes": causes, "ties": []}
        found.append(ScoredCase(truth, evidence, Adequate(left, 1.0)))
    return found


@pytest.fixture(scope="module")
def found(cases):
    return fit_constants(cases, replace(DecisionConstants.shipped(), least_detection_threshold=0.0))


def test_temperature_is_fitted(cases, found):
    start = DecisionConstants.shipped()
    # Evidence of 4 with a standard deviation of 1 corresponds to a log Bayes factor of a quarter of it.
    assert 0.5 < found.temperature < 1.2
    assert negative_log_probability(cases, found) < 0.7 * negative_log_probability(cases, start)
    # Unknown causes leave 1.12 times what is allowed, and 0.8 times is left without effect.
    assert found.adequacy_factor == 1.0 and found.unknown_scale < 0.2


def test_probabilities_are_calibrated(cases, found):
    said, right = [], []
    for one in cases:
        share = one.correct_probability(own := one.stated(found))
        if share is not None:
            every = {**own.effects, "none": own.none, "unknown": own.unknown}
            said.append(max(every.values()))
            right.append(np.isclose(share, max(every.values())))
    assert abs(np.mean(said) - np.mean(right)) < 0.07


def test_threshold_is_rarely_exceeded_without_effect(cases, found):
    nothing = [max(one.evidence.values()) for one in cases if one.truth["tier"] == "none"]
    assert np.sum(np.array(nothing) > found.least_detection_threshold) == 1


def test_one_in_twenty_without_effect_leaves_more_than_is_allowed(cases):
    """And the same constant decides between no effect and an unknown cause."""
    worse = [replace(one, plain=Adequate(2.0 * one.plain.left_rms, 1.0)) for one in cases]
    found = fit_constants(worse, DecisionConstants.shipped())
    nothing = [one for one in worse if one.truth["tier"] == "none"]
    beyond = [one.error_left(found.adequacy_factor) > 1.0 for one in nothing]
    assert found.adequacy_factor > 1.0 and 0.0 < np.mean(beyond) <= 0.06
    for one, inadequate in zip(nothing, beyond, strict=True):
        stated = one.stated(found)
        assert (stated.unknown > stated.none) == inadequate


@pytest.mark.slow
def test_threshold_is_that_of_the_worst_family(cases):
    """Check that larger null evidence in one family determines the threshold."""
    families = [
        replace(
            one,
            truth={**one.truth, "world": ("quiet", "loud")[number % 2]},
            evidence={id: (1.0 + number % 2) * value for id, value in one.evidence.items()},
        )
        for number, one in enumerate(cases)
    ]
    loud = [one for one in families if one.truth["world"] == "loud"]
    start = DecisionConstants.shipped()
    assert (
        fit_constants(families, start).least_detection_threshold
        == fit_constants(loud, start).least_detection_threshold
    )


def test_credible_sets_cover_cases_that_the_level_was_not_fitted_on(cases):
    fitted, others = cases[::2], cases[1::2]
    constants = fit_constants(fitted, DecisionConstants.shipped())
    covered = [
        level < constants.set_level
        for one in others
        if (level := one.set_level(one.stated(constants))) is not None
    ]
    assert 0.8 <= np.mean(covered) < 1.0
    families = [
        level < constants.family_level
        for one in others
        if (level := one.family_level(one.stated(constants))) is not None
    ]
    assert 0.8 <= np.mean(families) < 1.0


def test_sets_of_families_are_for_the_cause_or_its_family():
    evidence = dict.fromkeys(EFFECTS, -5.0) | {"emg_drift": 6.0, "emg_offset": 5.9, "cop_offset": 5.0}
    constants = replace(DecisionConstants.shipped(), temperature=1.0, offset=0.0)
    own = probabilities(evidence, 0.0, constants)

    def level(tier, *causes):
        truth = {"tier": tier, "causes": [{"id": id} for id in causes], "ties": []}
        return ScoredCase(truth, evidence).family_level(own)

    assert level("single", "emg_offset") == 0.0
    assert level("single", "cop_offset") == pytest.approx(
        own.effects["emg_drift"] + own.effects["emg_offset"]
    )
    assert level("none") == pytest.approx(1.0, abs=0.01) and level("pair", "emg_drift", "cop_offset") is None
    assert level("single", "a_mechanism_without_name") is None


def test_a_level_without_enough_cases_is_one():
    assert covering_level([0.1, None, 0.2, 0.3]) == 1.0
    assert covering_level([0.1] * 20 + [0.9]) == pytest.approx(0.11)


def test_sets_cover_the_world_in_which_they_have_to_be_largest(cases):
    """In one world the correct effects have little evidence."""
    hard = [
        replace(one, truth={**one.truth, "world": "hard"}, evidence={id: -one.evidence[id] for id in EFFECTS})
        for one in cases[:20]
    ]
    easy = [replace(one, truth={**one.truth, "world": "easy"}) for one in cases[20:]]
    found = fit_constants([*hard, *easy], DecisionConstants.shipped())
    levels = [level for one in hard if (level := one.set_level(one.stated(found))) is not None]
    assert np.mean([level < found.set_level for level in levels]) >= 0.9
    assert covering_level([one.set_level(one.stated(found)) for one in [*hard, *easy]]) < found.set_level


def test_tied_effects_are_correct():
    truth = {"tier": "single", "causes": [{"id": "tendon_compliance"}], "ties": ["slow_fibers"]}
    evidence = {"tendon_compliance": 3.0, "slow_fibers": 3.0, "joint_damping": -10.0}
    one = ScoredCase(truth, evidence)
    own = probabilities(evidence, 0.0, DecisionConstants.shipped())
    assert one.correct_probability(own) == pytest.approx(
        own.effects["tendon_compliance"] + own.effects["slow_fibers"]
    )
    assert ScoredCase({**truth, "tier": "pair"}, evidence).correct_probability(own) is None


def test_ranks_are_counted_by_noise():
    def case(noise, first, cause, d_star=4.0):
        truth = {
            "tier": "single",
            "causes": [{"id": cause}],
            "ties": [],
            "d_star": d_star,
            "emg_noise": noise,
        }
        evidence = {**dict.fromkeys(EFFECTS, 0.0), "emg_drift": -1.0, first: 2.0}
        return ScoredCase(truth, evidence)

    cases = [
        case(0.05, "slow_fibers", "slow_fibers"),
        case(0.05, "slow_fibers", "joint_damping"),
        case(0.2, "slow_fibers", "emg_drift"),
    ]
    # Not identifiable: not counted.
    cases.append(case(0.2, "slow_fibers", "slow_fibers", d_star=1.0))
    assert ranking(cases) == "first 1 of 3 (EMG noise: 1 of 2 at 5%, 0 of 1 at 20%), among three 2"


def test_command_writes_constants_that_it_reads(cases, tmp_path, capsys, monkeypatch):
    """Check that only the fitted constants and the hash of the bank change."""
    truth = {"d_star": 4.0, "emg_noise": 0.1}
    for one in cases:
        one.truth.update(truth)
    monkeypatch.setattr(temperature_scaling, "score_cases", lambda bank, lines, workers: cases)
    (tmp_path / "manifest.json").write_text("{}", encoding="utf-8")
    out = tmp_path / "constants.json"
    assert _run(monkeypatch, tmp_path, "--out", str(out)) == 0
    output = capsys.readouterr().out
    assert output.startswith("right cause first") and "fitted: temperature" in output
    found, shipped = read_constants(out), DecisionConstants.shipped()
    assert found.bank == shipped.bank
    assert found.sha256 != shipped.sha256 and found.temperature != shipped.temperature
    assert _run(monkeypatch, tmp_path, "--constants", str(out)) == 0
    assert f"given: temperature {found.temperature:g}" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"temperature": 1}'])
def test_other_files_are_rejected(text, tmp_path, capsys, monkeypatch):
    file = tmp_path / "constants.json"
    file.write_text(text, encoding="utf-8")
    assert _run(monkeypatch, tmp_path, "--constants", str(file)) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_cases_of_test_banks_are_rejected(tmp_path, capsys, monkeypatch):
    manifest = json.loads((SEALED / "test_240.json").read_text(encoding="utf-8"))
    (tmp_path / f"{min(manifest['cases'])}.npz").touch()
    assert _run(monkeypatch, tmp_path) == 2
    assert "expected a case of a development bank" in capsys.readouterr().err


def test_missing_linearized_cases_are_an_input_error(tmp_path, capsys, monkeypatch):
    assert _run(monkeypatch, tmp_path) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_invalid_linearized_case_is_an_input_error(tmp_path, capsys, monkeypatch):
    (tmp_path / "0123.npz").write_bytes(b"no archive")
    assert _run(monkeypatch, tmp_path) == 2
    assert "0123" in capsys.readouterr().err


def _run(monkeypatch, folder, *more):
    monkeypatch.setattr(
        sys, "argv", ["temperature_scaling", "--bank", str(folder), "--lines", str(folder), *more]
    )
    return main()
