"""Reading of model files of all versions and muscle classes as OpenSim does, and refusal of invalid ones."""

import numpy as np
import pytest

from tests.subject.synthetic import MODEL, write_subject
from wrapjax.errors import InputError
from wrapjax.io.model_file import read_model_file

MOTION_TYPES = ("undefined", "rotational", "translational", "coupled")

#: Document of OpenSim 3: defaults, joints inside bodies, stated motion types, functions in <function>.
OLD_MODEL = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="30000"><Model name="old">
<defaults>
 <Thelen2003Muscle name="default"><max_isometric_force>546</max_isometric_force>
  <optimal_fiber_length>0.0535</optimal_fiber_length><tendon_slack_length>0.078</tendon_slack_length>
  <pennation_angle>0.1396</pennation_angle></Thelen2003Muscle>
 <Coordinate name="default"><locked>false</locked><range>-1 1</range></Coordinate>
</defaults>
<BodySet><objects>
 <Body name="femur_r"><Joint><CustomJoint name="hip_r"><CoordinateSet><objects>
  <Coordinate name="hip_flexion_r"><motion_type>rotational</motion_type>
   <default_value>0.2</default_value></Coordinate>
  <Coordinate name="slide_r"><motion_type>translational</motion_type><locked>true</locked></Coordinate>
 </objects></CoordinateSet></CustomJoint></Joint></Body>
 <Body name="tibia_r"><Joint><CustomJoint name="knee_r"><CoordinateSet><objects>
  <Coordinate name="knee_angle_r"><range>-2.1 0.2</range></Coordinate>
  <Coordinate name="beta_r"></Coordinate>
 </objects></CoordinateSet><SpatialTransform>
  <TransformAxis name="rotation1"><coordinates>knee_angle_r</coordinates>
   <function><LinearFunction><coefficients> 1 0</coefficients></LinearFunction></function></TransformAxis>
  <TransformAxis name="translation1"><coordinates>beta_r</coordinates>
   <function><SimmSpline><x>0 1</x></SimmSpline></function></TransformAxis>
 </SpatialTransform></CustomJoint></Joint></Body>
</objects></BodySet>
<ForceSet><objects>
 <Thelen2003Muscle name="soleus_r"><max_isometric_force>3549</max_isometric_force>
  <optimal_fiber_length>0.05</optimal_fiber_length></Thelen2003Muscle>
 <DeGrooteFregly2016Muscle name="vasti_r"><max_isometric_force>5000</max_isometric_force>
  <optimal_fiber_length>0.1</optimal_fiber_length><tendon_slack_length>0.12</tendon_slack_length>
  <pennation_angle_at_optimal>0.05</pennation_angle_at_optimal></DeGrooteFregly2016Muscle>
 <CoordinateActuator name="reserve"/>
</objects><groups>
 <ObjectGroup name="leg"><members>soleus_r
  /forceset/vasti_r</members></ObjectGroup><ObjectGroup name="none"><members/></ObjectGroup>
