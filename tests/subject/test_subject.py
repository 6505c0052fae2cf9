"""Reading of synthetic and recorded subject folders."""

import re
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.subject.synthetic import CHANNELS, COORDINATES, emg, moments, write_subject
from wrapjax.io.storage import Storage, read_storage, write_storage
from wrapjax.subject.description import describe_subject, render_tables
from wrapjax.subject.subject import load_subject


def replace_text(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_synthetic_subject(tmp_path):
    folder = write_subject(tmp_path)
    subject = load_subject(folder)
    assert (subject.name, subject.mass_kg, subject.side, subject.paretic) == ("synthetic", 70.0, "l", None)
    assert subject.model_file == folder / "model.osim"
    assert subject.muscles.names == ("recfem_l", "semiten_l")
    np.testing.assert_array_equal(subject.muscles.max_isometric_force, [1500.0, 900.0])
    assert subject.muscle_channels == (0, 1)
    assert subject.activation_groups == (("recfem_l", "semiten_l"),)
    assert subject.fiber_length_groups == ()
    assert subject.undriven_muscles == ()
    assert subject.trials.channels == tuple(CHANNELS)
    assert subject.trials.coordinates == subject.trials.moment_coordinates == COORDINATES
    assert [recording.name for recording in subject.recordings] == ["walk_a", "walk_b"]
    assert subject.emg_rates == pytest.approx((100.0, 100.0))
    assert load_subject(folder / "subject.toml").trials.names == subject.trials.names


def test_driven_muscles_are_in_the_order_of_the_channels(tmp_path):
    folder = write_subject(tmp_path)
    replace_text(folder / "subject.toml", 'RecFem = ["recfem_l"]\n', "")
    replace_text(folder / "subject.toml", '["semiten_l"]', '["semiten_l"]\nRecFem = ["recfem_l"]')
    subject = load_subject(folder)
    assert subject.muscles.names == ("semiten_l", "recfem_l")
    np.testing.assert_array_equal(subject.muscles.max_isometric_force, [900.0, 1500.0])
    np.testing.assert_allclose(subject.trials.emg[0], emg(subject.trials.emg_time[0])[::-1], atol=1e-6)


def test_undriven_muscles_are_listed(tmp_path):
    folder = write_subject(tmp_path)
    replace_text(folder / "subject.toml", 'RecFem = ["recfem_l"]\n', "")
    subject = load_subject(folder)
    assert subject.undriven_muscles == ("recfem_l",)
    assert subject.activation_groups == ()


def test_table_of_parameters_takes_precedence(tmp_path):
    folder = write_subject(tmp_path)
    replace_text(folder / "subject.toml", "[model]", '[model]\nmuscle_parameters = "m.csv"')
    (folder / "m.csv").write_text(
        "\ufeffmuscle,emg_channel,tendon_slack_length_m,max_isometric_force_N,optimal_fiber_length_m,pennation_rad\r\n"
        "semiten_l,SemiTen,0.26,901,0.16,0\r\n\r\nrecfem_l,RecFem,0.31,1501,0.11,0.2\r\n"
    )
    muscles = load_subject(folder).muscles
    assert muscles.names == ("recfem_l", "semiten_l")
    np.testing.assert_array_equal(muscles.max_isometric_force, [1501.0, 901.0])
    np.testing.assert_array_equal(muscles.optimal_fiber_length, [0.11, 0.16])
    np.testing.assert_array_equal(muscles.tendon_slack_length, [0.31, 0.26])
    np.testing.assert_array_equal(muscles.pennation_angle, [0.2, 0.0])


def test_degrees_and_full_paths_give_the_same_angles(tmp_path):
    plain = load_subject(write_subject(tmp_path / "plain"))
    folder = write_subject(tmp_path / "other")
    for trial in ("walk_a", "walk_b"):
        path = folder / "trials" / trial / "angles.sto"
        table = read_storage(path)
        columns = ["/jointset/hip_l/hip_flexion_l/value", "/jointset/knee_l/knee_angle_l/value"]
        columns += [column.replace("value", "speed") for column in columns]
        values = np.hstack([np.rad2deg(table.values), 7.0 * table.values])
        write_storage(path, Storage("states", tuple(columns), table.time, values, in_degrees=True))
    other = load_subject(folder)
    np.testing.assert_allclose(other.trials.angles, plain.trials.angles, atol=1e-12)
    np.testing.assert_allclose(other.trials.angular_velocities, plain.trials.angular_velocities, atol=1e-9)


def test_moments_are_not_converted_from_degrees(tmp_path):
    """OpenSim writes inDegrees=yes into files of forces too, but only angles are converted."""
    folder = write_subject(tmp_path)
    for trial in ("walk_a", "walk_b"):
        replace_text(folder / "trials" / trial / "moments.sto", "inDegrees=no", "inDegrees=yes")
        replace_text(folder / "trials" / trial / "emg.sto", "inDegrees=no", "inDegrees=yes")
    trials = load_subject(folder).trials
    np.testing.assert_allclose(trials.moments[0], moments(trials.time[0]), atol=1e-5)
    np.testing.assert_allclose(trials.emg[0], emg(trials.emg_time[0]), atol=1e-6)


def test_coordinates_are_those_of_all_angle_files(tmp_path):
    folder = write_subject(tmp_path)
    replace_text(folder / "subject.toml", '"hip_flexion_l", "knee_angle_l"]', '"knee_angle_l"]')
    assert load_subject(folder).trials.coordinates == COORDINATES
    replace_text(folder / "trials" / "walk_b" / "angles.sto", "hip_flexion_l", "hip_flexion_r")
    trials = load_subject(folder).trials
    assert trials.coordinates == trials.moment_coordinates == ("knee_angle_l",)


def test_negative_envelopes_are_clipped_and_noted(tmp_path):
    folder = write_subject(tmp_path)
    path = folder / "trials" / "walk_b" / "emg.sto"
    table = read_storage(path)
    write_storage(path, Storage("emg", table.columns, table.time, table.values - [0.0, 0.15]))
    subject = load_subject(folder)
    assert subject.trials.emg.min() == 0.0
    assert len(subject.notes) == 1 and "-0.05" in subject.notes[0] and "SemiTen" in subject.notes[0]


@pytest.mark.parametrize(
    ("mass", "expected"),
    [(154.3, "is it in lb?"), (60.0, "is the model scaled to the person?"), (72.0, None)],
)
def test_an_implausible_mass_is_noted(tmp_path, mass, expected):
    """A model that is lighter than the person is accepted, as it may have a leg only."""
    folder = write_subject(tmp_path / "s")
    assert load_subject(folder).notes == ()
    model, settings = folder / "model.osim", folder / "subject.toml"
    bodies = model.read_text().count("<mass>5</mass>")
    model.write_text(model.read_text().replace("<mass>5</mass>", f"<mass>{70.0 / bodies}</mass>"))
    settings.write_text(re.sub("mass_kg = .*", f"mass_kg = {mass}", settings.read_text()))
    notes = load_subject(folder).notes
    assert len(notes) == (expected is not None)
    assert all(expected in note and f"{mass:.4g}" in note and "70 kg" in note for note in notes)


def test_raw_emg_is_normalised_over_all_trials(tmp_path):
    """Noise of twice the amplitude has twice the envelope, and the larger envelope has the peak 1."""
    folder = write_subject(tmp_path)
    replace_text(folder / "subject.toml", '"envelope"', '"raw"')
    time_axis = np.arange(4001) / 1000.0
    rng = np.random.default_rng(5)
    for trial, amplitude in (("walk_a", 1e-4), ("walk_b", 2e-4)):
        values = amplitude * rng.standard_normal((time_axis.size, 2))
        write_storage(
            folder / "trials" / trial / "emg.sto", Storage("emg", tuple(CHANNELS), time_axis, values)
        )
    trials = load_subject(folder).trials
    np.testing.assert_array_equal(trials.emg.max(axis=(0, 2)), [1.0, 1.0])
    assert trials.emg.min() >= 0.0
    ratio = trials.emg[2].mean() / trials.emg[:2].mean()
    assert ratio == pytest.approx(2.0, rel=0.1)


def test_overlap_of_validation_and_calibration_is_noted(tmp_path):
    folder = write_subject(tmp_path)
    replace_text(folder / "subject.toml", "trials/walk_b/", "trials/walk_a/")
    notes = load_subject(folder).notes
    assert len(notes) == 1 and "overlap in 2 pairs of cycles" in notes[0]


def test_other_leg_may_be_outside_the_folder(tmp_path):
    write_subject(tmp_path / "right")
    folder = write_subject(tmp_path / "left")
    replace_text(folder / "subject.toml", 'side = "l"', 'side = "l"\nparetic = true\nother_leg = "../right"')
    subject = load_subject(folder)
    assert subject.paretic is True
    assert subject.other_leg is not None and subject.other_leg.resolve() == tmp_path / "right"


def test_description(tmp_path):
    folder = write_subject(tmp_path)
    replace_text(folder / "subject.toml", 'RecFem = ["recfem_l"]\n', "")
    tables = describe_subject(load_subject(folder))
    by_title = {table.title: table for table in tables}
    overview = dict(by_title["Subject synthetic"].rows)
    assert overview["undriven muscles"] == "recfem_l"
    assert overview["calibration cycles"] == 2 and overview["validation cycles"] == 1
    (channel,) = by_title["EMG channels"].rows
    assert (
        channel[0] == "SemiTen" and channel[1] == pytest.approx(0.5, abs=1e-3) and channel[3] == "semiten_l"
    )
    assert by_title["Trials"].rows[0][:4] == ("walk_a", "calibration", 1.1, 2)
    assert by_title["Trials"].rows[1][2] is None
    coordinates = by_title["Joint angles and moments over all cycles"].rows
    hip = (np.rad2deg(-0.2), np.rad2deg(0.6), -40.0, 40.0)
    assert coordinates[0][0] == "hip_flexion_l"
    np.testing.assert_allclose(coordinates[0][1:], hip, rtol=1e-3)
    for table in tables:
        assert all(len(row) == len(table.header) for row in table.rows)


def test_text_is_aligned(tmp_path):
    text = render_tables(describe_subject(load_subject(write_subject(tmp_path))))
    assert "Notes" not in text  # no table without notes
    lines = text.splitlines()
    start = lines.index("Trials")
    header, rule, first, second = lines[start + 1 : start + 5]
    # Numbers end where their column ends.
    end = header.index("cycles") + len("cycles")
    assert first[end - 1] == "2" and second[end - 1] == "1" and rule[end - 1] == "-"
    assert "nan" not in text


def test_s1_left(s1_left):
    started = time.perf_counter()
    subject = load_subject(s1_left)
    assert time.perf_counter() - started < 1.0
    trials = subject.trials
    assert trials.names == tuple(f"walk_0p{speed}_{order}" for speed in (5, 8) for order in (1, 2, 3, 4))
    assert trials.uses.count("calibration") == 6
    np.testing.assert_array_equal(trials.speeds, [0.5] * 4 + [0.8] * 4)
    assert len(subject.muscles.names) == 34 and len(trials.channels) == 16
    assert subject.muscles.names[:2] == ("addbrev_l", "addlong_l") and subject.muscles.names[-1] == "vaslat_l"
    assert subject.undriven_muscles == ("ehl_l", "fhl_l", "grac_l", "piri_l", "sart_l", "tfl_l")
    # The table's fiber length, not the model's 0.0476 m.
    soleus = subject.muscles.names.index("soleus_l")
    assert subject.muscles.optimal_fiber_length[soleus] == pytest.approx(0.0621, abs=5e-5)
    assert trials.channels[subject.muscle_channels[soleus]] == "Sol"
    assert subject.notes == ()
    # Angles were recorded at the frames to which they are resampled.
    table = read_storage(s1_left / "trials" / "walk_0p8_4" / "angles.sto")
    np.testing.assert_allclose(trials.angles[-1], np.deg2rad(table.values.T), atol=1e-6)
    assert trials.padding == 20


def _left(*groups):
    return tuple(tuple(f"{name}_l" for name in group.split()) for group in groups)


def test_groups_of_s1_left(s1_left):
    subject = load_subject(s1_left)
    adductors = "addbrev addlong addmagDist addmagIsch addmagMid addmagProx"
    gluteals = ("glmax1 glmax2 glmax3", "glmed1 glmed2 glmed3", "glmin1 glmin2 glmin3")
    assert subject.activation_groups == _left(
        adductors, *gluteals, "iliacus psoas", "semimem semiten", "bflh bfsh", "perbrev perlong"
    )
    assert subject.fiber_length_groups == _left(
        adductors,
        *gluteals,
        "vasint vaslat vasmed",
        "semimem semiten bflh",
        "perbrev perlong",
        "iliacus psoas",
        "gaslat gasmed soleus",
        "tibant edl",
        "tibpost fdl",
    )


def test_healthy_overground(data_folder):
    """Labels with full paths, a right leg, and standard groups, as the model has none."""
    subject = load_subject(data_folder / "healthy_overground")
    assert subject.side == "r" and len(subject.trials) == 1 and len(subject.muscles.names) == 21
    assert "pelvis_ty" in subject.trials.coordinates
    assert 0.8 < subject.trials.angles[0, subject.trials.coordinates.index("pelvis_ty")].min() < 1.2
    assert subject.activation_groups == (
        ("glmax1_r", "glmax2_r", "glmax3_r"),
        ("glmed1_r", "glmed2_r", "glmed3_r"),
        ("glmin1_r", "glmin2_r", "glmin3_r"),
        ("semimem_r", "semiten_r"),
        ("bflh_r", "bfsh_r"),
    )
    assert ("gaslat_r", "gasmed_r", "soleus_r") in subject.fiber_length_groups
    assert np.isnan(subject.trials.speeds).all()
    assert subject.emg_rates == pytest.approx((2000.0,), rel=1e-6)
    assert any("40 columns" in note for note in subject.notes)


def test_healthy_treadmill(data_folder):
    """Degrees, 53 cycles, negative envelopes, and a file of ground forces that is not read."""
    started = time.perf_counter()
    subject = load_subject(data_folder / "healthy_treadmill")
    assert time.perf_counter() - started < 2.0
    trials = subject.trials
    assert trials.names[0] == "walk_a/01" and trials.names[-1] == "walk_b/23" and len(trials) == 53
    assert trials.moment_coordinates == ("knee_angle_l", "ankle_angle_l") and len(trials.coordinates) == 25
    knee = trials.angles[:, trials.coordinates.index("knee_angle_l")]
    beta = trials.angles[:, trials.coordinates.index("knee_angle_l_beta")]
    assert 1.0 < knee.max() < 1.3
    # The coupled coordinate of the patella is in radians even so, as OpenSim writes it.
    np.testing.assert_allclose(beta, knee, atol=1e-3)
    assert any("negative values" in note and "vaslat_l_activation" in note for note in subject.notes)
    assert trials.emg.min() >= 0.0
    assert trials.recordings.count("walk_a") == 30


def test_reading_needs_no_opensim():
    """Reading uses NumPy and SciPy only."""
    code = (
        "import sys, wrapjax.subject; print([name for name in ('opensim', 'pandas') if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
