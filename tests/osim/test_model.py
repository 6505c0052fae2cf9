"""Tests of the reader of models: contents of files, spanned coordinates, and errors in files."""

import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.osim.loading import load_model
from wrapjax.osim.model import describe_model, spanned_coordinates

HIP = ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l")


@pytest.fixture(scope="module")
def odd(odd_model):
    return describe_model(odd_model)


@pytest.fixture(scope="module")
def stroke(s1_left):
    return describe_model(s1_left / "model.osim")


def test_importing_the_package_does_not_import_opensim():
    code = "import sys, wrapjax, wrapjax.osim; sys.exit('opensim' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_opensim_prints_nothing_and_writes_no_log(tmp_path, odd_model):
    code = f"from wrapjax.osim.model import describe_model; describe_model({str(odd_model)!r})"
    finished = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=True)
    assert (finished.stdout, finished.stderr, list(tmp_path.iterdir())) == (b"", b"", [])


def test_path_points_equal_those_of_the_file(stroke, s1_left):
    root = ElementTree.parse(s1_left / "model.osim").getroot()
    count = 0
    for element in root.iter("Millard2012EquilibriumMuscle"):
        points = stroke.muscle(element.get("name")).points
        listed = element.findall(".//PathPoint")
        assert [point.name for point in points] == [point.get("name") for point in listed]
        for point, entry in zip(points, listed, strict=True):
            assert entry.findtext("socket_parent_frame").rsplit("/", 1)[1] == point.body
            np.testing.assert_array_equal(
                point.location, [float(x) for x in entry.findtext("location").split()]
            )
            count += 1
    assert count == 144


def test_cylinders_equal_those_of_the_file(stroke, s1_left):
    root = ElementTree.parse(s1_left / "model.osim").getroot()
    listed = {element.get("name"): element for element in root.iter("WrapCylinder")}
    assert listed.keys() == {wrap.name for wrap in stroke.wraps}
    for wrap in stroke.wraps:
        entry = listed[wrap.name]
        assert (wrap.kind, wrap.active) == ("WrapCylinder", True)
        assert wrap.radius == float(entry.findtext("radius"))
        assert wrap.length == float(entry.findtext("length"))
        assert wrap.quadrant == entry.findtext("quadrant")
        for found, tag in ((wrap.translation, "translation"), (wrap.xyz_body_rotation, "xyz_body_rotation")):
            np.testing.assert_allclose(found, [float(x) for x in entry.findtext(tag).split()], atol=1e-14)
    iliacus = stroke.muscle("iliacus_l").wraps
    assert [(w.wrap, w.method, w.first_point, w.last_point) for w in iliacus] == [
        ("IL_at_brim_l", "hybrid", 2, 3)
    ]
    assert stroke.wrap("IL_at_brim_l").body == "pelvis"


def test_properties_of_coordinates_equal_those_of_the_file(stroke):
    knee, patella, wrist = (
        stroke.coordinate(c) for c in ("knee_angle_l", "knee_angle_l_beta", "wrist_flex_l")
    )
    assert (knee.motion, knee.clamped, knee.locked, knee.coupled_to) == ("rotational", True, False, ())
    assert knee.range == (0.0, 2.0944)
    assert patella.motion == "coupled"
    assert patella.coupled_to == ("knee_angle_l",)
    assert wrist.locked
    assert stroke.coordinate("pelvis_ty").motion == "translational"
    assert stroke.uncommon_parts == ()


@pytest.mark.parametrize(
    ("muscle", "expected"),
    [
        ("iliacus_l", HIP),
        ("recfem_l", (*HIP, "knee_angle_l")),
        ("bflh_l", (*HIP, "knee_angle_l")),
        ("gasmed_l", ("knee_angle_l", "ankle_angle_l", "subtalar_angle_l")),
        ("vasmed_l", ("knee_angle_l",)),
        ("soleus_l", ("ankle_angle_l", "subtalar_angle_l")),
        ("edl_l", ("ankle_angle_l", "subtalar_angle_l", "mtp_angle_l")),
    ],
)
def test_a_muscle_spans_the_joints_between_its_bodies(s1_left, muscle, expected):
    assert spanned_coordinates(s1_left / "model.osim", [muscle]) == {muscle: expected}


def test_spanned_coordinates_are_those_with_moment_arms(stroke, s1_left):
    """OpenSim's moment arms are zero outside the span, and nonzero in some pose inside it."""
    model, state = load_model(s1_left / "model.osim")
    generator = np.random.default_rng(3)
    names = [c.name for c in stroke.coordinates if not c.locked and not c.coupled_to]
    largest = {}
    for _ in range(2):
        for name in names:
            model.getCoordinateSet().get(name).setValue(state, generator.uniform(0.05, 0.4), False)
        model.assemble(state)
        model.realizePosition(state)
        for muscle in stroke.muscles:
            path = model.getMuscles().get(muscle.name)
            for name in names:
                arm = abs(path.computeMomentArm(state, model.getCoordinateSet().get(name)))
                largest[muscle.name, name] = max(arm, largest.get((muscle.name, name), 0.0))
    inside = {(muscle.name, name) for muscle in stroke.muscles for name in stroke.spanned_by(muscle.name)}
    assert max(arm for pair, arm in largest.items() if pair not in inside) < 1e-3
    assert min(largest[pair] for pair in inside) > 1e-4


