"""Tests of the command ``paths``: its tables, muscles that it cannot have, and bad input."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.cli.conftest import run
from tests.osim.odd import odd_model as odd_model
from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, read_storage, write_storage
from wrapjax.osim.model import describe_model
from wrapjax.osim.path_engine import PathEngine
from wrapjax.path_sources import muscle_paths as muscle_paths_module
from wrapjax.path_sources.muscle_paths import muscle_paths


@pytest.fixture(scope="module")
def poses_file(tmp_path_factory):
    """Hip and knee angles in degrees, and a column of something else."""
    file = tmp_path_factory.mktemp("poses") / "poses.mot"
    generator = np.random.default_rng(0)
    angles = generator.uniform([-30.0, 5.0, 0.0], [30.0, 90.0, 1.0], (6, 3))
    write_storage(file, Storage("poses", ("hip", "knee", "force"), np.arange(6.0), angles, in_degrees=True))
    return file


def test_tables_equal_opensim_and_the_library(odd_model, poses_file, tmp_path):
    out = tmp_path / "out"
    outcome = run("paths", odd_model, "--poses", poses_file, "--mode", "parity", "--out", out)
    assert outcome.status == 0, outcome.progress
    lengths = read_storage(out / "lengths.sto")
    angles = np.deg2rad(read_storage(poses_file).values[:, :2])
    model = describe_model(odd_model)
    assert lengths.columns == tuple(muscle.name for muscle in model.muscles)
    spans = {name: ("hip", "knee") for name in lengths.columns}
    expected, arms = PathEngine(odd_model, ("hip", "knee"), spans).analyse(angles)
    np.testing.assert_allclose(lengths.values, expected, atol=1e-6)
    for column, name in enumerate(("hip", "knee")):
        table = read_storage(out / f"moment_arm_{name}.sto")
        assert table.columns == lengths.columns
        # OpenSim leaves the motion of a moving point out of segments with both ends on one body.
        fixed = [number for number, muscle in enumerate(lengths.columns) if muscle != "moving"]
        np.testing.assert_allclose(table.values[:, fixed], arms[:, column, fixed], atol=1e-5)
    summary = json.loads((out / "paths.json").read_text())
    assert summary["schema"] == 1 and summary["poses"] == 6 and summary["unsupported"] == {}
    assert summary["muscles"]["hip_flexor"]["wraps"] == ["brim"]
    assert "In every pose" not in outcome.output
    again = run("paths", odd_model, "--poses", poses_file, "--mode", "parity", "--out", out)
    assert again.status == 2 and "force" in again.progress


@pytest.mark.parametrize(
    ("mode", "answer"),
    [
        ("parity", "do not wrap there"),
        pytest.param("geodesic", "begins on the surface there", marks=pytest.mark.slow),
    ],
)
def test_wraps_that_hold_a_path_point_are_named(odd_model, poses_file, tmp_path, mode, answer):
    """The ellipsoid's center is 5 mm from the insertion along its shortest semi-axis of 30 mm."""
    text = odd_model.read_text()
    start = text.index("<translation>", text.index('name="brim"')) + len("<translation>")
    moved = text[:start] + "0.045 -0.3 0" + text[text.index("<", start) :]
    (tmp_path / "model.osim").write_text(moved)
    command = ("paths", tmp_path / "model.osim", "--poses", poses_file, "--mode", mode)
    outcome = run(*command, "--out", tmp_path / "out")
    assert outcome.status == 0, outcome.progress
    assert "In every pose a point of the path is inside a wrap: hip_flexor brim (25 mm)." in outcome.output
    assert answer in outcome.output
    summary = json.loads((tmp_path / "out" / "paths.json").read_text())["muscles"]
    assert summary["hip_flexor"]["inside_m"] == {"brim": pytest.approx(0.025, abs=1e-9)}
    assert not summary["flexor"]["inside_m"] and not summary["extensor"]["inside_m"]
    assert summary["hip_flexor"]["irregular_share"] == 1.0


def test_wrong_names_and_shapes_get_one_sentence(odd_model):
    paths = muscle_paths(odd_model, muscles=["flexor"])
    poses = np.zeros((3, len(paths.coordinates)))
    with pytest.raises(ValueError, match="no muscle 'flexer': did you mean 'flexor'"):
        paths.plot_modes(["flexer"], poses)
    with pytest.raises(ValueError, match="no muscle"):
        paths.plot_moved_wraps("flexer", poses[0], paths.nominal)
    with pytest.raises(ValueError, match="expected 1 x 9 wrap parameters, found 1 x 5"):
        paths.plot_moved_wraps("flexor", poses[0], paths.nominal[:, :5])
    for compute in (paths, paths.posed, paths.to_dataset, lambda own: paths.plot_modes(["flexor"], own)):
        with pytest.raises(ValueError, match="expected poses with"):
            compute(poses[:, :-1])


