"""A bank is made person by person, resumes where it stopped, and comes out the same."""

import shutil

import pytest

from benchmarks.blind.__main__ import main
from benchmarks.blind.effects import EFFECTS
from benchmarks.blind.make import make
from benchmarks.blind.outside import OUTSIDE
from benchmarks.blind.plan import Bank
from benchmarks.blind.score.records import read_truth
from benchmarks.blind.seal import broken_seals


@pytest.mark.slow
def test_a_bank_resumes_and_is_the_same_again(tmp_path, monkeypatch, capsys):
    quick = {"slow_fibers", "missing_drive", "joint_damping", "ankle_foot_orthosis"}
    for name in set(EFFECTS) - quick:
        monkeypatch.delitem(EFFECTS, name)
    for name in set(OUTSIDE) - {"joint_friction"}:
        monkeypatch.delitem(OUTSIDE, name)
    bank = Bank("development", 11, 2, 4, 2, 2, 2)
    make(bank, tmp_path)
    sealed = (tmp_path / "manifest.json").read_bytes()
    truths = read_truth(tmp_path)
    assert [sum(t.tier == tier for t in truths) for tier in ("single", "none", "outside", "pair")] == [
        4,
        2,
        2,
        2,
    ]
    assert all(t.d_star > 0.3 for t in truths if t.tier != "none")

    # Lose half of what was made, of either person: it is made again to the byte.
    for truth in truths[::2]:
        shutil.rmtree(tmp_path / "cases" / truth.id)
    assert len(broken_seals(tmp_path)) == len(truths[::2])
    make(bank, tmp_path)
    assert (tmp_path / "manifest.json").read_bytes() == sealed
    assert broken_seals(tmp_path) == []

    assert main(["score", "--bank", str(tmp_path), "--answers", f"it={tmp_path / 'nothing'}"]) == 1
    assert "without an answer" in capsys.readouterr().err
    assert main(["sheet", "--bank", str(tmp_path), "--out", str(tmp_path / "sheet.png"), "--count", "2"]) == 0
    assert (tmp_path / "sheet.png").stat().st_size > 10_000
