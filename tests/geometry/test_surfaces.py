"""Tests of wrapping round spheres, ellipsoids and tori: OpenSim's paths, shortest paths, derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from validation.wrapping.draws import draw_poses, draw_surface
from validation.wrapping.shortest_paths import engine_paths
from validation.wrapping.single_path import COORDINATES, MUSCLE, SurfaceDraw, by_opensim, write_model
from wrapjax.errors import InputError
from wrapjax.geometry.exact_paths.engine import (
    GEODESIC,
    PARITY,
    ExactPaths,
    nominal_parameters,
    wrap_at_samples,
)
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS
from wrapjax.geometry.surfaces.curve_length import VARIABLES
from wrapjax.geometry.surfaces.ellipsoid import planar_length, plane_through
from wrapjax.geometry.surfaces.placed_surface import PlacedSurface
from wrapjax.geometry.surfaces.wrap_methods import SHORTEST
from wrapjax.geometry.vectors import stack_components, vector
from wrapjax.osim.model import describe_model
from wrapjax.osim.path_engine import PathEngine

#: Surfaces that are compared with OpenSim, and the largest difference of length that is allowed (m). Where a
#: quadrant makes paths go the long way round an ellipsoid, OpenSim's iteration does not always converge.
SURFACES = {
    "sphere": (SurfaceDraw("sphere", (0.03,), angles=(0.3, -0.5, 1.0)), 1e-12),
    "sphere on one side": (SurfaceDraw("sphere", (0.03,), "-y"), 1e-12),
    "cylinder on one half": (SurfaceDraw("cylinder", (0.03, 0.2), "z"), 1e-12),
    "ellipsoid, hybrid": (SurfaceDraw("ellipsoid", (0.03, 0.05, 0.02), angles=(0.3, -0.5, 1.0)), 5e-6),
    "ellipsoid, axial, on one side": (SurfaceDraw("ellipsoid", (0.03, 0.05, 0.02), "x", "axial"), 5e-6),
    "torus": (SurfaceDraw("torus", (0.03, 0.008), angles=(0.3, -0.5, 1.0)), 1e-6),
}


def engine_of(surfaces, folder):
    """Engine of a single path round surfaces, and the model's file."""
    file = folder / "path.osim"
    write_model(surfaces, file)
    return ExactPaths(describe_model(file), [MUSCLE], COORDINATES), file


def paths(engine, poses, wrapping, parameters=None):
    """One path in many poses."""
    if parameters is None:
        parameters = nominal_parameters(len(engine.wraps_of(MUSCLE)))
    found = wrap_at_samples(engine.posed(poses)[MUSCLE], np.asarray(parameters)[None], wrapping)
    return jax.tree.map(lambda leaf: leaf[0], found)


@pytest.mark.parametrize("name", SURFACES)
def test_parity_equals_opensim(name, tmp_path):
    surface, tolerance = SURFACES[name]
    poses = draw_poses(surface, 150, np.random.default_rng(0))
    engine, file = engine_of([surface], tmp_path)
    length, arms = by_opensim(file, poses)
    known = np.isfinite(length)
    assert known.mean() > 0.98
    found = paths(engine, poses, PARITY)
    assert 0.2 < found.touching.mean() < 0.95
    np.testing.assert_allclose(found.length[known], length[known], atol=tolerance, rtol=0)
    np.testing.assert_allclose(found.moment_arm[known], arms[known], atol=300 * tolerance + 1e-11, rtol=0)


@pytest.mark.slow
def test_parity_round_several_kinds_equals_opensim(tmp_path):
    """OpenSim's sweeps, and its stale wrap points: lengths of a path round three surfaces."""
    surfaces = [
        SurfaceDraw("ellipsoid", (0.02, 0.03, 0.025), method="midpoint", center=(-0.06, 0.0, 0.0)),
        SurfaceDraw("sphere", (0.02,), center=(0.0, 0.01, 0.0)),
        SurfaceDraw("cylinder", (0.02, 0.3), center=(0.06, 0.0, 0.0)),
    ]
    generator = np.random.default_rng(1)
    low, high = np.array([-0.15, -0.03, -0.03]), np.array([-0.1, 0.03, 0.03])
    start, end = generator.uniform(low, high, (60, 3)), -generator.uniform(low, high, (60, 3))
    poses = np.concatenate([start, end], axis=1)
    engine, file = engine_of(surfaces, tmp_path)
    length, arms = by_opensim(file, poses)
    found = paths(engine, poses, PARITY)
    assert found.touching.sum(axis=-1).max() == 3
    difference = np.abs(found.length - length)
    assert np.median(difference) < 1e-6 and np.mean(difference < 1e-5) > 0.95
    assert np.median(np.abs(found.moment_arm - arms).max(axis=-1)) < 1e-4


