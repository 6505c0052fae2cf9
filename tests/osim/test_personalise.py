"""Tests of the writer of personalized models: changed cylinders and muscles, and nothing else changed."""

import resource
from xml.etree import ElementTree

import numpy as np
import opensim
import pytest
from scipy.spatial.transform import Rotation

from wrapjax.errors import InputError
from wrapjax.osim.loading import load_model
from wrapjax.osim.model import describe_model
from wrapjax.osim.path_engine import NOMINAL, PathEngine
from wrapjax.osim.personalised_model import MuscleConstants, write_personalised_model

#: Wrap parameters of the synthetic model's cylinder, which is on an offset frame.
MOVED = {"condyles": (0.004, -0.007, 0.002, 0.15, -0.22, 1.15)}
#: Constants of the only muscle with this cylinder, one of them with all digits of a float.
CONSTANTS = {"flexor": MuscleConstants(0.0123456789012345, 0.31, 1234.5, 0.123)}
COORDINATES = ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "knee_angle_l", "ankle_angle_l")


def cylinders_in(model):
    casts = [opensim.WrapCylinder.safeDownCast(component) for component in model.getComponentsList()]
    return {cylinder.getName(): cylinder for cylinder in casts if cylinder is not None}


def cylinder_of(file, name):
    """Pose (rotation matrix, origin), radius and length of a cylinder in the frame that carries it."""
    model, _ = load_model(file)
    cylinder = cylinders_in(model)[name]
    matrix, origin = cylinder.getTransform().R().asMat33(), cylinder.getTransform().p()
    rotation = np.array([[matrix.get(i, j) for j in range(3)] for i in range(3)])
    origin = np.array([origin.get(i) for i in range(3)])
    return rotation, origin, cylinder.get_radius(), cylinder.get_length()


def placed(file, name, parameters):
    """Expected pose (rotation matrix, origin), radius and length of a cylinder by its wrap parameters."""
    rotation, origin, radius, length = cylinder_of(file, name)
    change = Rotation.from_euler("XY", parameters[3:5]).as_matrix()
    return rotation @ change, origin + rotation @ parameters[:3], radius * parameters[5], length


def constants_of(file):
    """Constants of all muscles, read by OpenSim."""
    model, _ = load_model(file)
    muscles = [model.getMuscles().get(index) for index in range(model.getMuscles().getSize())]
    return {
        muscle.getName(): MuscleConstants(
            muscle.get_optimal_fiber_length(),
            muscle.get_tendon_slack_length(),
            muscle.get_max_isometric_force(),
            muscle.get_pennation_angle_at_optimal(),
        )
        for muscle in muscles
    }


def without_properties(file, elements, tags):
    """The file's canonical XML without the texts of some properties of some elements."""
    root = ElementTree.parse(
        file, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    )
    for element in root.iter():
        if element.get("name") in elements:
            for tag in tags:
                for child in element.findall(tag):
                    child.text = ""
    return ElementTree.canonicalize(ElementTree.tostring(root.getroot(), "unicode"), with_comments=True)


@pytest.fixture(scope="module")
def odd_written(odd_model, tmp_path_factory):
    file = tmp_path_factory.mktemp("written") / "new" / "odd.osim"
    write_personalised_model(odd_model, file, MOVED, CONSTANTS)
    return file


@pytest.mark.parametrize(
    "parameters",
    [
        MOVED["condyles"],
        (0.0, 0.0, 0.01, 0.0, 0.0, 0.8),
        NOMINAL,
    ],
)
def test_cylinder_on_an_offset_frame_has_the_pose_of_its_parameters(odd_model, tmp_path, parameters):
    write_personalised_model(odd_model, tmp_path / "new.osim", {"condyles": parameters}, {})
    expected = placed(odd_model, "condyles", np.array(parameters))
    for found, expected_value in zip(cylinder_of(tmp_path / "new.osim", "condyles"), expected, strict=True):
        np.testing.assert_allclose(found, expected_value, rtol=0, atol=1e-12)


