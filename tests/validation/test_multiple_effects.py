"""Number of cases with several significant effects, for two, one or no true causes."""

import json
import sys

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.diagnosis.linearizations import save
from validation.diagnosis.multiple_effects import main


@pytest.fixture
def bank(tmp_path):
    """Write three linearized cases of a development bank with clearly distinct effects."""
    generator = np.random.default_rng(5)
    signatures = {name: generator.normal(size=(CYCLES, PHASES, COORDINATES)) for name in "abcd"}
    for folder in ("truth", "lines"):
        (tmp_path / folder).mkdir()
    for case, causes in {"none": "", "single": "a", "pair": "bc"}.items():
        signal = sum((3.0 * signatures[name] for name in causes), start=0.0 * signatures["a"])
        save(lines(signal, signatures), tmp_path / "lines" / f"{case}.npz")
        truth = {"bank": "development", "tier": case, "causes": [{"id": name} for name in causes]}
        (tmp_path / "truth" / f"{case}.json").write_text(json.dumps(truth))
    return tmp_path


def test_two_effects_are_found_for_two_causes(bank, monkeypatch, capsys):
    monkeypatch.setattr(
        sys, "argv", ["multiple_effects", "--bank", str(bank), "--lines", str(bank / "lines")]
    )
    assert main() == 0
    counted = capsys.readouterr().out.split("all of them true\n")[1].split()
    assert counted == ["none", "1", "0", "0", "single", "1", "0", "0", "pair", "1", "1", "1"]


def test_case_of_a_test_bank_is_rejected(bank, monkeypatch, capsys):
    truth = bank / "truth" / "pair.json"
    truth.write_text(truth.read_text().replace("development", "test"))
    monkeypatch.setattr(
        sys, "argv", ["multiple_effects", "--bank", str(bank), "--lines", str(bank / "lines")]
    )
    assert main() == 2
    assert "expected a case of a development bank" in capsys.readouterr().err
