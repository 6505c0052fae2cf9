"""Reproducible and resumable simulation of a bank."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from validation.blind.__main__ import main
from validation.blind.case_selection import ALL_CASES
from validation.blind.effects import EFFECTS
from validation.blind.make import make
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.plan import Bank
from validation.blind.score.records import read_truth
from validation.blind.seal import broken_seals, digest


@pytest.mark.slow
def test_interrupted_bank_is_completed_identically(tmp_path, monkeypatch, capsys):
    quick = {"slow_fibers", "missing_drive", "joint_damping", "ankle_foot_orthosis"}
    for name in set(EFFECTS) - quick:
        monkeypatch.delitem(EFFECTS, name)
    for name in set(OUTSIDE) - {"joint_friction"}:
        monkeypatch.delitem(OUTSIDE, name)
    bank = Bank("development", 11, 2, 4, 2, 2, 2)
    make(bank, tmp_path)
    sealed = (tmp_path / "manifest.json").read_bytes()
    truths = read_truth(tmp_path, ALL_CASES)
    assert [sum(t.tier == tier for t in truths) for tier in ("single", "none", "outside", "pair")] == [
        4,
        2,
        2,
        2,
    ]
    assert all(t.d_star > 0.3 for t in truths if t.tier != "none")

    # Delete half of the cases of both persons: they are made again identically.
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


#: Script that makes two persons and three cases in a given folder.
TINY = """
import sys
from pathlib import Path
from validation.blind import make, plan
from validation.blind.effects import EFFECTS
from validation.blind.outside_catalogue import OUTSIDE
for known, used in ((EFFECTS, {"joint_damping", "ankle_foot_orthosis"}), (OUTSIDE, {"joint_friction"})):
    for name in set(known) - used:
        del known[name]
make.make(plan.Bank("development", 11, 2, 1, 1, 1, 0), Path(sys.argv[1]))
"""


@pytest.mark.slow
def test_bytes_do_not_depend_on_process_or_folder(tmp_path, capsys):
    """Check that files depend neither on the folder, nor on the order of sets, nor on the clock."""
    found = []
    for name, order in (("one", "1"), ("another_place", "2")):
        folder = tmp_path / name
        folder.mkdir()
        environment = {**os.environ, "PYTHONHASHSEED": order, "PYTHONPATH": str(Path(__file__).parents[2])}
        subprocess.run([sys.executable, "-c", TINY, str(folder)], cwd=folder, env=environment, check=True)
        files = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".log")
        found.append({path.relative_to(folder).as_posix(): digest(path) for path in files})
    assert found[0] == found[1] and len(found[0]) > 30
    manifest = str(tmp_path / "one" / "manifest.json")
    assert main(["check", "--bank", str(folder), "--manifest", manifest]) == 0
    assert "byte for byte" in capsys.readouterr().out
