"""Projects of the NMSM Pipeline become subjects: nothing is lost on the way, and what is wrong is said."""

import json
import re
import shutil

import numpy as np
import pytest

from tests.preprocessing.synthetic_project import SETTINGS, STARTS, write_settings
from tests.subject.synthetic import CHANNELS, PERIOD, angles, emg, moments
from wrapjax.cli.command_line import main
from wrapjax.errors import InputError
from wrapjax.io.model_file import read_model_file
from wrapjax.io.storage import Storage, read_storage, write_storage
from wrapjax.path_sources.undriven_muscles import apply_undriven_strategy
from wrapjax.preprocessing.nmsm_project import FOLDERS, read_project
from wrapjax.preprocessing.preparation import prepare_subject
from wrapjax.subject.subject import load_subject


def test_a_project_is_the_subject_that_it_was_recorded_from(project, tmp_path):
    prepare_subject(write_settings(project)).save(tmp_path / "somebody")
    subject = load_subject(tmp_path / "somebody")
    trials = subject.trials
    assert subject.name == "somebody" and subject.side == "l" and subject.mass_kg == 10.0
    assert subject.muscles.names == ("recfem_l", "semiten_l") and trials.channels == tuple(CHANNELS)
    assert trials.names == tuple(STARTS) and set(trials.uses) == {"calibration"}
    np.testing.assert_allclose(
        trials.time[:, [0, -1]], [[start, start + PERIOD] for start in STARTS.values()]
    )
    for number, time in enumerate(trials.time):
        np.testing.assert_allclose(trials.angles[number], angles(time), atol=1e-7)
        np.testing.assert_allclose(trials.moments[number], moments(time), atol=1e-5)
        np.testing.assert_allclose(trials.emg[number], emg(trials.emg_time[number]), atol=1e-6)
    assert subject.notes == ()


def test_lengths_of_an_earlier_step_win_over_the_model(project, tmp_path):
    done = prepare_subject(write_settings(project, osimx="earlier.osimx"))
    assert "calibrated anew" in done.project.notes[0]
    done.save(tmp_path / "subject")
    muscles = load_subject(tmp_path / "subject").muscles
    model = read_model_file(tmp_path / "models" / "model.osim").muscles
    np.testing.assert_array_equal(muscles.optimal_fiber_length, [model.optimal_fiber_length[0], 0.17])
    np.testing.assert_array_equal(muscles.tendon_slack_length, model.tendon_slack_length)


def test_prefixes_choose_trials(project):
    done = read_project(write_settings(project, prefixes="gait_2"))
    assert [trial.name for trial in done.trials] == ["gait_2"] and done.notes == ()


def test_groups_without_emg_are_kept_for_synergies(project, tmp_path):
    """The project's groups are what synergies drive; nothing else is, and what would drive them is named."""
    done = prepare_subject(write_settings(project, groups="RecFem", missing="SemiTen"))
    assert done.project.channels == {"RecFem": ("recfem_l",)}
    assert done.project.extrapolated == {"SemiTen": ("semiten_l",)}
    (note,) = done.project.notes
    assert "SemiTen" in note and "--undriven synergies" in note
    done.save(tmp_path / "subject")
    subject = load_subject(tmp_path / "subject")
    assert subject.extrapolated == {"SemiTen": ("semiten_l",)} and subject.muscles.names == ("recfem_l",)
    driven = apply_undriven_strategy(subject, "synergies", 1)
    assert driven.synergies.groups == {"SemiTen": ("semiten_l",)}
    assert driven.muscles.names == ("recfem_l", "semiten_l")


def test_a_muscle_has_one_excitation(project, tmp_path):
    """A group without EMG may hold muscles that a channel drives; these stay the channel's, which is told."""
    both = "ThighActivationGroupL"
    done = prepare_subject(write_settings(project, groups="RecFem", missing=both))
    assert done.project.extrapolated == {both: ("semiten_l",)}
    assert both in done.project.notes[0] and "recfem_l" in done.project.notes[0]
    done.save(tmp_path / "one")
    assert load_subject(tmp_path / "one").extrapolated == {both: ("semiten_l",)}
    done = prepare_subject(write_settings(project, missing=both))
    assert done.project.extrapolated == {} and "--undriven" not in " ".join(done.project.notes)
    done.save(tmp_path / "none")
    assert load_subject(tmp_path / "none").extrapolated is None


def test_passive_trials_that_are_not_taken_over_are_told(project):
    named = "<passive_data_input_directory>thelen</passive_data_input_directory>"
    others = f"<MuscleTendonLengthInitialization>{named}</MuscleTendonLengthInitialization>"
    (note,) = read_project(write_settings(project, others=others)).notes
    assert "'thelen'" in note and "[[passive]]" in note


def rename(folder, *_):
    (folder / "preprocessed" / "EMGData" / "gait_1.sto").rename(folder / "preprocessed" / "gait_1.sto")


def shorten(folder, *_):
    file = folder / "preprocessed" / "IKData" / "gait_2.sto"
    whole = read_storage(file)
    write_storage(file, Storage("ik", whole.columns, whole.time[:140], whole.values[:140]))


def lose_model(folder, *_):
    (folder / "models" / "model.osim").unlink()


def lose_trials(folder, *_):
    shutil.rmtree(folder / "preprocessed" / "IKData")


