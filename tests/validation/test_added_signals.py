"""Ranking of effects when a known signal is added to a case without effect."""

import json

import numpy as np
import pytest

from tests.validation.synthetic_linearizations import COORDINATES, CYCLES, PHASES, lines
from validation.blind.library import Library
from validation.diagnosis.added_signals import add_signals, main, table_lines
from validation.diagnosis.linearizations import save


def shape(seed):
    return np.random.default_rng(seed).normal(size=(CYCLES, PHASES, COORDINATES))


@pytest.fixture(scope="module")
def null_case():
    """Build a linearized case of noise alone, with two effects of different shapes."""
    return lines(0.0 * shape(0), {"known": shape(2), "other": shape(3)})


def library(**signals):
    columns = np.stack([signal.ravel() for signal in signals.values()], axis=1)
    entries = tuple((name.rstrip("_"), ()) for name in signals)
    return Library(entries, columns, np.ones((3, len(entries))))


def test_signal_of_an_effect_ranks_it_first_with_evidence_by_size(null_case):
    small, large = add_signals(null_case, library(known=7.0 * shape(2)), (5.0, 8.0))
    assert small.first == large.first == "known" and small.rank == large.rank == 0
    assert small.captured == pytest.approx(1.0)
    # Half of the squared size, with noise, less the penalty for unknown size and sign.
    assert 5.0 < small.evidence < 18.0 and 22.0 < large.evidence < 42.0


def test_signal_with_the_shape_of_another_effect_ranks_that_first(null_case):
    (one,) = add_signals(null_case, library(known=shape(3)), (8.0,))
    assert one.first == "other" and one.rank == 1 and one.captured < 0.1


def test_untested_and_undetectable_signals_are_omitted(null_case):
    assert add_signals(null_case, library(untested=shape(2), known=1e-6 * shape(2)), (5.0,)) == []


def test_effects_have_equal_weight_in_the_mean(null_case):
    signals = add_signals(null_case, library(known=shape(2), known_=shape(2), other=shape(2)), (8.0,))
    *rows, mean = table_lines(signals)[1:]
    assert [row.split()[0] for row in rows] == ["known", "other"]
    assert rows[0].split()[2:4] == ["2", "1.00"] and rows[1].split()[2:4] == ["1", "0.00"]
    assert mean.split()[-2] == "0.50"


def test_command_uses_each_person_without_effect_once(null_case, tmp_path, monkeypatch, capsys):
    for name, tier in (("a", "none"), ("again", "none"), ("b", "single")):
        (tmp_path / "truth").mkdir(exist_ok=True)
        truth = {"bank": "development", "tier": tier, "person": "development_00"}
        (tmp_path / "truth" / f"{name}.json").write_text(json.dumps(truth))
        save(null_case, tmp_path / "lines" / f"{name}.npz")
    (tmp_path / "library").mkdir()
    library(known=shape(2)).save(tmp_path / "library" / "00.npz")
    arguments = ["added_signals", "--bank", str(tmp_path), "--lines", str(tmp_path / "lines"), "--sizes", "8"]
    monkeypatch.setattr("sys.argv", arguments)
    assert main() == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:4] == ["known", "8.0", "1", "1.00"]
    for name in ("a", "again"):
        (tmp_path / "lines" / f"{name}.npz").unlink()
    assert main() == 2 and "without effect" in capsys.readouterr().err
