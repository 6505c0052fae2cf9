"""Tests of joint personalisation: known joints recovered, what markers leave open, files, wrong input."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.joints.person import JOINTS, make_person, settings_text
from tests.subject.synthetic import MODEL
from wrapjax.cli.command_line import main
from wrapjax.errors import InputError
from wrapjax.joints.identifiability import place_spreads
from wrapjax.joints.nmsm_settings import read_nmsm_settings
from wrapjax.joints.personalisation import personalize_joints
from wrapjax.joints.settings import JointSettings, MarkerTrial, read_joint_settings
from wrapjax.osim.model import describe_model
from wrapjax.preprocessing.files.markers import write_trc
from wrapjax.subject.joint_spread import read_joint_spread


@pytest.fixture(scope="module")
def person(tmp_path_factory):
    """A person whose centres differ by up to 20 mm and axes by up to 10 degrees; markers without errors."""
    return make_person(tmp_path_factory.mktemp("person"))


@pytest.fixture(scope="module")
def settings(person):
    """Settings that free the frames which differ, with priors as good as off."""
    return JointSettings(
        file=person.folder / "joints.toml",
        name="P",
        model_file=person.model,
        trials=(MarkerTrial("walk", person.folder / "walk.trc"),),
        parameters=person.parameters,
        prior_factor=1e3,
        skin_movement=0.0,
        frames=30,
    )


@pytest.fixture(scope="module")
def recovered(settings):
    return personalize_joints(settings)


def _frames(description, name):
    joint = next(entry for entry in description.joints if entry.name == name)
    return [
        (np.asarray(pose.rotation), np.asarray(pose.translation))
        for pose in (joint.in_parent, joint.in_child)
    ]


def test_known_centres_and_axes_are_recovered(person, recovered):
    """Centre of the ball; of hinges the axis line in both bodies, which a slide along it leaves the same."""
    truth = describe_model(person.true_model)
    assert recovered.status.converged
    for name in JOINTS:
        for found, expected in zip(_frames(recovered.after, name), _frames(truth, name), strict=True):
            offset = found[1] - expected[1]
            if name != "hip_r":
                axis = expected[0][:, 2]
                assert np.arccos(min(1.0, found[0][:, 2] @ axis)) < np.radians(0.01)
                offset = offset - axis * (axis @ offset)
            assert np.linalg.norm(offset) < 1e-5
    assert recovered.rms["before"] > 0.005
    assert recovered.rms["after"] < 1e-6 and recovered.rms["held_out_after"] < 1e-6
    dataset = recovered.to_dataset()
    assert dataset["value"].sel(parameter="hip_r parent_translation x")["unit"].item() == "m"
    assert float(dataset["marker_distance"].sel(stage="after").max()) < 1e-5
    assert float(dataset["marker_distance"].sel(stage="before").max()) > 0.005


def test_slides_along_hinge_axes_are_named_as_undetermined(person, recovered):
    directions = recovered.posterior.directions
    assert len(directions) == 2
    for joint in ("ankle_r", "knee_r"):
        names = {f"{joint} parent_translation z", f"{joint} child_translation z"}
        assert any(names <= set(direction.components) for direction in directions)
    undetermined = recovered.summary()["undetermined"]
    assert {name.split()[0] for name in undetermined} <= {"knee_r", "ankle_r"}
    assert "hip_r parent_translation x" not in undetermined


def test_priors_keep_what_markers_do_not_determine(settings, recovered):
    """The slide along the knee's axis stays at the prior mean, zero; the rest is found as before."""
    kept = personalize_joints(replace(settings, prior_factor=1.0))
    values = dict(zip([entry.name for entry in kept.parameters], kept.values, strict=True))
    slide = values["knee_r parent_translation z"] + values["knee_r child_translation z"]
    assert abs(slide) < 3e-3
    assert kept.rms["after"] < 0.05 * kept.rms["before"]
    assert (kept.posterior.sd <= [entry.sd * (1.0 + 1e-9) for entry in kept.parameters]).all()


def test_places_of_joints_have_the_posterior_of_what_places_them(recovered):
    """Without scales, the change of a joint's place is that of its own parameters."""
    spreads = place_spreads(recovered.before.joints, recovered.parameters, recovered.posterior)
    rows = [
        (row, entry)
        for row, entry in enumerate(recovered.parameters)
        if entry.kind == "parent_translation" and entry.owner in ("hip_r", "knee_r")
    ]
    covariance = recovered.posterior.correlated
    for first, one in rows:
        assert spreads[one.owner]["translation_m"][one.axis] == pytest.approx(recovered.posterior.sd[first])
        for second, other in rows:
            expected = covariance[first, second] / np.sqrt(
                covariance[first, first] * covariance[second, second]
            )
            found = spreads[one.owner]["correlation"][other.owner][one.axis][other.axis]
            assert found == pytest.approx(expected, abs=1e-9)