def spoil_mass(folder, *_):
    file = folder / "models" / "model.osim"
    file.write_text(file.read_text().replace("<mass>5</mass>", "<mass>heavy</mass>", 1))


@pytest.mark.parametrize(
    ("harm", "changes", "said"),
    [
        (spoil_mass, {}, "found 'heavy'"),
        (None, {"groups": "RecFem SemiTenn"}, "did you mean 'SemiTen'"),
        (None, {"missing": "SemiTenn"}, "did you mean 'SemiTen'"),
        (None, {"groups": ""}, "collected_emg_channel_muscle_groups"),
        (None, {"coordinates": "hip_flexion_l knee_angle_r"}, "one leg"),
        (None, {"prefixes": "squat"}, "begin with squat"),
        (None, {"osimx": "none.osimx"}, "none.osimx"),
        (rename, {}, "the trial 'gait_1'"),
        (shorten, {}, "found 140"),
        (lose_model, {}, "model.osim"),
        (lose_trials, {}, "IKData"),
    ],
)
def test_what_is_wrong_is_said(project, harm, changes, said):
    settings = write_settings(project, **changes)
    if harm:
        harm(project)
    with pytest.raises(InputError, match=said):
        read_project(settings)


def test_other_documents_are_refused(project):
    (project / "other.xml").write_text(
        "<NMSMPipelineDocument><JointModelPersonalizationTool/></NMSMPipelineDocument>", encoding="utf-8"
    )
    with pytest.raises(InputError, match="JointModelPersonalizationTool"):
        read_project(project / "other.xml")


def test_the_command_takes_a_project_like_raw_files(project, tmp_path, capsys):
    settings, out = write_settings(project, missing="SemiTen", groups="RecFem"), tmp_path / "subject"
    assert main(["prepare", str(settings), "--out", str(out), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert list(content["trials"]) == list(STARTS) and "SemiTen" in content["notes"][0]
    assert main(["check", str(out), "--quiet"]) == 0
    assert main(["prepare", str(write_settings(project, groups="Sol")), "--out", str(tmp_path / "no")]) == 2
    assert "'Sol'" in capsys.readouterr().err and not (tmp_path / "no").exists()


def test_a_recorded_leg_as_the_lab_keeps_it(s1_left, tmp_path):
    """The lab's own groups of muscles are the channels that its subject was given."""
    subject = load_subject(s1_left)
    groups = read_model_file(s1_left / "model.osim").groups
    names = {frozenset(members): group for group, members in groups.items()}
    renamed = tuple(names[frozenset(own)] for own in _driven(subject).values())
    assert len(set(renamed)) == len(subject.trials.channels)
    analysed = ("walk_0p5_1", "walk_0p8_1")
    shutil.copyfile(s1_left / "model.osim", tmp_path / "model.osim")
    for name in subject.trials.names:
        for kind, folder in FOLDERS.items():
            file = s1_left / "trials" / name / f"{kind}.sto"
            place = tmp_path / "preprocessed" / folder / f"{name}.sto"
            place.parent.mkdir(parents=True, exist_ok=True)
            if kind != "emg":
                shutil.copyfile(file, place)
                continue
            table = read_storage(file)
            columns = tuple(
                dict(zip(subject.trials.channels, renamed, strict=True))[name] for name in table.columns
            )
            write_storage(place, Storage("emg", columns, table.time, table.values))
        if name not in analysed:
            continue
        for file in (s1_left / "reference_geometry" / name).iterdir():
            kind = file.name.replace("length", "Length").replace("moment_arm", "MomentArm")
            place = tmp_path / "preprocessed" / "MAData" / name / f"{name}_{kind}"
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, place)
    text = SETTINGS.replace("models\\model.osim", "model.osim")
    (tmp_path / "settings.xml").write_text(
        text.format(
            osimx="",
            coordinates=" ".join(subject.trials.moment_coordinates),
            groups=" ".join(renamed),
            missing="",
            prefixes="",
            others="",
        ),
        encoding="utf-8",
    )
    done = prepare_subject(tmp_path / "settings.xml")
    # The lab's lengths are OpenSim's within a millimeter. Its moment arms are polynomials' derivatives, which
    # step over the frames where OpenSim's paths jump on or off a cylinder.
    largest, warning, absent = done.project.notes
    assert float(re.search(r"lengths \w+ ([0-9.]+) mm", largest)[1]) < 1.0
    assert warning.startswith("warning") and "lengths of" not in warning and "moment arms of glmax" in warning
    assert "walk_0p5_2" in absent and not set(analysed) & set(absent.split(", "))
    done.save(tmp_path / "subject")
    again = load_subject(tmp_path / "subject")
    assert again.muscles.names == subject.muscles.names
    np.testing.assert_allclose(again.trials.time, subject.trials.time, atol=1e-6)
    np.testing.assert_allclose(again.trials.moments, subject.trials.moments, atol=1e-3)
    np.testing.assert_allclose(again.trials.emg, subject.trials.emg, atol=1e-4)


def _driven(subject):
    return {
        channel: tuple(
            muscle
            for muscle, own in zip(subject.muscles.names, subject.muscle_channels, strict=True)
            if own == number
        )
        for number, channel in enumerate(subject.trials.channels)
    }
