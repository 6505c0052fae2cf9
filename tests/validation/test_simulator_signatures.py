"""Ranking with the simulator's signatures in place of those of the catalogue."""

import json

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.blind.library import Library
from validation.diagnosis.linearizations import save
from validation.diagnosis.scored_cases import ScoredCase
from validation.diagnosis.simulator_signatures import main, null_evidence, score_both


def shape(seed):
    return np.random.default_rng(seed).normal(size=(CYCLES, PHASES, COORDINATES))


def library(**signals):
    columns = np.stack([signal.ravel() for signal in signals.values()], axis=1)
    return Library(tuple((name, ()) for name in signals), columns, np.ones((3, len(signals))))


def truth(tier):
    cause = {"bank": "development", "tier": tier, "person": "development_00", "emg_noise": 0.05, "ties": []}
    return cause | {"causes": [{"id": "known"}], "d_star": 9.0}


@pytest.fixture(scope="module")
def case():
    """Build a case whose signal resembles another effect of the catalogue than the true one."""
    return lines(3.0 * shape(2), {"known": shape(4), "other": shape(2) + shape(3)})


def test_true_signature_ranks_the_cause_first(case):
    catalogue, simulator = score_both(truth("single"), case, library(known=shape(2), other=shape(3)))
    assert list(catalogue.evidence) == list(simulator.evidence) == ["known", "other"]
    assert simulator.ranked[0] == "known" and simulator.evidence["known"] > 50.0
    # Random signatures of a few hundred numbers correlate slightly by chance.
    assert catalogue.evidence["known"] < 0.1 * simulator.evidence["known"]
    assert catalogue.ranked[0] == "other"


def test_null_evidence_is_of_cases_without_effect_only():
    nothing = [ScoredCase(truth("none"), {"a": one, "b": 2.0}) for one in (1.0, 3.0, 7.0)]
    (line,) = null_evidence([*nothing, ScoredCase(truth("single"), {"a": 99.0, "b": 99.0})])
    assert line.endswith("strongest 3.0 nats in the median; by effect a 3.0, b 2.0")
    assert null_evidence([]) == []


def test_command_prints_both_rankings(case, tmp_path, monkeypatch, capsys):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "a.json").write_text(json.dumps(truth("single")))
    save(case, tmp_path / "lines" / "a.npz")
    (tmp_path / "library").mkdir()
    library(known=shape(2)).save(tmp_path / "library" / "00.npz")
    arguments = ["simulator_signatures", "--bank", str(tmp_path), "--lines", str(tmp_path / "lines")]
    monkeypatch.setattr("sys.argv", arguments)
    assert main() == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("the catalogue's signatures: first 0 of 1")
    assert second.startswith("the simulator's signatures: first 1 of 1")
    (tmp_path / "library" / "00.npz").unlink()
    assert main() == 2 and "00.npz" in capsys.readouterr().err
