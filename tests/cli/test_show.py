"""``wrapjax show``: a page of each kind of input, and refusals that write nothing."""

import json
import shutil

import numpy as np
import pytest

from tests.cli.folders import COORDINATES, MUSCLES, content
from tests.cli.test_check import assert_only_errors
from tests.report.model_view.conftest import numbers_of
from wrapjax.io.storage import Storage, write_storage
from wrapjax.osim.model import describe_model
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def diagnosed(subject, tmp_path_factory):
    """A small GAP folder: errors of 3 N m at the knee in the first half of the faster cycles."""
    folder = tmp_path_factory.mktemp("gaps") / "gap"
    trials = load_subject(subject).trials
    speeds = [None if np.isnan(speed) else float(speed) for speed in trials.speeds]
    where = [
        {
            **{"coordinate": "knee_angle_l", "phase_percent": [low, low + 50], "speed_m_s": 1.1},
            **{"rms_Nm": 6.0, "explainable_rms_Nm": 3.0 if low == 0 else 0.5},
        }
        for low in (0, 50)
    ]
    gap = {
        "outcome": "unknown",
        "named": [],
        "where": where,
        "trials": {
            name: {"use": use, "speed_m_s": speed, "file": recording}
            for name, use, speed, recording in zip(
                trials.names, trials.uses, speeds, trials.recordings, strict=True
            )
        },
    }
    folder.mkdir()
    (folder / "gap.json").write_text(json.dumps(gap))
    labels = tuple(f"{name}_moment{kind}" for kind in ("", "_before", "_after") for name in COORDINATES)
    for recording in dict.fromkeys(trials.recordings):
        rows = [row for row, name in enumerate(trials.recordings) if name == recording]
        time = np.unique(np.concatenate([trials.time[row] for row in rows]))
        values = np.tile(np.arange(6.0), (len(time), 1))
        write_storage(folder / "moments" / f"{recording}.sto", Storage("moments", labels, time, values))
    return folder


def shown(run, tmp_path, *arguments):
    """Numbers of the page that the command writes."""
    outcome = run("show", *arguments, "--out", tmp_path / "page.html", "--quiet")
    assert (outcome.status, outcome.progress) == (0, "")
    assert str(tmp_path / "page.html") in outcome.output
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    return numbers_of((tmp_path / "page.html").read_text(encoding="utf-8"))


def test_subject_is_shown_in_its_recorded_motion(run, subject, tmp_path):
    numbers = shown(run, tmp_path, subject)
    trials = load_subject(subject).trials
    assert numbers.content["frames"] == 303 and len(numbers.content["motions"]) == 3
    assert [one["name"] for one in numbers.content["muscles"]] == MUSCLES
    assert numbers.content["motions"][2]["name"] == "walk_b (validation)"
    np.testing.assert_allclose(numbers.content["motions"][1]["time"], trials.time[1], atol=1e-4)


def test_model_alone_moves_each_joint_through_its_range(run, subject, tmp_path):
    numbers = shown(run, tmp_path, subject / "model.osim")
    hip, knee = numbers.content["motions"]
    assert (hip["name"], knee["name"]) == tuple(COORDINATES)
    # The range of both is -2 to 2 rad.
    np.testing.assert_allclose([knee["progress"][0], knee["progress"][-1]], np.degrees([-2, 2]), atol=1e-3)


@pytest.fixture
def personalised(subject, tmp_path):
    """A folder as of personalised joints, of which the knee was 1 cm further up."""
    folder = tmp_path / "joints"
    folder.mkdir()
    shutil.copy(subject / "model.osim", folder / "model_joints.osim")
    model = describe_model(folder / "model_joints.osim")
    knee = next(joint for joint in model.joints if "knee_angle_l" in joint.coordinates)
    x, y, z = knee.in_parent.translation
    before = {"translation_m": [x, y + 0.01, z], "orientation_rad": [0.0, 0.0, 0.0]}
    content = {"subject": "P", "joints": {knee.name: {"before": before}}}
    (folder / "joints.json").write_text(json.dumps(content))
    return folder