def test_welded_joints_are_not_spanned(data_folder):
    # The subtalar joint is welded in this model.
    spans = spanned_coordinates(data_folder / "healthy_overground" / "model.osim", ["soleus_r", "gasmed_r"])
    assert spans == {"soleus_r": ("ankle_angle_r",), "gasmed_r": ("knee_angle_r", "ankle_angle_r")}


def test_chained_couplers_are_resolved_to_the_independent_coordinate(odd):
    assert odd.coordinate("pulley_turn").coupled_to == ("patella_turn",)
    assert odd.spanned_by("extensor") == ("knee",)


def test_locked_coordinates_are_not_spanned(odd):
    assert odd.coordinate("toe").locked
    assert odd.spanned_by("toe_flexor") == ()


def test_positions_in_offset_frames_are_given_in_the_body_frame(odd, odd_model):
    model, state = load_model(odd_model)
    model.realizePosition(state)
    point = model.getMuscles().get("flexor").getGeometryPath().getPathPointSet().get(0)
    thigh = model.getBodySet().get("thigh")
    expected = model.getGround().findStationLocationInAnotherFrame(
        state, point.getLocationInGround(state), thigh
    )
    described = odd.muscle("flexor").points[0]
    assert described.body == "thigh"
    np.testing.assert_allclose(described.location, [expected.get(i) for i in range(3)], atol=1e-14)
    # The frame is rotated by 0.5 rad about z.
    condyles = odd.wrap("condyles")
    assert condyles.body == "thigh"
    cosine, sine = np.cos(0.5), np.sin(0.5)
    shift = np.array([-0.07 * cosine + 0.05 * sine, -0.07 * sine - 0.05 * cosine, 0.0])
    np.testing.assert_allclose(condyles.translation, np.array([0.01, -0.3, 0.02]) + shift, atol=1e-14)


def test_uncommon_parts_are_named(odd):
    assert odd.wrap("brim").radius is None
    # The muscle ends above the knee, but one of its points moves with the knee.
    assert [point.body for point in odd.muscle("moving").points] == ["ground", "thigh", "thigh"]
    assert odd.muscle("moving").points[1].moved_by == ("knee",)
    assert odd.spanned_by("moving") == ("hip", "knee")
    assert odd.uncommon_parts == (
        "wrap object 'brim' on thigh is a WrapEllipsoid",
        "muscle 'conditional': point 'conditional-via' is a ConditionalPathPoint",
        "muscle 'moving': point 'moving-via' is a MovingPathPoint",
    )


def test_all_unknown_muscles_are_reported_together(odd_model):
    with pytest.raises(InputError) as caught:
        spanned_coordinates(odd_model, ["Flexor_", "flexor", "masseter"])
    first, second = caught.value.problems
    assert (first.place, first.hint) == ("Flexor_", "did you mean 'flexor'?")
    assert second.place == "masseter" and "known: extensor" in second.hint


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not well-formed XML (no element found"),
        (np.random.default_rng(0).bytes(4000), "is binary, where XML in UTF-8 was expected"),
        (b"<html><body/></html>", "has <html> as its outermost element"),
        (b"<OpenSimDocument Version='40000'><AnalyzeTool name='x'/></OpenSimDocument>", "holds no bodies"),
        (
            b"<OpenSimDocument Version='40000'><Model name='x'><BodySet><obj",
            "is not well-formed XML (unclosed",
        ),
    ],
    ids=["empty", "rubbish", "other-xml", "no-model", "truncated"],
)
def test_a_file_that_is_no_model_is_an_error(tmp_path, capfd, content, message):
    file = tmp_path / "model.osim"
    file.write_bytes(content)
    with pytest.raises(InputError) as caught:
        describe_model(file)
    (problem,) = caught.value.problems
    assert problem.file == str(file) and message in problem.message
    assert "\n" not in problem.message
    assert capfd.readouterr() == ("", "")


def test_a_missing_file_is_an_error(tmp_path):
    with pytest.raises(InputError, match="is not a file"):
        describe_model(tmp_path / "model.osim")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("/bodyset/thigh<", "/bodyset/thumb<", "/bodyset/thumb"),
        ("<wrap_object>condyles<", "<wrap_object>condors<", "flexor"),
        ("<independent_coordinate_names>knee<", "<independent_coordinate_names>kneel<", "kneel"),
    ],
)
def test_an_inconsistent_model_is_an_error(tmp_path, odd_model, old, new, named):
    text = odd_model.read_text()
    assert old in text
    (tmp_path / "model.osim").write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        describe_model(tmp_path / "model.osim")
    (problem,) = caught.value.problems
    assert "cannot load it as a model" in problem.message and named in problem.message


def test_circular_couplers_are_an_error(tmp_path, odd_model):
    old = "<independent_coordinate_names>knee<"
    text = odd_model.read_text().replace(old, "<independent_coordinate_names>pulley_turn<")
    (tmp_path / "model.osim").write_text(text)
    with pytest.raises(InputError, match="circle: patella_turn, pulley_turn"):
        describe_model(tmp_path / "model.osim")
