"""Wraps stay near the bones of their bodies: by polynomials, by the exact engine, and on the command line."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.osim.bone_file import TETRAHEDRON
from tests.path_sources.wrapped_knee import wrapped_model
from tests.subject.synthetic import write_subject
from wrapjax.calibration.problem import matching_path_source
from wrapjax.cli.command_line import main
from wrapjax.errors import InputError
from wrapjax.geometry.exact_paths.engine import surfaces_of
from wrapjax.geometry.exact_paths.wrapping import NOMINAL
from wrapjax.geometry.surrogates.physiological import PhysiologicalThresholds, distance_from_bones
from wrapjax.osim.model import describe_model
from wrapjax.path_sources import wrap_fitting
from wrapjax.path_sources.exact import exact_geometry
from wrapjax.path_sources.near_bones import find_near_bones
from wrapjax.path_sources.path_fitting import fit
from wrapjax.path_sources.wrap_fitting import fit_wraps
from wrapjax.subject.subject import load_subject

MESH = """<attached_geometry><Mesh name="bone">
 <socket_frame>..</socket_frame><scale_factors>1 1 1</scale_factors><mesh_file>thigh.vtp</mesh_file>
</Mesh></attached_geometry>"""
#: All points of the bone; the cylinder's hind side is 1 mm in front of the foremost.
BEHIND = "-0.056 -0.4 0  -0.06 -0.39 0  -0.06 -0.41 0  -0.07 -0.4 0  -0.08 -0.4 0"


@pytest.fixture(scope="module")
def with_bone(tmp_path_factory):
    folder = write_subject(tmp_path_factory.mktemp("bones") / "synthetic")
    model = wrapped_model().replace("<WrapObjectSet>", f"{MESH}<WrapObjectSet>", 1)
    (folder / "model.osim").write_text(model, encoding="utf-8")
    bones = folder / "Geometry"
    bones.mkdir()
    start, end = TETRAHEDRON.index("0 0 0  1"), TETRAHEDRON.index("</DataArray></Points>")
    (bones / "thigh.vtp").write_text(TETRAHEDRON[:start] + BEHIND + TETRAHEDRON[end:])
    return load_subject(folder), bones


def farther(person, parameters):
    """Increase of the distance between the cylinder and the nearest point of the bone, m."""
    surface = jax.tree.map(
        lambda leaf: leaf[0], surfaces_of([describe_model(person.model_file).wrap("knee_front_l")])
    )
    points = np.array(BEHIND.split(), dtype=float).reshape(-1, 3)
    distance = distance_from_bones(surface, "cylinder", points, np.concatenate([NOMINAL[None], parameters]))
    assert distance[0] == pytest.approx(0.001, abs=1e-9)
    return distance[1:] - distance[0]


def test_feasible_wraps_stay_near_the_bone(with_bone, fewer_samples):
    """Without the criterion, the classifier accepts wraps that are farther from the bone."""
    person, bones = with_bone
    polynomials, thresholds = fit(person, "engine"), PhysiologicalThresholds(bone_distance=0.002)
    free, near = (
        fit_wraps(person, polynomials, thresholds=thresholds, bone_folders=folders).wraps
        for folders in ((), (bones,))
    )
    assert free.quality["knee_front_l"].near_bone_share is None
    share = near.quality["knee_front_l"].near_bone_share
    assert 0.2 < share < 0.8 and near.quality["knee_front_l"].physiological_share <= share
    half = np.asarray(near.inner.half_range)[0, 0]
    parameters = NOMINAL + np.random.default_rng(5).uniform(-1.0, 1.0, (300, 6)) * half
    far = farther(person, parameters) > 0.002

    def accepted(wraps):
        limit = wraps.feasibility["knee_front_l"]
        if limit is None:
            return np.ones(len(parameters), dtype=bool)
        return np.asarray(jax.vmap(limit.excess)(jnp.asarray(parameters))) <= 0.0

    assert far.mean() > 0.2
    assert accepted(near)[far].mean() < 0.15 < 0.5 < accepted(free)[far].mean()
    assert accepted(near)[~far].mean() > 0.6


def test_the_fit_is_another_with_another_bone(with_bone, fewer_samples, monkeypatch):
    """What was kept of a fit is not used for a changed bone."""
    person, bones = with_bone
    computed = []
    monkeypatch.setattr(wrap_fitting, "_fit_wraps", lambda *inputs: computed.append(inputs) or fits)
    fits, file = fit(person, "engine"), bones / "thigh.vtp"
    content = file.read_text()
    try:
        for text in (content.replace("-0.06 -0.39", "-0.06 -0.38"), content.replace("-0.08", "-0.09")):
            file.write_text(text)
            fit_wraps(person, fits, bone_folders=(bones,))
        assert len(computed) == 2
    finally:
        file.write_text(content)


def test_bones_that_are_not_found_are_named(with_bone, tmp_path):
    person, _ = with_bone
    with pytest.raises(InputError, match=r"expected surfaces of bones \(.vtp\), found none of thigh.vtp"):
        fit_wraps(person, fit(person, "engine"), bone_folders=(tmp_path,))


def test_a_model_that_names_no_bones_is_refused_with_a_folder_of_them(with_bone, tmp_path):
    (tmp_path / "model.osim").write_text(wrapped_model(), encoding="utf-8")
    with pytest.raises(InputError, match="the model names no bone of a body with wraps"):
        find_near_bones(tmp_path / "model.osim", (with_bone[1],), 0.005)


# ---- By the exact engine


@pytest.fixture(scope="module")
def free(with_bone):
    """Bounds without bones."""
    person, _ = with_bone
    return exact_geometry(person).freedom("PGA", person).wraps


def near(with_bone, distance):
    """Bounds with the bone."""
    person, bones = with_bone
    geometry = exact_geometry(person, bone_folders=(bones,), bone_distance=distance)
    return geometry.freedom("PGA", person).wraps


def test_bounds_keep_wraps_near_the_bone(with_bone, free):
    """All bounds shrink by one factor: everything within them is near, and a bit beyond not everything."""
    person, _ = with_bone
    limited = near(with_bone, 0.002)
    share = limited.upper[0, 0] / free.upper[0, 0]
    assert 0.05 <= share <= 0.9
    np.testing.assert_allclose(limited.upper, share * free.upper)
    np.testing.assert_allclose(limited.lower, share * free.lower)
    np.testing.assert_allclose(limited.prior_sd, share * free.prior_sd)

    def samples(wraps, factor=1.0):
        unit = np.random.default_rng(5).uniform(0.0, 1.0, (2000, 6))
        # Half of them at corners.
        unit[::2] = np.round(unit[::2])
        return NOMINAL + factor * (wraps.lower[0] + (wraps.upper[0] - wraps.lower[0]) * unit)

    assert (farther(person, samples(limited)) <= 0.002).all()
    assert (farther(person, samples(limited, (share + 0.05) / share)) > 0.002).any()
    assert (farther(person, samples(free)) > 0.002).mean() > 0.2


def test_bounds_stay_where_no_bone_is_left(with_bone, free):
    np.testing.assert_array_equal(near(with_bone, 0.5).upper, free.upper)


def test_nothing_to_free_near_the_bone_is_an_error(with_bone):
    with pytest.raises(InputError, match=r"stays within 0.01 mm of its nominal distance from the bones"):
        near(with_bone, 1e-5)


def test_the_paths_of_the_other_leg_have_the_same_limits(with_bone, fewer_samples):
    person, bones = with_bone
    exact = exact_geometry(person, bone_folders=(bones,), bone_distance=0.002)
    other = matching_path_source(exact, person)
    assert other.key == exact.key and (other.bones.folders, other.bones.distance) == ((bones,), 0.002)
    polynomials, thresholds = fit(person, "engine"), PhysiologicalThresholds(bone_distance=0.002)
    free, near = (
        fit_wraps(person, polynomials, thresholds=thresholds, bone_folders=folders)
        for folders in ((), (bones,))
    )
    assert matching_path_source(free, person).wraps.thresholds == thresholds
    with pytest.raises(InputError, match="which has no bones of this leg"):
        matching_path_source(near, person)


def test_bones_are_for_pga_by_the_exact_engine(with_bone, tmp_path, capsys):
    person, bones = with_bone
    command = ["calibrate", str(person.folder), "--method", "PGA", "--out", str(tmp_path / "RUN"), "--quiet"]
    limits = ["--bones", str(bones), "--bone-distance", "0.002"]
    assert main([*command, *limits]) == 2
    assert "is for --method PGA with --geometry engine" in capsys.readouterr().err
    assert main([*command, "--geometry", "engine", *limits[2:]]) == 2
    assert "--bone-distance: is for --bones" in capsys.readouterr().err
    assert main([*command, "--geometry", "engine", "--bones", str(tmp_path)]) == 2
    assert "expected surfaces of bones (.vtp), found none of thigh.vtp" in capsys.readouterr().err
    assert not (tmp_path / "RUN").exists()


@pytest.mark.slow
def test_calibrate_keeps_wraps_near_bones(with_bone, free, tmp_path):
    person, bones = with_bone
    command = ["calibrate", str(person.folder), "--method", "PGA", "--out", str(tmp_path / "RUN"), "--quiet"]
    limits = ["--geometry", "engine", "--bones", str(bones), "--bone-distance", "0.002"]
    few = ["--starts", "1", "--max-iterations", "2"]
    assert main([*command, *limits, *few]) in (0, 1)
    (bounds,) = json.loads((tmp_path / "RUN" / "settings.json").read_text())["freed_wraps"].values()
    assert 0.0 < bounds["translation_x_m"]["upper"] < 0.9 * free.upper[0, 0]