def test_personalised_joints_are_shown_with_their_axes_before(run, personalised, tmp_path):
    (tmp_path / "page").mkdir()
    numbers = shown(run, tmp_path / "page", personalised)
    assert "P: joints from markers" in (tmp_path / "page" / "page.html").read_text(encoding="utf-8")
    axes = {(one["coordinate"], one["before"]): one for one in numbers.content["axes"]}
    knee = numbers.content["coordinates"].index("knee_angle_l")
    assert [key for key in axes if key[1]] == [(knee, True)]
    center = [numbers.array(axes[knee, before]["center"]).reshape(-1, 3) for before in (False, True)]
    np.testing.assert_allclose(np.linalg.norm(center[1] - center[0], axis=1), 0.01, atol=1e-6)


def test_damaged_joints_and_joints_with_a_subject_are_refused(run, subject, personalised, tmp_path):
    page = tmp_path / "page.html"
    outcome = run("show", personalised, "--subject", subject, "--out", page)
    assert_only_errors(outcome, "has markers and no subject")
    (personalised / "joints.json").write_text('{"subject": "P", "joints": {"knee": {"before": 1}}}')
    assert_only_errors(run("show", personalised, "--out", page), "is damaged")
    assert not page.exists()


def test_run_is_shown_with_its_forces_and_moments(run, subject, calibrated, tmp_path):
    numbers = shown(run, tmp_path, calibrated[1])
    found = {one["key"]: one for one in numbers.content["quantities"]}
    assert numbers.content["coloring"] == "tendon_force" and found["tendon_force"]["axes"] == ["muscle"]
    assert [one["name"] for one in found["moment"]["series"]] == ["measured", "calibrated"]
    measured = numbers.array(found["moment"]["series"][0]["values"]).reshape(2, 3, 101)
    moments = load_subject(subject).trials.moments
    np.testing.assert_allclose(measured, np.swapaxes(moments, 0, 1), rtol=1e-4, atol=1e-4)
    polynomial = found["length"]["series"][-1]
    exact, fitted = (numbers.array(one["values"]) for one in (found["length"]["series"][0], polynomial))
    assert polynomial["name"] == "polynomial of the calibration"
    np.testing.assert_allclose(fitted, exact, atol=0.05)


def test_fit_is_shown_with_its_polynomials_and_beside_its_report(run, fitted, tmp_path):
    numbers = shown(run, tmp_path, fitted[1])
    series = numbers.content["quantities"][0]["series"]
    assert [one["name"] for one in series] == ["model", "polynomial"]
    beside = (fitted[1] / "motion.html").read_text(encoding="utf-8")
    assert numbers_of(beside).content["frames"] == 303
    assert '<a href="motion.html">' in (fitted[1] / "report.html").read_text(encoding="utf-8")


def test_gap_is_shown_by_phase_and_speed(run, subject, diagnosed, tmp_path):
    numbers = shown(run, tmp_path, diagnosed, "--subject", subject)
    found = {one["key"]: one for one in numbers.content["quantities"]}
    assert numbers.content["coloring"] == "gap" and not found["gap"]["curve"]
    gap = numbers.array(found["gap"]["series"][0]["values"]).reshape(2, 3, 101)
    assert np.isnan(gap[0]).all() and np.isnan(gap[1, 2]).all()
    np.testing.assert_array_equal(gap[1, :2, [0, 49, 50, 100]], [[3, 3], [3, 3], [0.5, 0.5], [0.5, 0.5]])
    moments = [numbers.array(one["values"]).reshape(2, -1)[:, 0] for one in found["moment"]["series"]]
    np.testing.assert_array_equal(moments, [[0, 1], [2, 3], [4, 5]])