def test_command_writes_the_contract_and_a_model_that_opens(person, tmp_path, capsys):
    rng = np.random.default_rng(1)
    noise = np.cumsum(rng.normal(0.0, 0.001, person.markers.positions.shape), axis=1)
    write_trc(tmp_path / "walk.trc", replace(person.markers, positions=person.markers.positions + noise))
    (tmp_path / "start.osim").write_bytes(person.model.read_bytes())
    (tmp_path / "joints.toml").write_text(settings_text('scales = "none"\n'))
    out = tmp_path / "out"
    assert main(["joints", str(tmp_path), "--out", str(out), "--quiet"]) == 0
    assert "on frames held out" in capsys.readouterr().out
    content = json.loads((out / "joints.json").read_text())
    assert content["schema"] == 1
    assert set(content["rms_mm"]) == {"before", "after", "held_out_before", "held_out_after"}
    assert content["rms_mm"]["after"] < 0.5 * content["rms_mm"]["before"]
    assert content["rms_mm"]["held_out_after"] < content["rms_mm"]["held_out_before"]
    assert set(content["joints"]) == set(JOINTS)
    assert set(content["joints"]["knee_r"]) >= {"translation_m", "orientation_rad", "sd", "determined"}
    assert set(content["markers"]) >= {"TH0_r", "SH0_r"}
    # A diagnosis reads how sure the joints are.
    spread = read_joint_spread(out, [entry.name for entry in describe_model(person.model).coordinates])
    hip, knee = spread["hip_flexion_r"], spread["knee_angle_r"]
    assert hip.orientation == (None, None, None) and all(0.0 < sd < 0.01 for sd in hip.translation)
    freed_sd = content["joints"]["hip_r"]["sd"]["translation_m"]["parent"]
    np.testing.assert_allclose(hip.translation, [freed_sd[axis] for axis in "xyz"])
    assert all(0.0 < sd < 0.13 for sd in knee.orientation[:2])
    with_knee = hip.correlation["knee_angle_r"]
    np.testing.assert_allclose(with_knee, knee.correlation["hip_flexion_r"].T, atol=1e-12)
    assert 0.1 < np.abs(with_knee[:3]).max() < 1.0 and not with_knee[3:].any()
    own = hip.correlation["hip_flexion_r"]
    np.testing.assert_allclose(np.diagonal(own), [1.0] * 3 + [0.0] * 3, atol=1e-12)
    written = describe_model(out / "model_joints.osim")
    knee = next(joint for joint in written.joints if joint.name == "knee_r")
    np.testing.assert_allclose(
        knee.in_parent.translation, content["joints"]["knee_r"]["translation_m"]["parent"], atol=1e-12
    )
    # The person has no muscles, of whose paths the page of the model in motion consists.
    page = (out / "report.html").read_text()
    assert "<html" in page[:200] and "motion.html" not in page and not (out / "motion.html").exists()


def test_a_model_with_muscles_is_also_written_in_motion(recovered, tmp_path):
    with_muscles = replace(recovered, model=MODEL.encode())
    with_muscles.save(tmp_path / "out", motion=True)
    assert "motion.html" in (tmp_path / "out" / "report.html").read_text()
    assert "joints from markers" in (tmp_path / "out" / "motion.html").read_text(encoding="utf-8")


def _write(folder, person, markers=None, text=None):
    write_trc(folder / "walk.trc", person.markers if markers is None else markers)
    (folder / "start.osim").write_bytes(person.model.read_bytes())
    (folder / "joints.toml").write_text(settings_text() if text is None else text)


