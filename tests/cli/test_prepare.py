"""``wrapjax prepare``: a subject folder from a laboratory's files, or all errors with numbers.

The simulated walker's motion, forces and EMG are known, and are compared with the prepared ones.
"""

import json
import subprocess
import sys

import numpy as np
import pytest

from tests.osim.test_scaling import SETUP
from tests.preprocessing import walker, walker_c3d
from wrapjax.io.storage import read_storage
from wrapjax.osim.model import describe_model
from wrapjax.report import markup
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """The walker's files, with one marker missing for 0.4 s and another for 0.05 s. Read-only."""
    folder = tmp_path_factory.mktemp("lab")
    settings = walker.write_laboratory(folder)
    lines = (folder / "walk.trc").read_text().splitlines()
    names = lines[3].split("\t")[2::3]
    for name, first, last in (("P3", 120, 160), ("LT0", 200, 205)):
        for frame in range(first, last):
            cells = lines[6 + frame].split("\t")
            start = 2 + 3 * names.index(name)
            cells[start : start + 3] = ["", "", ""]
            lines[6 + frame] = "\t".join(cells)
    (folder / "walk.trc").write_text("\n".join(lines) + "\n")
    return settings


@pytest.fixture(scope="module")
def prepared(run, laboratory, tmp_path_factory):
    folder = tmp_path_factory.mktemp("prepared") / "walker"
    return run("prepare", laboratory, "--out", folder), folder


def test_the_folder_is_a_subject(run, prepared):
    outcome, folder = prepared
    assert outcome.status == 0, outcome.progress
    assert "no cycle is kept back for validation" in outcome.output
    assert ", from markers, ground forces and raw EMG." in (folder / "report.html").read_text()
    # OpenSim must not print into the output.
    assert "MODEL" not in outcome.output and "inverse kinematics" in outcome.progress
    assert run("check", folder).status == 0
    subject = load_subject(folder)
    assert len(subject.trials.time) == 3 and subject.mass_kg == walker.MASS


def test_settings_are_stored_verbatim(laboratory, prepared):
    folder = prepared[1]
    assert (folder / "prepared_from.toml").read_text() == laboratory.read_text()
    assert "from prepared_from.toml" in (folder / "subject.toml").read_text().splitlines()[0]


def test_cycles_start_at_left_foot_strikes(prepared):
    starts = load_subject(prepared[1]).trials.time[:, 0]
    # The simulated force reaches 30 N only 16 ms after the strike.
    np.testing.assert_allclose(starts, walker.STRIKES[:3], atol=0.02)


def test_the_report_shows_forces_and_all_cycles(prepared):
    page = (prepared[1] / "report.html").read_text()
    content = json.loads((prepared[1] / "preparation.json").read_text())
    # Measured and required forces, angles, moments and EMG; no external resources.
    assert page.count('<img alt="') == 4 and "http" not in page.split("base64,")[0]
    assert "3 gait cycles can be used for calibration." in page
    for check in content["trials"]["walk"]["checks"]:
        assert markup.text(check["found"]) in page


def test_inverse_kinematics_in_jax_gives_the_same_angles(run, laboratory, prepared, tmp_path):
    for file in laboratory.parent.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    settings = tmp_path / laboratory.name
    settings.write_text(settings.read_text() + '\n[markers]\ninverse_kinematics = "wrapjax"\n')
    outcome = run("prepare", settings, "--out", tmp_path / "out")
    assert outcome.status == 0, outcome.progress
    ours, theirs = (
        read_storage(folder / "trials" / "walk" / "angles.sto") for folder in (tmp_path / "out", prepared[1])
    )
    assert ours.columns == theirs.columns
    np.testing.assert_allclose(ours.values, theirs.values, atol=2e-4)


def test_angles_are_recovered(prepared):
    table = read_storage(prepared[1] / "trials" / "walk" / "angles.sto")
    truth = walker.motion(table.time)
    for name, expected in truth.items():
        # 0.005 is 0.3 degrees or 5 mm: the attenuation of movements of 1.8 Hz by a filter at 6.4 Hz.
        np.testing.assert_allclose(
            table.values[:, table.columns.index(name)], expected, atol=0.005, err_msg=name
        )
    beta = table.values[:, table.columns.index("knee_angle_l_beta")]
    np.testing.assert_allclose(beta, 0.7 * truth["knee_angle_l"] + 0.1, atol=0.004)