def test_placed_surfaces_equal_opensims(tmp_path):
    """Center, orientation and both radii of a torus by its wrap parameters, in OpenSim and in the engine."""
    draw = SurfaceDraw("torus", (0.03, 0.008), angles=(0.3, -0.5, 1.0))
    poses = draw_poses(draw, 40, np.random.default_rng(8))
    engine, file = engine_of([draw], tmp_path)
    parameters = np.array([0.004, -0.003, 0.002, 0.1, -0.15, 1.1, 0.3, 0.8, 1.0])
    reference = PathEngine(file, COORDINATES, {MUSCLE: COORDINATES})
    nominal = reference.analyse(poses)[0][:, 0]
    reference.place({"surface_0": parameters})
    length = reference.analyse(poses)[0][:, 0]
    assert np.abs(length - nominal).max() > 1e-3
    found = paths(engine, poses, PARITY, parameters[None])
    np.testing.assert_allclose(found.length, length, atol=1e-6, rtol=0)


def test_a_barrier_keeps_paths_on_their_side_of_a_sphere(tmp_path):
    """The distance of the straight line from the center, unless a quadrant determines the side."""
    poses = np.array([[-0.1, 0.004, 0.0, 0.1, 0.004, 0.0], [-0.1, 0.0, 0.0, 0.1, 0.0, 0.03]])
    for quadrant, expected in (("all", [0.004, 0.03 / np.sqrt(4.0 + 0.09)]), ("y", [1.0, 1.0])):
        engine, _ = engine_of([SurfaceDraw("sphere", (0.02,), quadrant)], tmp_path)
        found = paths(engine, poses, GEODESIC).clearances
        np.testing.assert_allclose(found[:, 2], expected, atol=1e-12)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """Engine of a path round an ellipsoid and through a torus, and poses in which it touches both."""
    surfaces = [
        SurfaceDraw("ellipsoid", (0.03, 0.04, 0.025), center=(0.0, 0.0, -0.05)),
        SurfaceDraw("torus", (0.03, 0.008), center=(0.025, 0.0, 0.04)),
    ]
    generator = np.random.default_rng(2)
    start = generator.uniform([-0.02, -0.02, -0.13], [0.02, 0.02, -0.1], (20, 3))
    end = generator.uniform([-0.04, -0.03, 0.08], [-0.01, 0.03, 0.12], (20, 3))
    engine, _ = engine_of(surfaces, tmp_path_factory.mktemp("mixed"))
    return engine, np.concatenate([start, end], axis=1)


@pytest.mark.slow
def test_shortest_paths_have_exact_moment_arms(mixed):
    """Round two surfaces of different kinds: -dL/dq for the positions of both ends."""
    engine, poses = mixed
    step = 1e-6 * np.eye(len(COORDINATES))
    here = paths(engine, poses, GEODESIC)
    assert here.touching.all(axis=-1).mean() > 0.5
    for column, shift in enumerate(step):
        above, below = (paths(engine, poses + sign * shift, GEODESIC) for sign in (1.0, -1.0))
        slope = (above.length - below.length) / 2e-6
        kink = np.abs(above.length + below.length - 2.0 * here.length) > 1e-10
        np.testing.assert_allclose(-here.moment_arm[~kink, column], slope[~kink], atol=1e-7)


@pytest.mark.slow
def test_shortest_paths_are_no_shorter_than_straight_lines(mixed):
    """Compiled with the test before, which defends more."""
    engine, poses = mixed
    shortest = paths(engine, poses, GEODESIC)
    assert np.isfinite(shortest.length).all()
    straight = np.linalg.norm(poses[:, 3:] - poses[:, :3], axis=1)
    assert (shortest.length - straight).min() > -1e-12


EYE = [vector(np.eye(3)[axis]) for axis in range(3)]


def surface(sizes, radius, side=0, axis=0):
    return PlacedSurface(
        *EYE,
        center=vector(np.zeros(3)),
        radius=jnp.asarray(radius),
        half_length=jnp.asarray(1.0),
        side_axis=jnp.asarray(axis),
        side=jnp.asarray(side),
        sizes=vector(np.asarray(sizes, dtype=float)),
    )


@jax.jit
@jax.vmap
def round_ellipsoid(ends, sizes):
    """Decision, total length and ends' pulls of paths round ellipsoids."""
    placed = surface(np.zeros(3), 0.03)
    placed = replace(placed, sizes=vector(sizes))
    method = SHORTEST["ellipsoid_hybrid"]
    start, end = vector(ends[:3]), vector(ends[3:])
    decision = method.decide(start, end, placed)
    contact = method.find_contact(start, end, placed, decision)
    pulls = jnp.concatenate([stack_components(contact.start_pull), stack_components(contact.end_pull)])
    return decision.mandatory, contact.total, pulls, contact.length