def test_paths_are_a_function_of_wrap_parameters(odd_model):
    """Derivatives by the parameters of a cylinder, and moment arms as derivatives of length."""
    paths = muscle_paths(odd_model, muscles=["flexor"])
    assert paths.wraps == ("condyles",) and "knee" in paths.coordinates
    poses = np.full((3, len(paths.coordinates)), 0.6) + 0.1 * np.arange(3)[:, None]
    posed = paths.posed(poses)
    slopes = jax.jit(jax.jacfwd(lambda parameters: posed(parameters).length))(
        jax.numpy.asarray(paths.nominal)
    )
    assert slopes.shape == (3, 1, *paths.nominal.shape) and np.isfinite(slopes).all()
    found, step = paths(poses), 1e-6
    above, below = (paths(poses + sign * step * np.eye(poses.shape[1])[-1]) for sign in (1.0, -1.0))
    slope = (above.length - below.length) / (2.0 * step)
    np.testing.assert_allclose(found.moment_arm[:, -1], -slope, atol=1e-7)
    moved = paths.nominal
    moved[0, paths.wrap_parameters.index("translation_x_m")] = 0.01
    (words,) = paths.plot_moved_wraps("flexor", poses[0], moved).subfigs[0].texts
    assert "condyles: moved 10.0 mm" in words.get_text()
    titles = [panel.get_title(loc="left") for panel in paths.plot_modes(["flexor"], poses).axes]
    assert "flexor: length" in titles and "moment arm, knee" in titles
    dataset = paths.to_dataset(poses)
    assert dataset.attrs["mode"] == "geodesic" and dataset["length"].attrs["units"] == "m"
    arms = dataset["moment_arm"].sel(muscle="flexor", coordinate=paths.coordinates[-1])
    np.testing.assert_array_equal(arms, found.moment_arm[:, -1, 0])
    # Slopes of moment arms are minus second derivatives of length, which do not depend on their order.
    bends = paths.moment_arm_slopes(poses)
    assert np.abs(bends).max() > 1e-4
    np.testing.assert_allclose(bends, bends.swapaxes(1, 2), atol=1e-9)
    difference = (above.moment_arm - below.moment_arm) / (2.0 * step)
    np.testing.assert_allclose(bends[:, -1], difference, atol=1e-8)


def test_a_muscle_without_points_is_named_and_left_out_on_request(odd_model, monkeypatch):
    model = describe_model(odd_model)
    muscles = tuple(
        replace(entry, path_kind="FunctionBasedPath") if entry.name == "flexor" else entry
        for entry in model.muscles
    )
    monkeypatch.setattr(muscle_paths_module, "describe_model", lambda _: replace(model, muscles=muscles))
    with pytest.raises(InputError, match=r"muscle flexor.*FunctionBasedPath.*--skip-unsupported"):
        muscle_paths(odd_model)
    paths = muscle_paths(odd_model, skip_unsupported=True)
    assert "flexor" not in paths.muscles and "FunctionBasedPath" in paths.unsupported["flexor"]


@pytest.mark.parametrize(
    ("columns", "degrees", "message"),
    [
        (("hip_r", "force"), True, "expected a column of a coordinate, such as hip"),
        (("hip", "knee"), False, "expected angles up to a full turn"),
        (("hip", "/jointset/hip_joint/hip/value"), True, "expected one column, found 2"),
    ],
)
def test_bad_poses_are_named(odd_model, tmp_path, columns, degrees, message):
    file = tmp_path / "poses.sto"
    write_storage(file, Storage("poses", columns, np.arange(2.0), np.full((2, 2), 40.0), in_degrees=degrees))
    out = tmp_path / "out"
    outcome = run("paths", odd_model, "--poses", file, "--out", out)
    assert outcome.status == 2 and message in outcome.progress and not out.exists()


def test_a_model_that_is_none_is_named(tmp_path, poses_file):
    outcome = run("paths", tmp_path / "none.osim", "--poses", poses_file, "--out", tmp_path / "out")
    assert outcome.status == 2 and "is not a file" in outcome.progress
