"""Defends: of several segments of a path that meet one surface, the one wraps that wraps in OpenSim."""

from pathlib import Path

import numpy as np
import opensim
import pytest

from wrapjax.osim.path_engine import PathEngine
from wrapjax.path_sources.muscle_paths import muscle_paths

MUSCLES = 16
#: Semi-axes or radius (m) beyond which path points are drawn.
SIZES = {"Sphere": (0.03,) * 3, "Cylinder": (0.03, 0.03, np.inf), "Ellipsoid": (0.03, 0.025, 0.04)}
#: Largest difference of length, m; that of ellipsoids is OpenSim's error.
LIMITS = {"Sphere": 1e-12, "Cylinder": 1e-12, "Ellipsoid": 5e-6, "Torus": 1e-6}


def points_outside(kind: str, generator: np.random.Generator) -> np.ndarray:
    """Draw three or four points in all directions that are outside the surface."""
    sizes = np.array(SIZES.get(kind, (0.0,) * 3))
    while True:
        points = generator.normal(size=(generator.integers(3, 5), 3))
        points *= (generator.uniform(0.033, 0.09, len(points)) / np.linalg.norm(points, axis=1))[:, None]
        if kind == "Torus" or np.sum((points / sizes) ** 2, axis=1).min() > 1.05:
            return points


def write_muscles(kind: str, quadrant: str, file: Path) -> None:
    """Write a model of one joint and muscles with via points; all points but the first are on its body."""
    model = opensim.Model()
    body = opensim.Body("body", 1.0, opensim.Vec3(0), opensim.Inertia(1))
    nowhere = opensim.Vec3(0)
    joint = opensim.PinJoint("joint", model.getGround(), nowhere, nowhere, body, nowhere, nowhere)
    joint.updCoordinate().setName("angle")
    model.addBody(body)
    model.addJoint(joint)
    wrap = getattr(opensim, f"Wrap{kind}")()
    wrap.setName("wrap")
    wrap.set_quadrant(quadrant)
    if kind == "Sphere":
        wrap.set_radius(SIZES[kind][0])
    elif kind == "Cylinder":
        wrap.set_radius(SIZES[kind][0])
        wrap.set_length(0.3)
    elif kind == "Ellipsoid":
        wrap.set_dimensions(opensim.Vec3(*SIZES[kind]))
    body.addWrapObject(wrap)
    generator = np.random.default_rng(1)
    for number in range(MUSCLES):
        muscle = opensim.Millard2012EquilibriumMuscle(f"muscle_{number}", 1.0, 0.1, 0.1, 0.0)
        for place, point in enumerate(points_outside(kind, generator)):
            frame = body if place else model.getGround()
            muscle.addNewPathPoint(f"point_{place}", frame, opensim.Vec3(*point.tolist()))
        muscle.updGeometryPath().addPathWrap(wrap)
        model.addForce(muscle)
    model.finalizeConnections()
    model.printToXML(str(file))


@pytest.mark.parametrize(
    ("kind", "quadrant"),
    [
        ("Sphere", "all"),
        ("Sphere", "-y"),
        ("Cylinder", "all"),
        ("Cylinder", "x"),
        pytest.param("Ellipsoid", "all", marks=pytest.mark.slow),
        pytest.param("Torus", "all", marks=pytest.mark.slow),
    ],
)
def test_the_segment_that_wraps_is_opensims(tmp_path, kind, quadrant):
    file = tmp_path / "model.osim"
    write_muscles(kind, quadrant, file)
    paths = muscle_paths(file, mode="parity")
    poses = np.linspace(-0.6, 0.6, 5)[:, None]
    expected, _ = PathEngine(file, ("angle",), dict.fromkeys(paths.muscles, ("angle",))).analyse(poses)
    found = paths(poses)
    assert np.asarray(found.touching).mean() > 0.3
    np.testing.assert_allclose(found.length, expected, atol=LIMITS[kind], rtol=0.0)