def around_origin(count, reach, seed):
    """Ends of segments, most of which pass near the origin."""
    generator = np.random.default_rng(seed)
    start = generator.normal(size=(count, 3))
    start /= np.linalg.norm(start, axis=1)[:, None]
    end = -start + 0.5 * generator.normal(size=(count, 3))
    end /= np.linalg.norm(end, axis=1)[:, None]
    return np.concatenate([start, end], axis=1) * np.tile(reach, 2) * generator.uniform(1.1, 3.0, (count, 1))


@pytest.mark.slow
def test_an_ellipsoid_with_equal_axes_is_a_sphere():
    ends = around_origin(100, np.full(3, 0.03), 3)
    crossing, total, *_ = round_ellipsoid(ends, np.full((100, 3), 0.03))
    placed = surface(np.full(3, 0.03), 0.03)

    @jax.vmap
    def round_sphere(ends):
        start, end = vector(ends[:3]), vector(ends[3:])
        decision = SHORTEST["sphere"].decide(start, end, placed)
        crossing = decision.mandatory | decision.possible
        return crossing, SHORTEST["sphere"].find_contact(start, end, placed, decision).total

    expected_crossing, expected = round_sphere(jnp.asarray(ends))
    np.testing.assert_array_equal(crossing, expected_crossing)
    assert crossing.mean() > 0.5
    np.testing.assert_allclose(total[crossing], expected[crossing], atol=1e-12)


def test_contacts_are_geodesics_that_continue_the_straight_lines():
    """SciPy integrates the geodesic from the first point of contact: it ends at the last, along the path."""
    sizes = np.array([0.03, 0.05, 0.02])
    ends = around_origin(40, sizes, 4)
    crossing, total, pulls, on_surface = (
        np.asarray(part) for part in round_ellipsoid(ends, np.tile(sizes, (40, 1)))
    )

    def moved(_, state):
        point, velocity = state[:3], state[3:]
        normal = point / sizes**2
        bend = np.sum(velocity**2 / sizes**2) / np.sum(normal**2)
        return np.concatenate([velocity, -bend * normal])

    for row in np.flatnonzero(crossing):
        start, end = ends[row, :3], ends[row, 3:]
        pull, last_pull = pulls[row, :3], pulls[row, 3:]
        # The line along the pull touches the ellipsoid where it is nearest to the center, scaled.
        along = -np.sum(start * pull / sizes**2) / np.sum(pull**2 / sizes**2)
        state = np.concatenate([start + along * pull, pull])
        assert np.sum((state[:3] / sizes) ** 2) == pytest.approx(1.0, abs=1e-8)
        found = solve_ivp(moved, (0.0, on_surface[row]), state, rtol=1e-11, atol=1e-13).y[:, -1]
        np.testing.assert_allclose(found[3:], last_pull, atol=1e-5)
        remaining = end - found[:3]
        np.testing.assert_allclose(np.cross(remaining, last_pull), 0.0, atol=1e-7)
        assert along + on_surface[row] + np.linalg.norm(remaining) == pytest.approx(total[row], abs=1e-8)
    assert crossing.sum() > 10


def test_no_planar_path_is_shorter():
    """Paths in planes at many angles about the segment, on all sides of the ellipsoid."""
    sizes = np.array([0.03, 0.05, 0.02])
    ends = around_origin(40, sizes, 4)
    crossing, total, *_ = (np.asarray(part) for part in round_ellipsoid(ends, np.tile(sizes, (40, 1))))

    @jax.vmap
    def planar(ends):
        axes = jnp.asarray(sizes)
        start, end = ends[:3] / axes, ends[3:] / axes
        planes = jax.vmap(lambda angle: plane_through(start, end, angle))(jnp.linspace(0.0, 2.0 * jnp.pi, 48))
        return jax.vmap(lambda plane: planar_length(plane, start, end, axes))(planes)

    shortest = np.asarray(planar(jnp.asarray(ends))).min(axis=1)
    assert (total - shortest)[crossing].max() < 1e-8
    assert np.median((shortest - total)[crossing]) < 1e-4


def test_pulls_are_the_derivatives_of_length():
    """By central differences of the length by the positions of both ends."""
    sizes = np.tile([0.03, 0.05, 0.02], (60, 1))
    ends = around_origin(60, sizes[0], 5)
    crossing, total, pulls, _ = (np.asarray(part) for part in round_ellipsoid(ends, sizes))
    for column in range(6):
        step = 1e-6 * np.eye(6)[column]
        above, below = (np.asarray(round_ellipsoid(ends + sign * step, sizes)[1]) for sign in (1.0, -1.0))
        slope = (above - below) / 2e-6
        smooth = crossing & (np.abs(above + below - 2.0 * total) < 1e-9)
        sign = -1.0 if column < 3 else 1.0
        np.testing.assert_allclose(sign * pulls[smooth, column], slope[smooth], atol=1e-7)
    assert smooth.mean() > 0.4


