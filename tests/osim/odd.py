"""Synthetic model with one of every path, joint and coupler feature that the readers of models support."""

import opensim
import pytest


def _body(model, name):
    body = opensim.Body(name, 1.0, opensim.Vec3(0), opensim.Inertia(0.1, 0.1, 0.1))
    model.addBody(body)
    return body


def _pin(model, name, parent, where, child, coordinate):
    joint = opensim.PinJoint(
        name, parent, opensim.Vec3(*where), opensim.Vec3(0), child, opensim.Vec3(0), opensim.Vec3(0)
    )
    joint.updCoordinate().setName(coordinate)
    model.addJoint(joint)
    return joint.updCoordinate()


def _couple(model, name, independent, dependent, slope, offset, scale):
    coupler = opensim.CoordinateCouplerConstraint()
    coupler.setName(name)
    names = opensim.ArrayStr()
    names.append(independent)
    coupler.setIndependentCoordinateNames(names)
    coupler.setDependentCoordinateName(dependent)
    coefficients = opensim.Vector(3, 0.0)
    for index, value in enumerate((0.2, slope, offset)):
        coefficients.set(index, value)
    coupler.setFunction(opensim.PolynomialFunction(coefficients))
    model.addConstraint(coupler)
    opensim.PropertyHelper.setValueDouble(scale, coupler.updPropertyByName("scale_factor"))


def _muscle(model, name, *points):
    muscle = opensim.Millard2012EquilibriumMuscle(name, 100.0, 0.1, 0.2, 0.0)
    for number, (body, where) in enumerate(points):
        muscle.addNewPathPoint(f"{name}-P{number + 1}", body, opensim.Vec3(*where))
    model.addForce(muscle)
    return muscle


def _via(muscle, point, body, end):
    """Add a point of another class, which OpenSim copies, and an end point to a muscle's path."""
    muscle.updGeometryPath().updPathPointSet().cloneAndAppend(point)
    muscle.addNewPathPoint(f"{muscle.getName()}-end", body, opensim.Vec3(*end))


def build_odd_model():
    """Build a leg with a patella coupled to the knee, and a pulley on it that is coupled to the patella."""
    opensim.Logger.setLevelString("Off")
    model = opensim.Model()
    model.setName("odd")
    thigh, shank, foot, toes, patella, pulley = (
        _body(model, name) for name in ("thigh", "shank", "foot", "toes", "patella", "pulley")
    )
    _pin(model, "hip_joint", model.getGround(), (0, 1, 0), thigh, "hip")
    knee = _pin(model, "knee_joint", thigh, (0, -0.4, 0), shank, "knee")
    knee.setRangeMin(0.0)
    knee.setRangeMax(2.0)
    knee.setDefaultClamped(True)
    _pin(model, "patella_joint", thigh, (0.02, -0.38, 0), patella, "patella_turn")
    _pin(model, "pulley_joint", patella, (0.01, -0.02, 0), pulley, "pulley_turn")
    model.addJoint(
        opensim.WeldJoint(
            "ankle", shank, opensim.Vec3(0, -0.4, 0), opensim.Vec3(0), foot, opensim.Vec3(0), opensim.Vec3(0)
        )
    )
    toe = _pin(model, "toe_joint", foot, (0.1, 0, 0), toes, "toe")
    toe.setDefaultValue(0.1)
    toe.setDefaultLocked(True)
    # In reverse order of dependence, which must not matter.
    _couple(model, "pulley_coupler", "patella_turn", "pulley_turn", 0.7, 0.05, 1.0)
    _couple(model, "patella_coupler", "knee", "patella_turn", 0.5, 0.1, 1.5)

    # A rotated and displaced offset frame, which carries a path point and a cylinder.
    frame = opensim.PhysicalOffsetFrame(
        "epicondyle",
        thigh,
        opensim.Transform(opensim.Rotation(0.5, opensim.CoordinateAxis(2)), opensim.Vec3(0.01, -0.3, 0.02)),
    )
    thigh.addComponent(frame)
    cylinder = opensim.WrapCylinder()
    cylinder.setName("condyles")
    cylinder.set_radius(0.03)
    cylinder.set_length(0.2)
    cylinder.set_translation(opensim.Vec3(-0.07, -0.05, 0.0))
    cylinder.set_xyz_body_rotation(opensim.Vec3(0.1, 0.2, 0.0))
    cylinder.set_quadrant("-x")
    frame.addWrapObject(cylinder)
    ellipsoid = opensim.WrapEllipsoid()
    ellipsoid.setName("brim")
    ellipsoid.set_dimensions(opensim.Vec3(0.03, 0.04, 0.05))
    ellipsoid.set_translation(opensim.Vec3(0.0, -0.05, 0.0))
    ellipsoid.set_quadrant("x")
    thigh.addWrapObject(ellipsoid)

    extensor = _muscle(
        model, "extensor", (thigh, (0.03, -0.1, 0)), (patella, (0.03, 0, 0)), (pulley, (0.03, -0.02, 0))
    )
    extensor.addNewPathPoint("extensor-P4", shank, opensim.Vec3(0.02, -0.05, 0))
    flexor = _muscle(model, "flexor", (frame, (-0.05, 0.1, 0)), (foot, (-0.05, 0.3, 0)))
    flexor.updGeometryPath().addPathWrap(cylinder)
    hip_flexor = _muscle(model, "hip_flexor", (model.getGround(), (0.05, 1.1, 0)), (thigh, (0.05, -0.3, 0)))
    hip_flexor.updGeometryPath().addPathWrap(ellipsoid)
    _muscle(model, "toe_flexor", (shank, (-0.02, -0.2, 0)), (toes, (0.05, -0.01, 0)))

    condition = opensim.ConditionalPathPoint()
    condition.setName("conditional-via")
    condition.updSocket("coordinate").setConnecteePath("/jointset/knee_joint/knee")
    condition.setRangeMin(0.5)
    condition.setRangeMax(2.0)
    condition.updSocket("parent_frame").setConnecteePath("/bodyset/thigh")
    condition.setLocation(opensim.Vec3(-0.06, -0.38, 0))
    _via(_muscle(model, "conditional", (thigh, (-0.03, -0.1, 0))), condition, shank, (-0.03, -0.2, 0))
    moving = opensim.MovingPathPoint()
    moving.setName("moving-via")
    moving.updSocket("parent_frame").setConnecteePath("/bodyset/thigh")
    for axis, function in zip(
        "XYZ",
        (opensim.LinearFunction(0.02, 0.05), opensim.Constant(-0.02), opensim.Constant(0.0)),
        strict=True,
    ):
        moving.updSocket(f"{axis.lower()}_coordinate").setConnecteePath("/jointset/knee_joint/knee")
        getattr(moving, f"set_{axis.lower()}_location")(function)
    _via(_muscle(model, "moving", (model.getGround(), (0.03, 1.2, 0))), moving, thigh, (0.03, -0.2, 0))
    model.finalizeConnections()
    return model


@pytest.fixture(scope="session")
def odd_model(tmp_path_factory):
    """File of the synthetic model."""
    file = tmp_path_factory.mktemp("odd") / "model.osim"
    build_odd_model().printToXML(str(file))
    return file