def test_cylinder_pose_is_right_where_body_fixed_angles_are_singular(tmp_path, odd_model):
    """The file's x-y-z angles give the same pose also if the middle angle is a right angle."""
    straight = tmp_path / "straight.osim"
    model = opensim.Model(str(odd_model))
    model.initSystem()
    cylinders_in(model)["condyles"].set_xyz_body_rotation(opensim.Vec3(0.3, 0.0, 0.0))
    model.printToXML(str(straight))
    for shortfall in (0.0, 1e-9, 1e-5):
        parameters = (0.0, 0.0, 0.0, 0.1, np.pi / 2 - shortfall, 1.0)
        write_personalised_model(straight, tmp_path / "new.osim", {"condyles": parameters}, {})
        rotation, *_ = cylinder_of(tmp_path / "new.osim", "condyles")
        expected, *_ = placed(straight, "condyles", np.array(parameters))
        np.testing.assert_allclose(rotation, expected, rtol=0, atol=1e-12)


def test_muscle_constants_are_written_exactly_and_others_unchanged(odd_model, odd_written):
    before, after = constants_of(odd_model), constants_of(odd_written)
    assert not set(before.pop("flexor")) & set(CONSTANTS["flexor"])
    assert after.pop("flexor") == CONSTANTS["flexor"]
    assert after == before


def test_the_rest_of_the_document_is_unchanged(odd_model, odd_written, tmp_path):
    tags = ("translation", "xyz_body_rotation", "radius", *MuscleConstants._fields)
    names = {*MOVED, *CONSTANTS}
    assert without_properties(odd_written, names, tags) == without_properties(odd_model, names, tags)
    assert without_properties(odd_written, (), ()) != without_properties(odd_model, (), ())
    # Without any change the document is identical.
    write_personalised_model(odd_model, tmp_path / "same.osim", {}, {})
    assert without_properties(tmp_path / "same.osim", (), ()) == without_properties(odd_model, (), ())


def test_a_comment_before_the_model_is_preserved(odd_model, tmp_path):
    noted = tmp_path / "noted.osim"
    first, rest = odd_model.read_text().split("\n", 1)
    noted.write_text(f"{first}\n<!-- Measured on a Tuesday: \N{GREEK SMALL LETTER ALPHA} -->\n{rest}")
    write_personalised_model(noted, noted, MOVED, CONSTANTS)
    assert "<!-- Measured on a Tuesday: \N{GREEK SMALL LETTER ALPHA} -->" in noted.read_text("utf-8")
    assert constants_of(noted)["flexor"] == CONSTANTS["flexor"]


def test_properties_missing_in_the_file_are_added(odd_model, tmp_path):
    sparse = tmp_path / "sparse.osim"
    document = ElementTree.parse(odd_model)
    (cylinder,) = document.getroot().iter("WrapCylinder")
    for tag in ("translation", "xyz_body_rotation"):
        cylinder.remove(cylinder.find(tag))
    document.write(sparse)
    write_personalised_model(sparse, tmp_path / "new.osim", MOVED, {})
    expected = placed(sparse, "condyles", np.array(MOVED["condyles"]))
    for found, expected_value in zip(cylinder_of(tmp_path / "new.osim", "condyles"), expected, strict=True):
        np.testing.assert_allclose(found, expected_value, rtol=0, atol=1e-12)


#: Parameters of an ellipsoid: all sizes by 1.1, the second and third by factors of their own.
MOVED_ELLIPSOID = {"brim": (0.002, 0.001, -0.001, 0.1, 0.05, 1.1, -0.2, 0.95, 1.2)}


@pytest.mark.parametrize("wraps", [MOVED, MOVED_ELLIPSOID, {"condyles": NOMINAL}])
def test_paths_equal_those_of_placed_cylinders(odd_model, tmp_path, wraps):
    write_personalised_model(odd_model, tmp_path / "new.osim", wraps, {})
    coordinates = ("hip", "knee")
    spans = {name: coordinates for name in ("flexor", "extensor", "hip_flexor")}
    poses = np.random.default_rng(1).uniform((-0.5, 0.0), (0.5, 1.5), (30, 2))
    assert_paths_agree(odd_model, tmp_path / "new.osim", coordinates, spans, poses, wraps)