def test_degenerate_paths_have_a_stated_answer_and_finite_derivatives():
    """Through the center, from the surface, from inside, antipodes, ends that coincide."""
    sizes = np.array([0.03, 0.05, 0.02])
    ends = np.array(
        [
            [-0.1, 0.0, 0.0, 0.1, 0.0, 0.0],
            [0.0, -0.05, 0.0, 0.0, 0.1, 0.0],
            [0.0, 0.0, -0.01, 0.001, 0.0, 0.1],
            [0.1, 0.0, 0.0, 0.1, 0.0, 0.0],
            [0.1, 0.0, 0.0, 0.2, 0.0, 0.0],
        ]
    )

    def total(one):
        placed = surface(sizes, 0.03)
        decision = SHORTEST["ellipsoid_hybrid"].decide(vector(one[:3]), vector(one[3:]), placed)
        contact = SHORTEST["ellipsoid_hybrid"].find_contact(
            vector(one[:3]), vector(one[3:]), placed, decision
        )
        return contact.total

    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(total)))(jnp.asarray(ends))
    assert np.isfinite(values).all() and np.isfinite(slopes).all()
    # The shortest way round from pole to pole of the long axis crosses the shortest one.
    assert values[0] > 0.2 + 1e-4


@pytest.mark.slow
def test_derivatives_by_wrap_parameters_equal_differences(tmp_path):
    """Center, orientation and all sizes of an ellipsoid, for length and moment arms in forward mode."""
    draw = replace(draw_surface("ellipsoid", np.random.default_rng(6), "all"), sizes=(0.03, 0.045, 0.025))
    engine, _ = engine_of([draw], tmp_path)
    poses = draw_poses(draw, 12, np.random.default_rng(7))
    posed = engine.posed(poses)[MUSCLE]

    @jax.jit
    def values(parameters):
        path = posed.wrapped(parameters[None], GEODESIC)
        return jnp.concatenate([path.length[:, None], path.moment_arm], axis=1)

    nominal = jnp.asarray(NOMINAL_PARAMETERS)
    slopes = np.asarray(jax.jit(jax.jacfwd(values))(nominal))
    here = np.asarray(values(nominal))
    checked = 0
    for place in range(nominal.size):
        step = 1e-6 * np.eye(nominal.size)[place]
        above, below = np.asarray(values(nominal + step)), np.asarray(values(nominal - step))
        smooth = np.abs(above + below - 2.0 * here)[:, 0] < 1e-9
        difference = (above - below) / 2e-6
        np.testing.assert_allclose(slopes[smooth, :, place], difference[smooth], atol=2e-5)
        checked += (np.abs(slopes[smooth, 0, place]) > 1e-3).sum()
    assert checked > 10


def test_surfaces_without_extent_and_unknown_classes_are_named(odd_model):
    model = describe_model(odd_model)
    flat = tuple(
        replace(wrap, sizes=(0.03, 0.0, 0.05)) if wrap.name == "brim" else wrap for wrap in model.wraps
    )
    with pytest.raises(
        InputError, match=r"'brim' of muscle 'hip_flexor' has no extent.* 0.03, 0, 0.05 found"
    ):
        ExactPaths(replace(model, wraps=flat), ["hip_flexor"], ("hip", "knee"))
    other = tuple(replace(wrap, kind="WrapMeshObst") if wrap.name == "brim" else wrap for wrap in model.wraps)
    with pytest.raises(InputError, match="wrap object 'brim' is a WrapMeshObst"):
        ExactPaths(replace(model, wraps=other), ["hip_flexor"], ("hip", "knee"))


def test_the_curve_has_few_variables():
    """Newton's steps eliminate them one after the other, in compiled code for each."""
    assert VARIABLES <= 10


#: Ends of the path of the long head of the biceps in a public model, one of them 1.7 mm inside its ellipsoid.
INSIDE, BESIDE = (0.0158, -0.0134, 0.0015), (-0.0032, -0.0194, -0.0122)


@pytest.mark.parametrize(
    ("start", "end"), [(INSIDE, BESIDE), (BESIDE, INSIDE), (INSIDE, (-0.03, -0.03, -0.03))]
)
def test_from_an_end_inside_an_ellipsoid_the_path_begins_along_the_surface(start, end):
    """The slopes by the ends are those of length, with the end inside moved to the surface."""
    step = 1e-5
    ends = np.array([*start, *end]) + step * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
    length, slope, on_surface = engine_paths(SurfaceDraw("ellipsoid", (0.025, 0.02, 0.02)), ends)
    assert on_surface.min() > 0.005
    np.testing.assert_allclose(slope[0], (length[1:7] - length[7:]) / (2.0 * step), atol=1e-4)
