"""``wrapjax evaluate``: moment errors on other cycles, printed or in a folder."""

import json
import shutil

from tests.cli.folders import content, names
from tests.cli.test_check import assert_only_errors


def test_prints_errors_and_writes_nothing(run, calibrated, subject):
    _, folder = calibrated
    before = content(folder.parent)
    outcome = run("evaluate", folder, subject)
    assert outcome.status == 0
    summary = json.loads((folder / "summary.json").read_text())
    (line,) = [line for line in outcome.output.splitlines() if line.startswith("knee_angle_l")]
    expected = [f"{summary['mae_Nm'][use]['knee_angle_l']:.2f}" for use in ("calibration", "validation")]
    assert line.split()[1:] == expected * 2
    assert content(folder.parent) == before


def test_json_equals_the_stored_file(run, calibrated, subject, tmp_path):
    out = tmp_path / "out"
    outcome = run("evaluate", calibrated[1], subject, "--out", out, "--json")
    assert json.loads(outcome.output) == json.loads((out / "evaluation.json").read_text())
    assert names(out) == [
        "evaluation.json",
        "moments/walk_a_01.sto",
        "moments/walk_a_02.sto",
        "moments/walk_b.sto",
        "report.html",
        "settings.toml",
    ]
    assert_only_errors(run("evaluate", calibrated[1], subject, "--out", out), out)


def test_a_run_that_did_not_converge_is_evaluated_with_exit_status_1(run, calibrated, subject, tmp_path):
    folder = shutil.copytree(calibrated[1], tmp_path / "stopped")
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | {"converged": False}))
    outcome = run("evaluate", folder, subject)
    assert outcome.status == 1 and "knee_angle_l" in outcome.output


def test_no_run(run, subject, tmp_path):
    assert_only_errors(run("evaluate", tmp_path / "none", subject, "--out", tmp_path / "out"), tmp_path)
    assert_only_errors(run("evaluate", subject, subject, "--out", tmp_path / "out"), subject)
    assert not list(tmp_path.iterdir())