def test_paths_of_a_leg_equal_those_of_placed_cylinders(s1_left, tmp_path):
    model_file = s1_left / "model.osim"
    description = describe_model(model_file)
    muscles = ("psoas_l", "gaslat_l", "gasmed_l", "semimem_l", "soleus_l")
    names = sorted({wrap.wrap for muscle in muscles for wrap in description.muscle(muscle).wraps})
    assert len(names) == 5
    random = np.random.default_rng(2)
    low, high = (-0.01, -0.01, -0.01, -0.35, -0.35, 0.8), (0.01, 0.01, 0.01, 0.35, 0.35, 1.2)
    wraps = {name: random.uniform(low, high) for name in names[1:]}
    write_personalised_model(
        model_file, tmp_path / "new.osim", wraps, {"soleus_l": MuscleConstants(0.05, 0.25, 6000.0, 0.5)}
    )
    spans = {
        name: tuple(entry for entry in description.spanned_by(name) if entry in COORDINATES)
        for name in muscles
    }
    poses = random.uniform((-0.4, -0.2, -0.2, 0.02, -0.3), (0.6, 0.2, 0.2, 1.1, 0.3), (40, 5))
    assert_paths_agree(model_file, tmp_path / "new.osim", COORDINATES, spans, poses, wraps)


def assert_paths_agree(model_file, written, coordinates, spans, poses, wraps):
    engine = PathEngine(model_file, coordinates, spans)
    nominal = engine.analyse(poses)
    engine.place(wraps)
    expected = engine.analyse(poses)
    found = PathEngine(written, coordinates, spans).analyse(poses)
    moves = any(tuple(parameters) != NOMINAL for parameters in wraps.values())
    assert (np.abs(expected[0] - nominal[0]).max() > 1e-4) == moves
    for quantity, expected_value in zip(found, expected, strict=True):
        np.testing.assert_allclose(quantity, expected_value, rtol=0, atol=1e-9)


def test_all_errors_are_reported_together(odd_model, tmp_path):
    wraps = {"condyle": NOMINAL, "brim": NOMINAL, "condyles": (0.0, 0.0, 0.0, 0.0, 0.0, -1.0)}
    muscles = {
        "Flexor": MuscleConstants(0.1, 0.2, 500.0, 0.1),
        "extensor": MuscleConstants(0.1, float("nan"), 500.0, 0.1),
        "moving": MuscleConstants(0.0, 0.2, 500.0, 0.1),
        "hip_flexor": MuscleConstants(0.1, 0.2, 500.0, np.pi / 2),
    }
    with pytest.raises(InputError) as caught:
        write_personalised_model(odd_model, tmp_path / "new.osim", wraps, muscles)
    problems = caught.value.problems
    assert [problem.place for problem in problems] == [
        *("condyle", "Flexor", "condyles", "extensor", "moving", "hip_flexor")
    ]
    assert problems[0].hint == "did you mean 'condyles'?"
    assert problems[1].hint == "did you mean 'flexor'?"
    assert "no such wrap object" in problems[0].message
    assert "positive" in problems[2].message and "0.1 nan" in problems[3].message
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_number_of_parameters_is_an_error(odd_model, tmp_path):
    with pytest.raises(InputError, match="condyles: six finite wrap parameters"):
        write_personalised_model(odd_model, tmp_path / "new.osim", {"condyles": (0.0, 1.0)}, {})


def test_cylinders_with_the_same_name_are_an_error(odd_model, tmp_path):
    """A path names its cylinder without the body, so that names must be unique."""
    double = tmp_path / "double.osim"
    document = ElementTree.parse(odd_model)
    root = document.getroot()
    (cylinder,) = root.iter("WrapCylinder")
    next(entry for entry in root.iter("objects") if entry.find("WrapEllipsoid") is not None).append(cylinder)
    document.write(double)
    with pytest.raises(InputError, match="condyles: one <WrapCylinder> of this name was expected, and 2"):
        write_personalised_model(double, tmp_path / "new.osim", MOVED, {})
    assert list(tmp_path.iterdir()) == [double]


def test_a_full_disk_leaves_the_old_file_unchanged(odd_model, tmp_path):
    file = tmp_path / "model.osim"
    file.write_text("the old one")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_personalised_model(odd_model, file, MOVED, CONSTANTS)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == [file]
    assert file.read_text() == "the old one"