def test_the_ankle_moment_agrees_with_statics(prepared):
    """The foot has a mass of 0.84 kg, and the filter moves the ankle by up to 3 mm under 750 N."""
    folder = prepared[1] / "trials" / "walk"
    moments = read_storage(folder / "moments.sto")
    forces = read_storage(folder / "ground_forces.mot")
    column = {name: forces.values[:, place] for place, name in enumerate(forces.columns)}
    frames, _, _, heels, _ = walker.simulated_positions()
    ankle = [np.interp(forces.time, frames, heels[0][:, axis]) for axis in range(3)]
    arm = column["left_px"] - ankle[0], column["left_py"] - ankle[1]
    about = arm[0] * column["left_vy"] - arm[1] * column["left_vx"] + column["left_tz"]
    found = moments.values[:, moments.columns.index("ankle_angle_l_moment")]
    np.testing.assert_allclose(found, -np.interp(moments.time, forces.time, about), atol=3.0)
    assert found.min() < -80.0


def test_one_c3d_file_gives_the_same(run, laboratory, prepared, tmp_path):
    """Markers, plates and EMG in one file, with laboratory axes other than OpenSim's."""
    time, names, places, _, _ = walker.simulated_positions()
    pairs = walker.forces(np.minimum(np.arange(10 * time.size) / 1000.0, time[-1]))
    recordings = {"markers": places, "names": names, "channels": list(walker.CHANNELS)}
    recordings |= {"force": [pair[0] for pair in pairs], "point": [pair[1] for pair in pairs]}
    np.savez(tmp_path / "all.npz", emg=walker.volts()[1], **recordings)
    script = [sys.executable, walker_c3d.__file__, str(tmp_path / "all.npz"), str(tmp_path / "walk.c3d")]
    subprocess.run(script, check=True)
    (tmp_path / "scaled.osim").write_bytes((laboratory.parent / "scaled.osim").read_bytes())
    settings = tmp_path / "prepare.toml"
    settings.write_text(walker.SETTINGS)
    # One cycle suffices and is faster.
    walker.replace_text(
        settings,
        ('force = "left_v"\npoint = "left_p"', "plates = [1]"),
        ('force = "right_v"\npoint = "right_p"', "plates = [2]"),
        ("walk.trc", "walk.c3d"),
        ("forces.mot", "walk.c3d"),
        ('"emg.sto"', '"walk.c3d"\ncycles = [[1.566, 2.666]]'),
        ("[forces.l]", '[laboratory]\nforward = "y"\nup = "z"\n\n[forces.l]'),
    )
    outcome = run("prepare", settings, "--out", tmp_path / "out")
    assert outcome.status == 0, outcome.progress
    # A marker was missing in the other one.
    for name, limit in (("angles", 0.005), ("moments", 2.0)):
        found, expected = (
            read_storage(place / "trials" / "walk" / f"{name}.sto")
            for place in (tmp_path / "out", prepared[1])
        )
        inside = (found.time > 1.566) & (found.time < 2.666)
        for label in ("hip_flexion_l", "knee_angle_l", "ankle_angle_l"):
            label = label if name == "angles" else f"{label}_moment"
            series = [table.values[:, table.columns.index(label)] for table in (found, expected)]
            series[1] = np.interp(found.time, expected.time, series[1])
            np.testing.assert_allclose(series[0][inside], series[1][inside], atol=limit, err_msg=label)


def test_checks_are_reported_with_numbers(prepared):
    outcome, folder = prepared
    told = json.loads((folder / "preparation.json").read_text())["trials"]["walk"]
    whats = {check["what"] for check in told["checks"]}
    assert {"markers", "weight", "timing of forces", "timing of EMG channel Sol"} <= whats
    assert not any(check["fault"] for check in told["checks"])
    assert any("P3" in note and "LT0" not in note for note in told["notes"])
    assert told["motion_and_force_low_pass_hz"] == pytest.approx(7.0 / walker.PERIOD, rel=1e-3)
    assert all(check["found"] in outcome.output for check in told["checks"])


