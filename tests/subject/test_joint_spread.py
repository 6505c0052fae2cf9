"""Standard deviations of personalised joints: read with the subject, wrong files refused."""

import json

import numpy as np
import pytest

from tests.subject.synthetic import COORDINATES, write_subject
from tests.subject.test_subject import replace_text
from wrapjax.errors import InputError
from wrapjax.subject.joint_spread import JointSpread, read_joint_spread
from wrapjax.subject.subject import load_subject

SPREAD = {"translation_m": [0.002, 0.003, None], "orientation_rad": [None, None, None]}


def _content(coordinates=COORDINATES[:1], spread=SPREAD):
    return {"joints": {"hip_l": {"coordinates": list(coordinates), "spread": spread}}}


def _named(folder, content):
    (folder / "joints").mkdir()
    (folder / "joints" / "joints.json").write_text(json.dumps(content))
    replace_text(folder / "subject.toml", "[model]\n", '[model]\njoints = "joints"\n')
    return folder


def test_a_subject_knows_its_personalised_joints(tmp_path):
    folder = _named(write_subject(tmp_path), _content())
    expected = JointSpread((0.002, 0.003, None), (None, None, None))
    assert load_subject(folder).joint_spread == {COORDINATES[0]: expected}


def test_correlations_are_read_by_coordinate(tmp_path):
    rows = np.eye(6).tolist()
    content = _content(["hip_flexion_l", "hip_adduction_l"], {**SPREAD, "correlation": {"hip_l": rows}})
    (tmp_path / "joints.json").write_text(json.dumps(content))
    read = read_joint_spread(tmp_path, ["hip_flexion_l", "hip_adduction_l"])
    for name in read:
        np.testing.assert_array_equal(read["hip_flexion_l"].correlation[name], np.eye(6))
    assert len(read) == 2


def test_joints_of_another_model_are_refused(tmp_path):
    file = tmp_path / "joints.json"
    file.write_text(json.dumps(_content(["hip_flexion_r"])))
    assert set(read_joint_spread(tmp_path, ["hip_flexion_r"])) == {"hip_flexion_r"}
    folder = _named(write_subject(tmp_path / "leg"), _content(["hip_flexion_r"]))
    with pytest.raises(InputError, match="expected a coordinate of the subject's model, found 'hip_f"):
        load_subject(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "expected JSON"),
        ("[]", "expected a table 'joints'"),
        (json.dumps({"joints": {"hip_l": {}}}), "expected coordinates, and under spread"),
        (json.dumps(_content(spread={**SPREAD, "translation_m": [0.0, 0.1, 0.1]})), "under spread"),
        (json.dumps(_content(spread={**SPREAD, "translation_m": [0.1, 0.1]})), "under spread"),
        (json.dumps(_content(spread={**SPREAD, "orientation_rad": [True, 0.1, 0.1]})), "under spread"),
        (json.dumps(_content(spread={**SPREAD, "correlation": [1.0]})), "correlations of six with six"),
        (json.dumps(_content(spread={**SPREAD, "correlation": {"hip_l": [[1.0]]}})), "of six with six"),
        (
            json.dumps(_content(spread={**SPREAD, "correlation": {"hip_l": [["a"] * 6] * 6}})),
            "of six with six",
        ),
        (
            json.dumps(_content(spread={**SPREAD, "correlation": {"hip_l": [[2.0] * 6] * 6}})),
            "of six with six",
        ),
    ],
)
def test_wrong_files_are_refused(tmp_path, text, message):
    file = tmp_path / "joints.json"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        read_joint_spread(tmp_path, ["hip_flexion_l"])


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="written by 'wrapjax joints', found none"):
        read_joint_spread(tmp_path / "joints", [])