def _only(markers, keep):
    return markers.select(tuple(name for name in markers.names if keep(name)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (settings_text().replace("knee_r", "kne_r"), "has no such joint; did you mean 'knee_r'?"),
        (settings_text().replace("walk.trc", "wlak.trc"), "expected a file, found no"),
        (settings_text("scalse = 1\n"), "is not a known key; did you mean 'scales'?"),
        (settings_text("frames = 1\n").replace("frames = 30\n", ""), "expected a number from 10"),
        (settings_text(trials='[[trial]]\nname = "a"\nangles = "b.sto"\n'), "with markers and use"),
    ],
)
def test_wrong_settings_get_one_sentence(person, tmp_path, capsys, text, message):
    _write(tmp_path, person, text=text)
    assert main(["joints", str(tmp_path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and message in lines[0]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda markers: _only(markers, lambda name: not name.startswith("FO")), "found none below it"),
        (lambda markers: _only(markers, lambda name: not name.startswith("PEL")), "found none above it"),
        (
            lambda markers: _only(markers, lambda name: name[:3] not in ("TH1", "TH2", "TH3")),
            "than the 3 coordinates of the joint, found 3 of 1 marker",
        ),
        (lambda markers: replace(markers, positions=1e3 * markers.positions), "unit of length"),
    ],
)
def test_wrong_markers_get_one_sentence(person, tmp_path, capsys, change, message):
    _write(tmp_path, person, markers=change(person.markers))
    assert main(["joints", str(tmp_path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and message in lines[0]


def test_files_of_two_people_are_refused(person, tmp_path, capsys):
    trials = "".join(f'[[trial]]\nname = "{name}"\nmarkers = "{name}.trc"\n' for name in ("walk", "other"))
    _write(tmp_path, person, text=settings_text(trials=trials))
    write_trc(tmp_path / "other.trc", replace(person.markers, positions=1.25 * person.markers.positions))
    assert main(["joints", str(tmp_path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "are these files of two people?" in lines[0]


def _nmsm_text(joint="knee_r", orientation="true true false"):
    frames = "".join(
        f"<{side}_frame_transformation><translation>false false false</translation>"
        f"<orientation>{orientation}</orientation><orientation_bounds>0.3</orientation_bounds>"
        f"</{side}_frame_transformation>"
        for side in ("parent", "child")
    )
    return (
        '<NMSMPipelineDocument Version="1.5.0"><JointModelPersonalizationTool>'
        "<input_directory>.</input_directory><input_model_file>start.osim</input_model_file>"
        '<JMPTaskList><JMPTask name="knee"><is_enabled>true</is_enabled><index>1</index>'
        "<marker_file_name>.\\walk.trc</marker_file_name><time_range>0 0.5</time_range>"
        "<marker_names>TH0_r TH1_r TH2_r TH3_r SH0_r SH1_r SH2_r SH3_r</marker_names>"
        f'<JMPJointSet><JMPJoint name="{joint}">{frames}</JMPJoint></JMPJointSet>'
        '<JMPBodySet><JMPBody name="shank_r"><scale_body>true</scale_body>'
        "<move_markers>true false false</move_markers></JMPBody></JMPBodySet>"
        "</JMPTask></JMPTaskList></JointModelPersonalizationTool></NMSMPipelineDocument>"
    )


def test_settings_of_the_nmsm_pipeline_are_read(person):
    file = person.folder / "jmp.xml"
    file.write_text(_nmsm_text())
    settings = read_nmsm_settings(file)
    assert settings.model_file.name == "start.osim"
    assert settings.trials[0].interval == (0.0, 0.5) and len(settings.trials[0].markers) == 8
    assert settings.parameters is not None
    names = [parameter.name for parameter in settings.parameters]
    assert names == [
        *("knee_r parent_orientation x", "knee_r parent_orientation y"),
        *("knee_r child_orientation x", "knee_r child_orientation y", "shank_r scale"),
        *(f"SH{number}_r marker x" for number in range(4)),
    ]
    assert settings.parameters[0].upper == 0.3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_nmsm_text(joint="knee"), "no such joint"),
        (_nmsm_text().replace("<index>1", "<index>--1"), "expected a number as index"),
        (
            _nmsm_text(orientation="true false false").replace(">0.3<", ">0,3<", 1),
            "expected a number as orient",
        ),
        (
            _nmsm_text(orientation="true false false").replace(">0.3<", ">-1<", 1),
            "expected a positive number",
        ),
        (_nmsm_text(orientation="yes true"), "expected three of true and false as orientation"),
        (_nmsm_text().replace("walk.trc", "wolk.trc"), "<marker_file_name>: expected a file"),
        (_nmsm_text().replace("<is_enabled>true", "<is_enabled>false"), "expected an enabled <JMPTask>"),
    ],
)
def test_wrong_settings_of_the_nmsm_pipeline_are_refused(person, text, message):
    file = person.folder / "wrong.xml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        read_nmsm_settings(file)
    assert message in str(error.value) and len(error.value.problems) == 1


def test_a_folder_without_settings_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"expected joints\.toml in the folder"):
        read_joint_settings(tmp_path)