@pytest.fixture
def solved(laboratory, prepared, tmp_path):
    """The same files with precomputed angles, faster than with markers. May be modified."""
    for name in ("scaled.osim", "forces.mot", "emg.sto"):
        (tmp_path / name).write_bytes((laboratory.parent / name).read_bytes())
    angles = prepared[1] / "trials" / "walk" / "angles.sto"
    (tmp_path / "angles.sto").write_bytes(angles.read_bytes())
    text = walker.SETTINGS.replace('markers = "walk.trc"', 'angles = "angles.sto"')
    (tmp_path / "prepare.toml").write_text(text, encoding="utf-8")
    return tmp_path / "prepare.toml"


def _late(settings):
    walker.change_table(settings, "forces.mot", lambda time, columns: (time + 0.05, columns))


def _early(settings):
    walker.change_table(settings, "forces.mot", lambda time, columns: (time - 0.05, columns))


def _swapped(settings):
    walker.replace_text(settings, ('"left_', '"?_'), ('"right_', '"left_'), ('"?_', '"right_'))


def _kilonewtons(settings):
    def change(time, columns):
        return time, {name: 1e-3 * each if "_v" in name else each for name, each in columns.items()}

    walker.change_table(settings, "forces.mot", change)
    walker.replace_text(settings, ('use = "calibration"', 'use = "calibration"\ncycles = [[0.5, 1.6]]'))


def _millimeters(settings):
    def change(time, columns):
        return time, {name: 1e3 * each if "_p" in name else each for name, each in columns.items()}

    walker.change_table(settings, "forces.mot", change)


def _dead(settings):
    walker.change_table(settings, "emg.sto", lambda time, columns: (time, columns | {"RF": 0.0 * time}))


def _clipped(settings):
    def change(time, columns):
        return time, columns | {"RF": np.clip(columns["RF"], -4e-4, 4e-4)}

    walker.change_table(settings, "emg.sto", change)


def _copied(settings):
    walker.change_table(
        settings, "emg.sto", lambda time, columns: (time, columns | {"TA": 2.0 * columns["RF"]})
    )


def _microvolts(settings):
    walker.change_table(
        settings, "emg.sto", lambda time, columns: (time, {k: 1e6 * v for k, v in columns.items()})
    )


def _other_leg(settings):
    """Shift the calf EMG by half a gait cycle, as if it were of the other leg."""
    shift = round(0.5 * walker.PERIOD * walker.EMG_RATE)
    walker.change_table(settings, "emg.sto", lambda time, c: (time, c | {"Sol": np.roll(c["Sol"], shift)}))


def _degrees(settings):
    walker.change_table(
        settings, "angles.sto", lambda time, c: (time, {k: np.degrees(v) for k, v in c.items()})
    )


def _misspelt(settings):
    walker.replace_text(settings, ("Sol =", "Soll ="))


def _misspelt_muscle(settings):
    walker.replace_text(settings, ('RF = ["recfem_l"]', 'RF = ["rectfem_l"]'))


def _without_unit(settings):
    walker.replace_text(settings, ('unit = "V"', ""))


def _without_forces(settings):
    walker.replace_text(settings, ('forces = "forces.mot"\n', ""))


def _elsewhere(settings):
    walker.replace_text(settings, ('body = "calcn_r"', 'body = "calc_r"'))


def _right_alone(settings):
    text = settings.read_text()
    start, end = text.index("[forces.l]"), text.index("[forces.r]")
    settings.write_text(text[:start] + text[end:])


def _plates(settings):
    walker.replace_text(settings, ('force = "right_v"\npoint = "right_p"', "plates = [2]"))


def _pounds(settings):
    walker.replace_text(settings, ("mass_kg = 70.0", "mass_kg = 154.3"))


def _heavier(settings):
    walker.replace_text(settings, ("mass_kg = 70.0", "mass_kg = 78.0"))