def test_json_names_the_page_and_an_existing_one_is_kept(run, subject, tmp_path):
    page = tmp_path / "page.html"
    page.write_text("mine")
    refused = run("show", subject, "--out", page)
    assert_only_errors(refused, page)
    assert "exists already; replace it with --force" in refused.progress and page.read_text() == "mine"
    outcome = run("show", subject, "--out", page, "--force", "--json", "--quiet")
    assert json.loads(outcome.output) == {"page": str(page)} and page.read_text() != "mine"


def _cut_moments(folder):
    file = next((folder / "moments").glob("*.sto"))
    file.write_text(file.read_text()[:300])


#: What is shown, a change of it, and words of the message.
REFUSED = {
    "nothing there": (None, lambda folder: shutil.rmtree(folder), "does not exist"),
    "another file": (
        None,
        lambda folder: (shutil.rmtree(folder), folder.write_text("x")),
        "no OpenSim model",
    ),
    "no result": (
        None,
        lambda folder: [path.unlink() for path in folder.glob("*.json")],
        "no result of wrapjax",
    ),
    "an evaluation": (
        None,
        lambda folder: [(folder / "gap.json").unlink(), (folder / "evaluation.json").write_text("{}")],
        "holds an evaluation, which has no view in motion",
    ),
    "no subject": (None, lambda folder: None, "name the subject folder with --subject"),
    "not JSON": ("subject", lambda folder: (folder / "gap.json").write_text("{"), "is damaged"),
    "no trials": ("subject", lambda folder: (folder / "gap.json").write_text('{"where": []}'), "is damaged"),
    "moments cut off": ("subject", _cut_moments, "walk_"),
    "no moments": ("subject", lambda folder: shutil.rmtree(folder / "moments"), "walk_a.sto"),
    "bones nowhere": ("bones", lambda folder: None, "is no folder; name a folder with .vtp files"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_input_is_refused_in_a_sentence(run, subject, diagnosed, tmp_path, name):
    given, change, words = REFUSED[name]
    folder = tmp_path / "gap"
    shutil.copytree(diagnosed, folder)
    change(folder)
    options = {
        None: (),
        "subject": ("--subject", subject),
        "bones": ("--subject", subject, "--bones", tmp_path / "bones"),
    }[given]
    before = content(tmp_path)
    outcome = run("show", folder, "--out", tmp_path / "page.html", "--quiet", *options)
    assert outcome.status == 2 and outcome.output == ""
    assert words in outcome.progress and outcome.progress.startswith("error: ")
    assert "Traceback" not in outcome.progress and content(tmp_path) == before


def test_model_of_another_subject_is_refused(run, subject, tmp_path):
    model = tmp_path / "model.osim"
    model.write_text((subject / "model.osim").read_text().replace("semiten_l", "semimem_l"))
    outcome = run("show", model, "--subject", subject, "--out", tmp_path / "page.html", "--quiet")
    assert outcome.status == 2
    assert f"{model}: lacks 'semiten_l' of subject {subject}; did you mean 'semimem_l'?" in outcome.progress
    assert [path.name for path in tmp_path.iterdir()] == ["model.osim"]


def test_damaged_bone_is_named(run, subject, tmp_path):
    model = (subject / "model.osim").read_text()
    mesh = '<attached_geometry><Mesh name="bone"><mesh_file>bone.vtp</mesh_file></Mesh></attached_geometry>'
    place = tmp_path / "model.osim"
    place.write_text(model.replace('<Body name="femur_l">', f'<Body name="femur_l">{mesh}'))
    (tmp_path / "Geometry").mkdir()
    (tmp_path / "Geometry" / "bone.vtp").write_bytes(b"\x00\x01rubbish")
    outcome = run("show", place, "--out", tmp_path / "page.html", "--quiet")
    assert_only_errors(outcome, tmp_path / "Geometry" / "bone.vtp")
    assert not (tmp_path / "page.html").exists()
