"""The virtual leg opens in OpenSim, and its muscle paths are physiological over a gait cycle."""

import numpy as np
import opensim
import pytest
from scipy.spatial.transform import Rotation

from wrapjax.datasets.virtual_person.anatomy import BODY_MASS_KG, COORDINATES, CYLINDERS
from wrapjax.datasets.virtual_person.gait import normative_cycle
from wrapjax.datasets.virtual_person.leg import FIBER_LENGTH_CENTER, MUSCLES, build_leg_model
from wrapjax.osim.muscle_analysis import analyse_muscles

NAMES = tuple(muscle.name for muscle in MUSCLES)
HIP_FLEXION, HIP_ADDUCTION, HIP_ROTATION, KNEE, ANKLE, SUBTALAR = COORDINATES


@pytest.fixture(scope="module")
def poses():
    """Poses of a natural gait cycle, 201 frames."""
    cycle = normative_cycle()
    return cycle.angles(np.linspace(cycle.start, cycle.end, 201)).T


@pytest.fixture(scope="module")
def geometry(leg_file, poses):
    return analyse_muscles(leg_file, NAMES, COORDINATES, poses, quiet=True, processes=1)


@pytest.fixture(scope="module")
def opened(leg_file):
    model = opensim.Model(str(leg_file))
    return model, model.initSystem()


def pose(opened, values):
    model, state = opened
    for name, value in zip(COORDINATES, values, strict=True):
        model.getCoordinateSet().get(name).setValue(state, float(value), False)
    model.realizePosition(state)
    return state


def test_model_has_the_documented_parts(opened):
    model, state = opened
    coordinates = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
    assert tuple(coordinate.getName() for coordinate in coordinates) == COORDINATES
    assert not any(coordinate.getLocked(state) for coordinate in coordinates)
    assert model.getMuscles().getSize() == len(NAMES) >= 22
    assert len(CYLINDERS) >= 8
    # One leg and the lower trunk: 31 % of the body (de Leva 1996).
    assert model.getTotalMass(state) == pytest.approx(0.3103 * BODY_MASS_KG, rel=1e-3)


def test_every_cylinder_is_touched_in_walking(opened, poses):
    model, _ = opened
    touched = set()
    for values in poses[::20]:
        state = pose(opened, values)
        for muscle in MUSCLES:
            path = model.getMuscles().get(muscle.name).getGeometryPath().getCurrentPath(state)
            if path.getSize() > len(muscle.points):
                touched.add(muscle.cylinder)
    assert touched == {cylinder.name for cylinder in CYLINDERS}


def test_no_path_point_comes_inside_its_cylinder(opened, poses):
    """OpenSim ignores a cylinder that contains a path point, which makes the path discontinuous."""
    model, _ = opened
    surfaces = {cylinder.name: cylinder for cylinder in CYLINDERS}
    for values in poses[::5]:
        state = pose(opened, values)
        for muscle in MUSCLES:
            if not muscle.cylinder:
                continue
            surface = surfaces[muscle.cylinder]
            owner = model.getBodySet().get(surface.body)
            axes = Rotation.from_euler("XYZ", surface.rotation)
            for body, location in muscle.points:
                bone = model.getBodySet().get(body)
                at = bone.findStationLocationInAnotherFrame(state, opensim.Vec3(*location), owner)
                across = axes.inv().apply(at.to_numpy() - surface.center)[:2]
                assert np.hypot(*across) > surface.radius + 0.001, (muscle.name, np.degrees(values))


def test_paths_are_continuous(geometry):
    """The second difference shows discontinuities and kinks; otherwise it is below 0.2 mm per frame."""
    second = np.abs(np.diff(geometry.length, 2, axis=0)).max(axis=0)
    assert dict(zip(NAMES, second, strict=True)) == {name: pytest.approx(0.0, abs=2e-4) for name in NAMES}
    steps = np.abs(np.diff(geometry.moment_arm, axis=0)).max(axis=(0, 1))
    assert steps.max() < 0.003


