"""Tests of the folder of a run: complete and exact files, readable by other software."""

import csv
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

from wrapjax import InputError
from wrapjax.io.storage import read_storage
from wrapjax.model.freedom import FreedPaths
from wrapjax.model.parameters import QUANTITIES
from wrapjax.preprocessing.nmsm.files import OSIMX_QUANTITIES, read_osimx
from wrapjax.report.calibration import run_page
from wrapjax.report.calibration.run_page import write_run


@pytest.fixture
def run(subject, result, tmp_path):
    write_run([(subject, result)], tmp_path / "run")
    return tmp_path / "run"


def _files(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_folder_contains_exactly_the_documented_files(run):
    curves = [
        f"{kind}/{trial}.sto"
        for kind in ("activations", "moments", "muscle_forces")
        for trial in ("fast", "slow", "walk_02")
    ]
    tables = ["calibrated.osimx", "parameters.csv", "starts.csv"]
    whole = [*tables, "paths.npz", "report.html", "settings.json", "summary.json"]
    assert _files(run) == sorted(curves + whole)
    assert [path.name for path in run.parent.iterdir()] == ["run"]


def test_parameters_have_all_digits_and_bounds_if_free(run, result):
    with (run / "parameters.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["owner", "kind", "parameter", "value", "unit", "lower", "upper"]
    assert len(rows) == 2 * len(QUANTITIES)
    assert {row["kind"] for row in rows} == {"muscle"}
    freed = {parameter.name: parameter for parameter in result.freedom.parameters}
    for row in rows:
        muscle = result.muscles.index(row["owner"])
        assert float(row["value"]) == float(getattr(result.parameters, row["parameter"])[muscle])
        assert row["unit"] == QUANTITIES[row["parameter"]].unit
        if row["parameter"] in freed:
            assert float(row["lower"]) == freed[row["parameter"]].lower[muscle]
            assert float(row["upper"]) == freed[row["parameter"]].upper[muscle]
        else:
            assert row["lower"] == row["upper"] == ""


def test_osimx_contains_the_same_parameters(run, result):
    muscles = read_osimx(run / "calibrated.osimx")
    assert tuple(muscle.name for muscle in muscles) == result.muscles
    for row, muscle in enumerate(muscles):
        assert set(muscle.values) == set(OSIMX_QUANTITIES)
        for name, value in muscle.values.items():
            assert value == pytest.approx(float(getattr(result.parameters, name)[row]), rel=1e-14)


def _associated_model(run):
    root = ElementTree.parse(run / "calibrated.osimx").getroot()
    assert root.find("OsimxModel").get("name") == "scaled"
    return run / root.findtext("OsimxModel/associated_osim_model")


def test_osimx_names_the_model_also_after_both_were_moved(subject, result, tmp_path):
    for leg in ("left", "right"):
        (tmp_path / "all" / leg).mkdir(parents=True)
        (tmp_path / "all" / leg / "scaled.osim").write_text(leg)
    legs = [
        (replace(subject, model_file=tmp_path / "all" / leg / "scaled.osim"), result)
        for leg in ("left", "right")
    ]
    write_run(legs, tmp_path / "all" / "runs" / "NGA")
    for moved in ("all", "elsewhere"):
        if moved != "all":
            (tmp_path / "all").rename(tmp_path / moved)
        run = tmp_path / moved / "runs" / "NGA"
        assert _associated_model(run).read_text() == "left"
        assert _associated_model(run / "other_leg").read_text() == "right"


@pytest.mark.parametrize("method", ["SGA", "LSGA"])
def test_osimx_has_a_remark_on_changed_paths(method, run, subject, result, tmp_path):
    """The parameters apply only with the calibrated polynomials, which a model or .osimx cannot represent."""
    free = FreedPaths(np.array([[True], [False]]), 15.0)
    changed = replace(result, method=method, freedom=replace(result.freedom, paths=free))
    write_run([(subject, changed)], tmp_path / "changed")
    text = (tmp_path / "changed" / "calibrated.osimx").read_text()
    (remark,) = re.findall("<!--(.*?)-->", text, re.DOTALL)
    assert f"{method} changed muscle geometry" in remark and "paths.npz" in remark
    assert read_osimx(tmp_path / "changed" / "calibrated.osimx") == read_osimx(run / "calibrated.osimx")
    assert "<!--" not in (run / "calibrated.osimx").read_text(), "NGA changed none"


def test_stored_curves_are_read_back_exactly(run, result):
    for trial, stem in enumerate(("slow", "walk_02", "fast")):
        moments = read_storage(run / "moments" / f"{stem}.sto")
        assert moments.columns == (
            "hip_flexion_l_moment",
            "ankle_angle_l_moment",
            "hip_flexion_l_moment_measured",
            "ankle_angle_l_moment_measured",
        )
        np.testing.assert_array_equal(moments.time, result.time[trial])
        np.testing.assert_array_equal(moments.values.T[:2], result.modelled[trial])
        np.testing.assert_array_equal(moments.values.T[2:], result.measured[trial])
        activations = read_storage(run / "activations" / f"{stem}.sto")
        assert activations.columns == result.muscles
        np.testing.assert_array_equal(activations.values.T, result.states.activation[:, trial])
        forces = read_storage(run / "muscle_forces" / f"{stem}.sto")
        np.testing.assert_array_equal(
            forces.values.T,
            result.states.fiber.active_force[:, trial] + result.states.fiber.passive_force[:, trial],
        )


def test_opensim_opens_the_curves(run, result):
    opensim = pytest.importorskip("opensim")
    table = opensim.TimeSeriesTable(str(run / "moments" / "walk_02.sto"))
    np.testing.assert_array_equal(
        table.getDependentColumn("ankle_angle_l_moment").to_numpy(), result.modelled[1, 1]
    )


def test_settings_contain_freed_parameters_and_versions(run, result):
    settings = json.loads((run / "settings.json").read_text())
    assert settings["muscles"] == list(result.muscles)
    assert settings["freed"]["optimal_fiber_length"] == {
        "unit": "m",
        "lower": [0.06, 0.03],
        "upper": [0.14, 0.07],
        "prior_mean": [0.5, 0.5],
        "prior_sd": [None, None],  # infinite: no prior
    }
    assert settings["channels"] == {"hip": ["iliacus_l"], "calf": ["soleus_l"]}
    assert settings["trials"]["fast"] == {
        "use": "validation",
        "speed_m_s": 0.8,
        "start_s": 2.0,
        "end_s": 2.9,
    }
    assert settings["undriven_muscles"] == ["piri_l", "sart_l"]
    assert {"python", "wrapjax", "jax", "numpy"} <= settings["versions"].keys()


def test_an_existing_folder_is_refused_and_unchanged(subject, result, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match="--force"):
        write_run([(subject, result)], tmp_path / "run")
    assert _files(tmp_path) == ["run/mine.txt"]
    assert (tmp_path / "run" / "mine.txt").read_text() == "precious"


def test_force_replaces_the_entire_folder(subject, result, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "old.txt").write_text("old")
    write_run([(subject, result)], tmp_path / "run", force=True)
    assert "old.txt" not in _files(tmp_path / "run")
    assert (tmp_path / "run" / "summary.json").is_file()


@pytest.mark.parametrize("writer", ["write_json", "write_storage", "render_report"])
@pytest.mark.parametrize("force", [False, True])
def test_a_failed_write_leaves_no_folder_and_keeps_an_existing_one(
    writer, force, subject, result, tmp_path, monkeypatch
):
    def fail(*arguments, **options):
        raise OSError("disk full")

    if force:
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "old.txt").write_text("old")
    monkeypatch.setattr(run_page, writer, fail)
    with pytest.raises(OSError, match="disk full"):
        write_run([(subject, result)], tmp_path / "run", force=force)
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == (
        ["run", "run/old.txt"] if force else []
    )


def test_a_run_with_a_cost_that_is_not_finite_is_written(subject, not_finite, tmp_path):
    write_run([(subject, not_finite)], tmp_path / "run")
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["cost"] is None
    text = (tmp_path / "run" / "moments" / "slow.sto").read_text()
    assert math.isnan(float(text.splitlines()[-1].split("\t")[1]))
