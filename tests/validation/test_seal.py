"""Comparison of a bank with its manifest."""

import pytest

from tests.validation.synthetic_bank import write_bank
from validation.blind.__main__ import main


@pytest.fixture
def banks(tmp_path):
    """Write a bank and the same bank in another folder."""
    for name in ("sealed", "again"):
        truths = write_bank(tmp_path / name, single=3, other=1)
    return tmp_path, truths[2]["id"]


def check(folder):
    return main(
        ["check", "--bank", str(folder / "again"), "--manifest", str(folder / "sealed/manifest.json")]
    )


def test_identical_bank_passes(banks, capsys):
    assert check(banks[0]) == 0
    assert "byte for byte" in capsys.readouterr().out


@pytest.mark.parametrize("what", ["changed", "missing", "a byte", "a file", "more"])
def test_differences_are_listed(banks, what, capsys):
    folder, name = banks[0] / "again", banks[1]
    recording = folder / "cases" / name / "trials" / "walk_1"
    if what == "changed":
        (folder / "truth" / f"{name}.json").write_bytes(b"{}")
        expected = [f"truth/{name}.json is not the one"]
    elif what == "missing":
        (folder / "truth" / f"{name}.npy").unlink()
        expected = [f"truth/{name}.npy is missing"]
    elif what == "a byte":
        moments = recording / "moments.sto"
        moments.write_bytes(b" " + moments.read_bytes()[1:])
        expected = [f"cases/{name} is not the one"]
    elif what == "a file":
        (recording / "extra.sto").write_text("")
        expected = [f"cases/{name} is not the one"]
    else:
        (folder / "cases" / "ffff").mkdir()
        expected = ["cases/ffff was never sealed"]
    assert check(banks[0]) == 1
    *lines, last = capsys.readouterr().out.splitlines()
    assert len(lines) == len(expected) and last == "1 differ"
    assert all(line.startswith(start) for line, start in zip(lines, expected, strict=True))


def test_a_differing_case_can_be_left_out_by_id(banks, capsys):
    folder, name = banks[0] / "again", banks[1]
    again = ["check", "--bank", str(folder), "--manifest", str(banks[0] / "sealed/manifest.json")]
    (folder / "cases" / name / "subject.toml").write_text("")
    assert main([*again, "--leave-out", name]) == 0
    (folder / "truth" / f"{name}.json").unlink()
    assert main([*again, "--leave-out", name]) == 0
    assert main([*again, "--leave-out", "ffff"]) == 1
    assert name in capsys.readouterr().out


def test_missing_manifest_is_an_error(banks, capsys):
    (banks[0] / "sealed" / "manifest.json").unlink()
    assert check(banks[0]) == 1
    assert "no such manifest" in capsys.readouterr().err