</groups></ForceSet>
</Model></OpenSimDocument>
"""


@pytest.mark.parametrize("subject", ["s1_left", "healthy_overground", "healthy_treadmill"])
def test_agrees_with_opensim(subject, data_folder):
    opensim = pytest.importorskip("opensim")
    opensim.Logger.setLevelString("Off")
    path = data_folder / subject / "model.osim"
    read = read_model_file(path)
    model = opensim.Model(str(path))
    state = model.initSystem()
    assert read.mass_kg == pytest.approx(model.getTotalMass(state), rel=1e-9)

    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    assert read.muscles.names == tuple(muscle.getName() for muscle in muscles)
    for field, getter in (
        ("max_isometric_force", "getMaxIsometricForce"),
        ("optimal_fiber_length", "getOptimalFiberLength"),
        ("tendon_slack_length", "getTendonSlackLength"),
        ("pennation_angle", "getPennationAngleAtOptimalFiberLength"),
    ):
        np.testing.assert_array_equal(getattr(read.muscles, field), [getattr(m, getter)() for m in muscles])

    coordinates = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
    assert [
        (info.name, info.motion_type, info.default_value, info.range, info.locked)
        for info in read.coordinates
    ] == [
        (
            c.getName(),
            MOTION_TYPES[c.getMotionType()],
            c.getDefaultValue(),
            (c.getRangeMin(), c.getRangeMax()),
            c.getDefaultLocked(),
        )
        for c in coordinates
    ]


def test_synthetic_model_opens_in_opensim(tmp_path):
    opensim = pytest.importorskip("opensim")
    opensim.Logger.setLevelString("Off")
    model = opensim.Model(str(write_subject(tmp_path) / "model.osim"))
    state = model.initSystem()
    assert model.getCoordinateSet().getSize() == 2
    assert model.getMuscles().get("recfem_l").getLength(state) > 0.3


def test_old_document(tmp_path):
    (tmp_path / "old.osim").write_text(OLD_MODEL)
    model = read_model_file(tmp_path / "old.osim")
    assert model.muscles.names == ("soleus_r", "vasti_r")
    np.testing.assert_array_equal(model.muscles.max_isometric_force, [3549.0, 5000.0])
    np.testing.assert_array_equal(model.muscles.tendon_slack_length, [0.078, 0.12])
    np.testing.assert_array_equal(model.muscles.pennation_angle, [0.1396, 0.05])
    assert [(c.name, c.motion_type, c.default_value, c.range, c.locked) for c in model.coordinates] == [
        ("hip_flexion_r", "rotational", 0.2, (-1.0, 1.0), False),
        ("slide_r", "translational", 0.0, (-1.0, 1.0), True),
        ("knee_angle_r", "rotational", 0.0, (-2.1, 0.2), False),
        ("beta_r", "coupled", 0.0, (-1.0, 1.0), False),
    ]
    assert model.groups == {"leg": ("soleus_r", "vasti_r"), "none": ()}


@pytest.mark.parametrize(
    "joint", ["PinJoint", "SliderJoint", "UniversalJoint", "PlanarJoint", "FreeJoint", "BallJoint"]
)
def test_motion_types_of_simple_joints_agree_with_opensim(joint, tmp_path):
    opensim = pytest.importorskip("opensim")
    opensim.Logger.setLevelString("Off")
    model = opensim.Model()
    body = opensim.Body("body", 1.0, opensim.Vec3(0), opensim.Inertia(1))
    model.addBody(body)
    model.addJoint(getattr(opensim, joint)("joint", model.getGround(), body))
    muscle = opensim.Millard2012EquilibriumMuscle("muscle", 1.0, 0.1, 0.1, 0.0)
    muscle.addNewPathPoint("from", model.getGround(), opensim.Vec3(0.1))
    muscle.addNewPathPoint("to", body, opensim.Vec3(0.2))
    model.addForce(muscle)
    model.finalizeConnections()
    path = str(tmp_path / "model.osim")
    model.printToXML(path)
    coordinates = model.getCoordinateSet()
    expected = [MOTION_TYPES[coordinates.get(i).getMotionType()] for i in range(coordinates.getSize())]
    assert [info.motion_type for info in read_model_file(path).coordinates] == expected


ENTITIES = """<?xml version="1.0"?>
<!DOCTYPE OpenSimDocument [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]>
<OpenSimDocument><Model>&b;</Model></OpenSimDocument>"""


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ["does not exist"]),
        ("", ["empty"]),
        (MODEL[: len(MODEL) // 2], ["not well-formed", "line"]),
        (bytes(range(256)), ["binary"]),
        (ENTITIES, ["document type or entities", "refused"]),
        (ENTITIES.encode("utf-16"), ["binary"]),
        ("<html></html>", ["<OpenSimDocument>", "<html>"]),
        ("<OpenSimDocument/>", ["<Model>"]),
        ("<OpenSimDocument><Model/></OpenSimDocument>", ["expected muscles", "found none"]),
        (MODEL.replace(">1500.0<", ">strong<"), ["recfem_l", "max_isometric_force", "'strong'"]),
        (MODEL.replace(">1500.0<", ">NaN<"), ["recfem_l", "max_isometric_force", "'NaN'"]),
        (MODEL.replace('"semiten_l"', '"recfem_l"'), ["recfem_l", "more than once"]),
        (MODEL.replace('"knee_angle_l"', '"hip_flexion_l"'), ["hip_flexion_l", "unique name"]),
        (MODEL.replace("-2 2", "wide"), ["hip_flexion_l", "knee_angle_l", "range", "'wide'"]),
    ],
)
def test_invalid_models_are_refused(content, words, tmp_path):
    path = tmp_path / "model.osim"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        read_model_file(path)
    for word in ["model.osim", *words]:
        assert word in str(caught.value)
