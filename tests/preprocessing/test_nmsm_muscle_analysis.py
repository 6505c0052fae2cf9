"""Comparison of the muscle geometry of a project (``MAData``) with that of its model."""

import numpy as np
import pytest

from tests.preprocessing.synthetic_project import ADDITIONAL_FRAMES, STARTS, write_settings
from tests.subject.synthetic import COORDINATES, MODEL, PERIOD, angles
from wrapjax.cli.command_line import main
from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, write_storage
from wrapjax.preprocessing.preparation import prepare_subject
from wrapjax.subject.subject import load_subject

MUSCLES = {"recfem_l": 0.05, "semiten_l": -0.05}
KNEE, INSERTION = np.array([0.0, -0.4]), -0.05


def analytic_geometry(time):
    """Compute lengths and moment arms of the straight muscles of `MODEL`, m.

    The muscles run from ground to the shank over two pin joints. A moment arm is -dL/dq; a rotation about z
    moves a point by the cross product of z and its position.
    """
    hip, knee = angles(time)

    def rotated(angle, x, y):
        return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y])

    length, arms = {}, {name: {} for name in COORDINATES}
    axis = rotated(hip, *KNEE)
    for muscle, forward in MUSCLES.items():
        point = axis + rotated(hip + knee, forward, INSERTION)
        along = point - np.array([[forward], [0.0]])
        length[muscle] = np.linalg.norm(along, axis=0)
        for name, center in zip(COORDINATES, (np.zeros((2, 1)), axis), strict=True):
            x, y = point - center
            arms[name][muscle] = -(along[1] * x - along[0] * y) / length[muscle]
    return length, arms


def write_analysis(folder, spoil=lambda trial, length, arms: None, trials=tuple(STARTS), muscles=MUSCLES):
    """Write ``MAData`` with the file names of OpenSim's analysis, after ``spoil`` has changed the values."""
    for trial in trials:
        time = STARTS[trial] + PERIOD / 100 * np.arange(-ADDITIONAL_FRAMES, 101 + ADDITIONAL_FRAMES)
        length, arms = analytic_geometry(time)
        spoil(trial, length, arms)
        place = folder / "preprocessed" / "MAData" / trial
        tables = {"Length": length, **{f"MomentArm_{name}": own for name, own in arms.items()}}
        # Other tables of the analysis have similar names.
        tables["TendonLength"] = tables["FiberLength"] = {name: 0.0 * time for name in muscles}
        for kind, own in tables.items():
            values = np.array([own[name] for name in muscles]).T
            write_storage(place / f"{trial}_{kind}.sto", Storage(kind, tuple(muscles), time, values))


def notes_of(folder, **changes):
    return prepare_subject(write_settings(folder, **changes)).project.notes


def test_agreement_is_reported_with_numbers(project):
    write_analysis(project)
    (note,) = notes_of(project)
    assert note.startswith(
        "MAData compared with the muscle paths of the model: the largest difference of lengths"
    )
    assert note.count(" 0.00 mm (rms 0.00)") == 2 and "of moment arms" in note


def spoiled(trial, length, arms):
    if trial == "gait_2":
        length["semiten_l"] = length["semiten_l"] + 0.005
        arms["knee_angle_l"]["recfem_l"] = -arms["knee_angle_l"]["recfem_l"]
        length["recfem_l"] = length["recfem_l"] - 0.0007


def test_differences_are_reported_with_muscle_coordinate_and_size(project, tmp_path, capsys):
    """A wrong sign, and 5 mm, are reported; a difference below 1 mm is not."""
    write_analysis(project, spoiled)
    largest, warning = notes_of(project)
    arms = analytic_geometry(STARTS["gait_2"] + PERIOD / 100 * np.arange(101))[1]
    rotated = 2e3 * arms["knee_angle_l"]["recfem_l"]
    rms = np.sqrt(np.mean(rotated**2))
    length = "semiten_l 5.00 mm (rms 5.00) in gait_2"
    arm = f"recfem_l about knee_angle_l {np.abs(rotated).max():.2f} mm (rms {rms:.2f}) in gait_2"
    assert largest.endswith(f"lengths {length}; of moment arms {arm}")
    assert warning.startswith("warning")
    assert f"lengths of {length}; moment arms of {arm}. It is not used" in warning
    assert "recfem_l 0.70" not in warning and "hip_flexion_l" not in warning
    # The warning is in all outputs, and the subject can be used.
    assert main(["prepare", str(write_settings(project)), "--out", str(tmp_path / "subject")]) == 0
    assert "semiten_l 5.00 mm" in capsys.readouterr().out
    for file in ("preparation.json", "report.html", "subject.toml"):
        assert "semiten_l 5.00 mm" in (tmp_path / "subject" / file).read_text()
    load_subject(tmp_path / "subject")


def test_additional_frames_are_not_compared(project):
    """They have edge effects of filters and are not used."""

    def odd(trial, length, arms):
        length["recfem_l"] = length["recfem_l"] + 0.01 * (
            np.arange(101 + 2 * ADDITIONAL_FRAMES) < ADDITIONAL_FRAMES - 1
        )

    write_analysis(project, odd)
    assert len(notes_of(project)) == 1


def test_missing_tables_are_reported(project):
    assert notes_of(project) == ()
    write_analysis(project, trials=("gait_1",))
    assert notes_of(project)[1:] == ("MAData lacks the trials gait_2",)
    assert len(notes_of(project, prefixes="gait_1")) == 1
    for file in (project / "preprocessed" / "MAData" / "gait_1").glob("*_Length.sto"):
        file.unlink()
    assert "lengths" not in notes_of(project)[0] and "moment arms" in notes_of(project)[0]
    for file in (project / "preprocessed" / "MAData" / "gait_1").glob("*_MomentArm_*"):
        file.unlink()
    assert "not compared" in notes_of(project)[0]


def test_muscles_without_emg_are_compared_too(project):
    """Synergies can drive them."""
    write_analysis(project, spoiled)
    assert "semiten_l 5.00 mm" in " ".join(notes_of(project, groups="RecFem", missing="SemiTen"))
    assert "semiten_l" not in " ".join(notes_of(project, groups="RecFem"))


def test_a_broken_table_is_refused(project):
    write_analysis(project)
    file = project / "preprocessed" / "MAData" / "gait_2" / "gait_2_MomentArm_knee_angle_l.sto"
    file.write_text(file.read_text()[:400])
    with pytest.raises(InputError, match="gait_2_MomentArm_knee_angle_l"):
        notes_of(project)


def test_a_model_that_cannot_be_analysed_is_still_converted(project):
    write_analysis(project)
    constraint = (
        '<ConstraintSet name="constraintset"><objects><ConstantDistanceConstraint name="rope">'
        "<socket_body_1>/bodyset/femur_l</socket_body_1><socket_body_2>/bodyset/tibia_l</socket_body_2>"
        "<constant_distance>0.4</constant_distance></ConstantDistanceConstraint></objects></ConstraintSet>"
    )
    file = project / "models" / "model.osim"
    assert MODEL.count("<ForceSet") == 1
    file.write_text(file.read_text().replace("<ForceSet", constraint + "<ForceSet", 1))
    (note,) = notes_of(project)
    assert note.startswith("MAData is not compared") and "rope" in note