PLANTED = {
    "mass in lb": (_pounds, ["[subject] mass_kg", "154.3, 2.2 times the 70 kg", "is it in lb?"]),
    "another person's model": (_heavier, ["[subject] mass_kg", "78, 1.11 times the 70 kg", "scale the"]),
    "forces 50 ms late": (_late, ["forces.mot", "timing of forces", "as 50 ms late", "at most 20 ms"]),
    "forces 50 ms early": (_early, ["timing of forces", "as 50 ms early"]),
    "legs swapped": (_swapped, ["place of the left force", "the legs are swapped", "from the right one"]),
    "forces in kN": (_kilonewtons, ["weight", "0.001 times", "not kN"]),
    "points in mm": (_millimeters, ["place of the left force", "check the unit of the point"]),
    "dead channel": (_dead, ["emg.sto", "channel RF", "is dead"]),
    "clipped channel": (_clipped, ["channel RF", "is clipped (saturated)"]),
    "copied channel": (_copied, ["channel TA", "is a duplicate of 'RF'"]),
    "EMG in uV": (_microvolts, ["channel Sol", "is in another unit"]),
    "EMG of the other leg": (_other_leg, ["emg.sto", "timing of EMG channel Sol", "on the other leg"]),
    "angles in degrees": (_degrees, ["angles.sto", "more than a full turn", "in degrees?"]),
    "misspelt channel": (_misspelt, ["column Soll", "did you mean 'Sol'?"]),
    "misspelt muscle": (
        _misspelt_muscle,
        ["prepare.toml", "[emg.channels] RF", "muscle 'rectfem_l' is not in", "did you mean 'recfem_l'?"],
    ),
    "no unit": (_without_unit, ["[emg] unit", "'V' or 'mV' or 'uV'", 'write kind = "envelope"']),
    "no forces": (_without_forces, ["forces: expected text, found nothing", 'moments = "FILE"']),
    "plates of a file without": (_plates, ["[forces.r]", "expected force, needed to read"]),
    "the other foot's forces alone": (
        _right_alone,
        ["[forces]: expected [forces.l]", "the leg's foot, found none"],
    ),
    "unknown body": (_elsewhere, ["[forces.r] body", "did you mean 'calcn_r'?"]),
}


@pytest.mark.parametrize("fault", PLANTED)
def test_a_simulated_error_is_named(run, solved, fault):
    plant, words = PLANTED[fault]
    plant(solved)
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2, outcome.output
    assert [word for word in words if word not in outcome.progress] == [], outcome.progress
    assert not (solved.parent / "out").exists()


def test_a_coupled_patella_in_degrees_is_noted_and_corrected(run, solved, prepared):
    def change(time, columns):
        return time, columns | {"knee_angle_l_beta": np.degrees(columns["knee_angle_l_beta"])}

    walker.change_table(solved, "angles.sto", change)
    folder = solved.parent / "out"
    outcome = run("prepare", solved, "--out", folder, "--json")
    assert outcome.status == 0, outcome.progress
    (note,) = json.loads(outcome.output)["trials"]["walk"]["notes"]
    assert "knee_angle_l_beta: is in degrees" in note and "follow from knee_angle_l" in note
    tables = [read_storage(place / "trials" / "walk" / "angles.sto") for place in (folder, prepared[1])]
    beta = [table.values[:, table.columns.index("knee_angle_l_beta")] for table in tables]
    np.testing.assert_allclose(beta[0][50:-50], beta[1][50:-50], atol=5e-3)


def test_accepted_channels_are_used_despite_errors(run, solved):
    _copied(solved)
    walker.replace_text(solved, ('unit = "V"', 'unit = "V"\naccept = ["RF", "TA"]'))
    assert run("prepare", solved, "--out", solved.parent / "out").status == 0


def _stepped(settings, **spans):
    """Keep the force of each foot between two times only: its other steps were beside the plates."""

    def change(time, columns):
        for foot, (start, end) in spans.items():
            off = (time < start) | (time > end)
            for axis in "xyz":
                columns[f"{foot}_v{axis}"][off] = 0.0
        return time, columns

    walker.change_table(settings, "forces.mot", change)
    walker.replace_text(settings, ('use = "calibration"', 'use = "calibration"\ncycles = [[1.566, 2.65]]'))


def _left_alone(settings):
    """Keep only the left foot's step at 1.55 s."""
    _stepped(settings, left=(1.5, 2.3), right=(0.0, 0.0))
    text = settings.read_text()
    start, end = text.index("[forces.r]"), text.index("[emg]")
    settings.write_text(text[:start] + text[end:])


