"""``wrapjax protocol`` from a folder of ``diagnose``, and ``diagnose --protocol``."""

import json

import pytest

from tests.cli.folders import names, read_json
from tests.cli.test_check import assert_only_errors
from tests.diagnosis.test_protocol import WITHOUT


@pytest.mark.slow
def test_a_finished_diagnosis_is_followed_by_three_trials(run, subject, fitted, tmp_path):
    gap = tmp_path / "gap"
    gap.mkdir()
    effects = [
        {"id": "joint_damping", "probability": 0.5},
        {"id": "emg_offset", "probability": 0.4},
        {"id": "unknown", "probability": 0.1},
    ]
    (gap / "gap.json").write_text(json.dumps({"subject_folder": str(subject), "effects": effects}))
    out = tmp_path / "next"
    options = ("--fit", fitted[1], "--starts", "1", "--without", *WITHOUT)
    done = run("protocol", gap, *options, "--out", out)
    assert done.status == 0 and f"written to {out}" in done.output
    assert names(out) == ["protocol.json", "report.html", "settings.toml"]
    content = read_json(out / "protocol.json")
    assert len(content["trials"]) == 3 and content["basis"].endswith("recorded gait cycles")
    weights = {one["id"]: one["weight"] for one in content["effects"]}
    assert weights["joint_damping"] == pytest.approx(5 / 9) and weights["passive_joint_moment"] == 0.0
    printed = run("protocol", gap, *options, "--json")
    assert json.loads(printed.output)["trials"] == content["trials"]


def test_two_conditions_have_no_protocol(run, subject, tmp_path):
    done = run("diagnose", subject, "--against", subject, "--protocol", "--out", tmp_path / "gap")
    assert_only_errors(done, "--against")
    assert list(tmp_path.iterdir()) == []
