"""Stored runs are read exactly, and predict other cycles and their own."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests.path_sources.round_trip import assert_reproduces_itself
from tests.subject.synthetic import write_subject
from wrapjax.cli.report import redraw
from wrapjax.errors import InputError
from wrapjax.evaluation.evaluation import evaluate
from wrapjax.evaluation.stored_run import load_run
from wrapjax.io.storage import read_storage
from wrapjax.model.parameters import QUANTITIES
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def folder(calibrated, tmp_path_factory):
    """Folder of a run. Read-only."""
    run = tmp_path_factory.mktemp("runs") / "run"
    calibrated.save(run)
    return run


@pytest.fixture
def damaged(folder, tmp_path):
    """Copy of the folder that may be modified."""
    return shutil.copytree(folder, tmp_path / "run")


def test_a_run_with_curves_of_another_process_says_what_to_do(calibrated, tmp_path, monkeypatch):
    monkeypatch.setitem(HILL_CURVES, "own", HILL_CURVES["paper"])
    result = replace(calibrated.result, curves="own")
    replace(calibrated, result=result).save(tmp_path / "run")
    assert load_run(tmp_path / "run").curves == "own"
    monkeypatch.delitem(HILL_CURVES, "own")
    with pytest.raises(InputError, match=r"curves 'own', which are not defined here.*HILL_CURVES"):
        load_run(tmp_path / "run")


def test_a_run_is_read_exactly(folder, calibrated):
    run, result = load_run(folder), calibrated.result
    assert (run.muscles, run.coordinates) == (result.muscles, result.coordinates)
    assert (run.method, run.curves, run.subject, run.geometry) == ("NGA", "paper", "synthetic", "opensim")
    parameters = run.parameters(run.muscles[::-1])
    for name in QUANTITIES:
        np.testing.assert_array_equal(
            getattr(parameters, name), np.asarray(getattr(result.parameters, name))[::-1]
        )
    np.testing.assert_array_equal(run.paths.coefficients, result.paths.coefficients)


def test_errors_of_its_own_cycles_equal_the_summary(folder, person, calibrated):
    assert_reproduces_itself(folder, person)
    for given in ((load_run(folder), person), (folder, person.folder)):
        np.testing.assert_allclose(evaluate(*given).modelled, calibrated.result.modelled, atol=1e-9)


def test_other_cycles_of_the_same_person(folder, calibrated, tmp_path):
    """A recording with other names and orders: prediction is by name and independent for each cycle."""
    other = write_subject(tmp_path / "later")
    text = (other / "subject.toml").read_text()
    text = text.replace('"walk_b"', '"later"').replace('name = "synthetic"', 'name = "synthetic_later"')
    text = text.replace("cycles = [[0.5, 1.7], [1.7, 2.9]]", "cycles = [[1.7, 2.9]]")
    text = text.replace('coordinates = ["hip_flexion_l", "knee_angle_l"]',
                        'coordinates = ["knee_angle_l", "hip_flexion_l"]')  # fmt: skip
    channels = ('RecFem = ["recfem_l"]\n', 'SemiTen = ["semiten_l"]\n')
    assert "".join(channels) in text
    (other / "subject.toml").write_text(text.replace("".join(channels), "".join(channels[::-1])))
    done = evaluate(load_run(folder), load_subject(other))
    assert done.subject.muscles.names == ("semiten_l", "recfem_l")
    assert done.trials.names == ("walk_a", "later")
    ours = calibrated.result.modelled[[1, 2]][:, ::-1]
    np.testing.assert_allclose(done.modelled, ours, atol=1e-9)


def test_angles_outside_the_fitted_range_are_noted(folder, tmp_path):
    other = write_subject(tmp_path / "bent")
    for file in other.rglob("angles.sto"):
        head, table = file.read_text().split("endheader\n")
        labels, *rows = table.splitlines()
        cells = [row.split("\t") for row in rows]
        bent = ["\t".join([time, hip, str(float(knee) + 0.8)]) for time, hip, knee in cells]
        file.write_text(head + "endheader\n" + "\n".join([labels, *bent]) + "\n")
    (note,) = evaluate(load_run(folder), load_subject(other)).notes
    assert "knee_angle_l is outside the range that the run's paths were fitted on" in note


def test_another_model_file_is_noted(folder, person, tmp_path):
    other = write_subject(tmp_path / "other")
    model = other / "model.osim"
    model.write_text(model.read_text() + "<!-- looked at again -->\n")
    (note,) = evaluate(load_run(folder), load_subject(other)).notes
    assert "not the one that the run was calibrated with; muscle paths are those of the run" in note


def test_saved_files(folder, person, tmp_path):
    done = evaluate(load_run(folder), person)
    done.save(tmp_path / "out")
    content = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert content["schema"] == 1 and content["run"]["method"] == "NGA"
    table = read_storage(tmp_path / "out" / "moments" / "walk_a_02.sto")
    assert table.columns[:2] == ("hip_flexion_l_moment", "knee_angle_l_moment")
    both = np.concatenate([done.modelled[1], person.trials.moments[1]])
    np.testing.assert_array_equal(table.values.T, both)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "predicted by the NGA calibration of synthetic" in page and "<img" in page
    assert f"{content['mae_Nm']['validation']['mean']:.2f}" in page


def test_the_report_is_rendered_again(folder, person, tmp_path):
    evaluate(load_run(folder), person).save(tmp_path / "out")
    page = tmp_path / "out" / "report.html"
    before = page.read_bytes()
    page.unlink()
    assert redraw(tmp_path / "out") == page
    assert page.read_bytes() == before
    (tmp_path / "out" / "moments" / "walk_b.sto").unlink()
    with pytest.raises(InputError, match=r"walk_b\.sto"):
        redraw(tmp_path / "out")


def test_other_muscles_are_refused(folder, tmp_path):
    other = write_subject(tmp_path / "other")
    text = (other / "subject.toml").read_text().replace('SemiTen = ["semiten_l"]\n', "")
    (other / "subject.toml").write_text(text)
    with pytest.raises(InputError, match=r"lacks muscle 'semiten_l', which run .* was calibrated with"):
        evaluate(load_run(folder), load_subject(other))


def test_other_coordinates_are_refused(folder, tmp_path):
    other = write_subject(tmp_path / "other")
    text = (other / "subject.toml").read_text()
    both, one = '["hip_flexion_l", "knee_angle_l"]', '["knee_angle_l"]'
    (other / "subject.toml").write_text(text.replace(both, one))
    with pytest.raises(InputError, match="lacks coordinate 'hip_flexion_l'"):
        evaluate(load_run(folder), load_subject(other))


def cut_in_row(run):
    text = (run / "parameters.csv").read_text()
    (run / "parameters.csv").write_text(text[: len(text) // 2])


def cut_between_rows(run):
    lines = (run / "parameters.csv").read_text().splitlines(keepends=True)
    (run / "parameters.csv").write_text("".join(lines[:-1]))


def not_a_number(run):
    text, place = (run / "parameters.csv").read_text(), "recfem_l,muscle,emg_scale,"
    (run / "parameters.csv").write_text(text.replace(place, f"{place}x"))


def cut_paths(run):
    content = (run / "paths.npz").read_bytes()
    (run / "paths.npz").write_bytes(content[: len(content) // 2])


def earlier_version(run):
    settings = json.loads((run / "settings.json").read_text())
    del settings["paths"]
    (run / "settings.json").write_text(json.dumps(settings))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (cut_in_row, r"parameters\.csv: seems cut off"),
        (cut_between_rows, r"parameters\.csv: max_fiber_velocity of semiten_l is missing"),
        (not_a_number, r"parameters\.csv: line 5: expected owner, kind, parameter and a value"),
        (cut_paths, r"paths\.npz: is damaged"),
        (lambda run: (run / "paths.npz").unlink(), r"paths\.npz: is missing"),
        (earlier_version, r"settings\.json: does not say where the run's paths came from"),
        (lambda run: (run / "summary.json").write_text("{"), r"summary\.json: is damaged"),
        (lambda run: (run / "summary.json").write_text("{}"), "is damaged"),
        (lambda run: (run / "settings.json").unlink(), r"is no RUN folder: settings\.json is missing"),
    ],
)
def test_damaged_runs_are_refused(damaged, damage, said):
    damage(damaged)
    with pytest.raises(InputError, match=said):
        load_run(damaged)


def test_no_run(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_run(tmp_path / "nowhere")