def test_moment_arms_are_the_derivatives_of_length(leg_file, poses, geometry):
    """They differ where a wrapped segment ends in its cylinder's middle plane (by 25 mm at the knee)."""
    step = 1e-5
    for column, name in enumerate(COORDINATES):
        shift = step * (np.arange(len(COORDINATES)) == column)
        ahead, behind = (
            analyse_muscles(leg_file, NAMES, COORDINATES, poses[::20] + sign * shift, quiet=True, processes=1)
            for sign in (1, -1)
        )
        slope = -(ahead.length - behind.length) / (2 * step)
        assert np.abs(slope - geometry.moment_arm[::20, column]).max() < 3e-4, name


# Lowest and highest moment arm (cm) while walking: what Arnold et al. 2010, doi:10.1007/s10439-009-9852-5,
# show of their model and of cadavers, with a centimeter or so to spare.
ARMS = [
    ("soleus_r", ANKLE, -5.5, -3.5),
    ("gasmed_r", ANKLE, -5.5, -3.5),
    ("gasmed_r", KNEE, 1.0, 4.0),
    ("tibant_r", ANKLE, 2.5, 5.0),
    ("tibant_r", SUBTALAR, 0.0, 2.5),
    ("tibpost_r", SUBTALAR, 1.0, 3.0),
    ("perlong_r", SUBTALAR, -3.5, -1.5),
    ("vaslat_r", KNEE, -5.5, -2.5),
    ("vasmed_r", KNEE, -5.5, -2.5),
    ("recfem_r", KNEE, -5.5, -2.5),
    ("recfem_r", HIP_FLEXION, 2.5, 6.0),
    ("iliacus_r", HIP_FLEXION, 2.5, 5.5),
    ("psoas_r", HIP_FLEXION, 2.5, 5.5),
    ("glmax1_r", HIP_FLEXION, -7.0, -2.5),
    ("glmax2_r", HIP_FLEXION, -8.0, -3.0),
    ("glmax3_r", HIP_FLEXION, -8.5, -4.0),
    ("glmed1_r", HIP_ADDUCTION, -6.5, -2.0),
    ("glmed2_r", HIP_ADDUCTION, -6.5, -2.0),
    ("glmed3_r", HIP_ADDUCTION, -6.5, -2.0),
    ("addlong_r", HIP_ADDUCTION, 5.0, 9.0),
    ("bflh_r", HIP_FLEXION, -8.0, -3.5),
    ("semimem_r", HIP_FLEXION, -8.0, -3.5),
    ("bflh_r", KNEE, 1.5, 5.0),
    ("bfsh_r", KNEE, 1.5, 5.0),
    ("semimem_r", KNEE, 1.5, 5.0),
]


@pytest.mark.parametrize(("muscle", "coordinate", "lowest", "highest"), ARMS)
def test_moment_arms_are_physiological(geometry, muscle, coordinate, lowest, highest):
    arms = 100 * geometry.moment_arm[:, COORDINATES.index(coordinate), NAMES.index(muscle)]
    assert lowest < arms.min()
    assert arms.max() < highest


def test_tendon_slack_lengths_follow_their_rule(geometry):
    for column, muscle in enumerate(MUSCLES):
        length = geometry.length[:, column]
        reach = muscle.optimal_fiber_length * np.cos(muscle.pennation_angle)
        fiber = (length - muscle.tendon_slack_length) / reach
        assert (fiber.min() + fiber.max()) / 2 == pytest.approx(FIBER_LENGTH_CENTER, abs=0.005), muscle.name
        assert fiber.min() > 0.4, muscle.name
        assert fiber.max() < 1.2, muscle.name


def test_same_bytes_every_time(leg_file, tmp_path):
    build_leg_model(tmp_path / "again.osim")
    assert (tmp_path / "again.osim").read_bytes() == leg_file.read_bytes()