@pytest.mark.parametrize("right", [(2.0, 2.85), (0.9, 1.75)], ids=["left foot first", "right foot first"])
def test_one_step_on_each_plate_suffices(run, solved, right):
    _stepped(solved, left=(1.5, 2.3), right=right)
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 0, outcome.progress
    assert "forces agree best with motion" in outcome.output


def test_one_measured_foot_suffices(run, solved):
    _left_alone(solved)
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 0, outcome.progress
    assert "during single support" in outcome.output


@pytest.mark.parametrize(("plant", "said"), [(_late, "ms late"), (_early, "ms early")])
@pytest.mark.parametrize("measured", ["one step a plate", "one foot"])
def test_a_time_shift_is_detected_with_few_steps(run, solved, measured, plant, said):
    if measured == "one foot":
        _left_alone(solved)
    else:
        _stepped(solved, left=(1.5, 2.3), right=(2.0, 2.85))
    plant(solved)
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2, outcome.output
    assert "timing of forces" in outcome.progress and said in outcome.progress


def test_steps_of_the_leg_beside_the_plates_are_reported(run, solved):
    def change(time, columns):
        for axis in "xyz":
            columns[f"left_v{axis}"][(time > 1.5) & (time < 2.3)] = 0.0
        return time, columns

    walker.change_table(solved, "forces.mot", change)
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2
    assert "steps of the left foot" in outcome.progress and "list as cycles" in outcome.progress


def test_the_hint_for_a_too_small_force_solves_it(run, solved):
    """The other foot's plate measured half of the force."""

    def change(time, columns):
        return time, {name: 0.5 * v if name.startswith("right_v") else v for name, v in columns.items()}

    walker.change_table(solved, "forces.mot", change)
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2 and "leave out that foot's forces" in outcome.progress
    text = solved.read_text()
    start, end = text.index("[forces.r]"), text.index("[emg]")
    solved.write_text(text[:start] + text[end:])
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 0, outcome.progress


def test_a_generic_model_is_scaled(run, solved):
    """A person 2 % larger than the model stands still: the scaled model has their size."""
    _, names, places, _, _ = walker.simulated_positions()
    still = np.repeat(1.02 * places[:, 60:61], 60, axis=1)
    walker.write_trc(solved.parent / "static.trc", np.arange(60) / 100.0, names, still)
    (solved.parent / "setup.xml").write_text(SETUP, encoding="utf-8")
    # The mass is also that of the person, not of the generic model.
    _heavier(solved)
    walker.replace_text(solved, ('file = "scaled.osim"', 'file = "scaled.osim"\nscaling = "setup.xml"'))
    folder = solved.parent / "out"
    outcome = run("prepare", solved, "--out", folder)
    assert outcome.status == 0, outcome.progress
    given, scaled = (describe_model(file) for file in (solved.parent / "scaled.osim", folder / "model.osim"))
    femur = [
        next(j for j in model.joints if j.child_body == "tibia_l").in_parent for model in (given, scaled)
    ]
    assert femur[1].translation[1] == pytest.approx(1.02 * femur[0].translation[1], rel=1e-3)


def test_all_errors_of_the_settings_are_reported_together(run, solved):
    walker.replace_text(
        solved,
        ("mass_kg = 70.0", "mass_kg = 70000"),
        ('unit = "V"', 'unit = "volt"'),
        ("emg.sto", "emgs.sto"),
    )
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2
    for words in ("mass_kg", "'V' or 'mV' or 'uV'", "emgs.sto"):
        assert words in outcome.progress


def test_swapped_markers_are_reported(run, laboratory, tmp_path):
    for file in laboratory.parent.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    lines = (tmp_path / "walk.trc").read_text().splitlines()
    swap = {"L": "R", "R": "L"}
    lines[3] = "\t".join(swap.get(cell[:1], cell[:1]) + cell[1:] for cell in lines[3].split("\t"))
    (tmp_path / "walk.trc").write_text("\n".join(lines) + "\n")
    walker.replace_text(
        tmp_path / "prepare.toml", ('emg = "emg.sto"', 'emg = "emg.sto"\ncycles = [[1.55, 2.65]]')
    )
    outcome = run("prepare", tmp_path / "prepare.toml", "--out", tmp_path / "out")
    assert outcome.status == 2
    assert "left and right?" in outcome.progress or "the legs are swapped" in outcome.progress
