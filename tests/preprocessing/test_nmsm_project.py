"""Conversion of projects of the NMSM Pipeline into subjects, and error messages for invalid projects."""

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
from wrapjax.preprocessing.nmsm.project import FOLDERS, read_project
from wrapjax.preprocessing.preparation import prepare_subject
from wrapjax.subject.subject import load_subject


def test_a_converted_project_has_the_signals_of_the_subject(project, tmp_path):
    prepare_subject(write_settings(project)).save(tmp_path / "person")
    subject = load_subject(tmp_path / "person")
    trials = subject.trials
    assert subject.name == "person" and subject.side == "l" and subject.mass_kg == 10.0
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


def test_lengths_of_an_earlier_step_replace_those_of_the_model(project, tmp_path):
    done = prepare_subject(write_settings(project, osimx="earlier.osimx"))
    assert "calibrated anew" in done.project.notes[0]
    done.save(tmp_path / "subject")
    muscles = load_subject(tmp_path / "subject").muscles
    model = read_model_file(tmp_path / "models" / "model.osim").muscles
    np.testing.assert_array_equal(muscles.optimal_fiber_length, [model.optimal_fiber_length[0], 0.17])
    np.testing.assert_array_equal(muscles.tendon_slack_length, model.tendon_slack_length)


def test_prefixes_select_trials(project):
    done = read_project(write_settings(project, prefixes="gait_2"))
    assert [trial.name for trial in done.trials] == ["gait_2"] and done.notes == ()


def test_groups_without_emg_are_kept_for_synergies(project, tmp_path):
    """Synergies drive the groups of the project, and a note states the option for this."""
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
    """Muscles with a channel are removed from groups without EMG, which is noted."""
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


def test_passive_trials_that_are_not_converted_are_noted(project):
    named = "<passive_data_input_directory>thelen</passive_data_input_directory>"
    others = f"<MuscleTendonLengthInitialization>{named}</MuscleTendonLengthInitialization>"
    (note,) = read_project(write_settings(project, others=others)).notes
    assert "'thelen'" in note and "[[passive]]" in note


def rename_emg(folder, *_):
    (folder / "preprocessed" / "EMGData" / "gait_1.sto").rename(folder / "preprocessed" / "gait_1.sto")


def shorten_angles(folder, *_):
    file = folder / "preprocessed" / "IKData" / "gait_2.sto"
    whole = read_storage(file)
    write_storage(file, Storage("ik", whole.columns, whole.time[:140], whole.values[:140]))


def delete_model(folder, *_):
    (folder / "models" / "model.osim").unlink()


def delete_angles(folder, *_):
    shutil.rmtree(folder / "preprocessed" / "IKData")


def invalid_mass(folder, *_):
    file = folder / "models" / "model.osim"
    file.write_text(file.read_text().replace("<mass>5</mass>", "<mass>heavy</mass>", 1))


@pytest.mark.parametrize(
    ("damage", "changes", "message"),
    [
        (invalid_mass, {}, "found 'heavy'"),
        (None, {"groups": "RecFem SemiTenn"}, "did you mean 'SemiTen'"),
        (None, {"missing": "SemiTenn"}, "did you mean 'SemiTen'"),
        (None, {"groups": ""}, "collected_emg_channel_muscle_groups"),
        (None, {"coordinates": "hip_flexion_l knee_angle_r"}, "one leg"),
        (None, {"prefixes": "squat"}, "begin with squat"),
        (None, {"osimx": "none.osimx"}, "none.osimx"),
        (rename_emg, {}, "the trial 'gait_1'"),
        (shorten_angles, {}, "found 140"),
        (delete_model, {}, "model.osim"),
        (delete_angles, {}, "IKData"),
    ],
)
def test_faults_are_reported(project, damage, changes, message):
    settings = write_settings(project, **changes)
    if damage:
        damage(project)
    with pytest.raises(InputError, match=message):
        read_project(settings)


def test_other_documents_are_refused(project):
    (project / "other.xml").write_text(
        "<NMSMPipelineDocument><JointModelPersonalizationTool/></NMSMPipelineDocument>", encoding="utf-8"
    )
    with pytest.raises(InputError, match="JointModelPersonalizationTool"):
        read_project(project / "other.xml")


def test_the_command_accepts_a_project(project, tmp_path, capsys):
    settings, out = write_settings(project, missing="SemiTen", groups="RecFem"), tmp_path / "subject"
    assert main(["prepare", str(settings), "--out", str(out), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert list(content["trials"]) == list(STARTS) and "SemiTen" in content["notes"][0]
    assert main(["check", str(out), "--quiet"]) == 0
    assert main(["prepare", str(write_settings(project, groups="Sol")), "--out", str(tmp_path / "no")]) == 2
    assert "'Sol'" in capsys.readouterr().err and not (tmp_path / "no").exists()


def test_a_recorded_leg_in_the_layout_of_a_project(s1_left, tmp_path):
    """The groups of muscles in the laboratory's model are the channels of its subject."""
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
    # The lengths of the laboratory agree with OpenSim's within 1 mm. Its moment arms are derivatives of
    # polynomials, which are smooth where OpenSim's paths jump onto or off a cylinder.
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
