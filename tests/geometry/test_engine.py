"""Tests of the exact engine: OpenSim's values in parity mode, shortest paths in geodesic mode."""

from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root

from wrapjax.errors import InputError
from wrapjax.geometry.exact_paths import several_wraps
from wrapjax.geometry.exact_paths.engine import (
    GEODESIC,
    PARITY,
    ExactPaths,
    nominal_parameters,
    wrap_at_samples,
)
from wrapjax.geometry.exact_paths.path_on_cylinders import PointsAndBodies
from wrapjax.geometry.exact_paths.several_wraps import wrap_shortest
from wrapjax.geometry.exact_paths.wrapping import FREE, NOMINAL, Surface
from wrapjax.osim.model import describe_model
from wrapjax.osim.path_engine import PathEngine

LOW = np.array([-0.4, -0.3, -0.3, 0.0, -0.4, -0.3])
HIGH = np.array([0.8, 0.3, 0.3, 1.4, 0.4, 0.3])
#: About 1 cm, 20 degrees and a fifth of the radius: many of these samples are not physiological.
SAMPLE_LOW = np.array([-0.01, -0.01, -0.01, -0.35, -0.35, 0.8])
SAMPLE_HIGH = np.array([0.01, 0.01, 0.01, 0.35, 0.35, 1.2])
RECORDED = [("s1_left", "l"), ("healthy_overground", "r"), ("healthy_treadmill", "l")]


def coordinates_of(model, side):
    """Coordinates of a leg, of which the model may lack the subtalar angle."""
    hip = ("hip_flexion", "hip_adduction", "hip_rotation")
    names = [f"{name}_{side}" for name in (*hip, "knee_angle", "ankle_angle", "subtalar_angle")]
    existing = {coordinate.name for coordinate in model.coordinates}
    return tuple(name for name in names if name in existing)


def wrapped_muscles(model, side):
    return [entry.name for entry in model.muscles if entry.wraps and entry.name.endswith(f"_{side}")]


def draw(poses, samples, seed):
    generator = np.random.default_rng(seed)
    return generator.uniform(LOW, HIGH, (poses, LOW.size)), generator.uniform(
        SAMPLE_LOW, SAMPLE_HIGH, (samples, 6)
    )


def by_opensim(file, model, muscles, coordinates, poses, samples):
    """Lengths and moment arms by OpenSim, with the same wrap parameters of all cylinders of the model."""
    reference = PathEngine(file, coordinates, dict.fromkeys(muscles, coordinates))
    results = []
    for sample in samples:
        reference.place({wrap.name: tuple(sample) for wrap in model.wraps})
        results.append(reference.analyse(poses))
    length, arms = (np.stack(parts) for parts in zip(*results, strict=True))
    return length, arms


def compare_with_opensim(file, side, poses, samples):
    model = describe_model(file)
    coordinates = coordinates_of(model, side)
    assert len(coordinates) >= 5
    poses = poses[:, : len(coordinates)]
    muscles = wrapped_muscles(model, side)
    assert len(muscles) == 21
    length, arms = by_opensim(file, model, muscles, coordinates, poses, samples)
    engine = ExactPaths(model, muscles, coordinates)
    touched = 0
    for place, (name, posed) in enumerate(engine.posed(poses).items()):
        parameters = np.repeat(samples[:, None], len(engine.wraps_of(name)), axis=1)
        found = wrap_at_samples(posed, parameters, PARITY)
        np.testing.assert_allclose(found.length, length[:, :, place], atol=1e-9, rtol=0, err_msg=name)
        # All coordinates: with two cylinders OpenSim gives moment arms also about joints that are not
        # spanned.
        np.testing.assert_allclose(found.moment_arm, arms[:, :, :, place], atol=1e-8, rtol=0, err_msg=name)
        touched += found.touching.any(axis=-1).sum()
        if len(engine.wraps_of(name)) == 1:
            shortest = wrap_at_samples(posed, parameters, GEODESIC)
            # Margins of both paths: OpenSim's contact may be off the end where that of the shortest path is
            # not.
            clear = clear_of_jumps(shortest.margins, 0.0) & clear_of_jumps(found.margins, 0.0)
            assert clear.mean() > 0.1, name
            assert (shortest.length - length[:, :, place])[clear].max() < 1e-9, name
    return touched


@pytest.mark.parametrize(("subject", "side"), RECORDED)
def test_parity_equals_opensim(data_folder, subject, side):
    poses, samples = draw(60, 8, seed=0)
    touched = compare_with_opensim(data_folder / subject / "model.osim", side, poses, samples)
    assert touched > 0.2 * 21 * 60 * 8


@pytest.mark.slow
@pytest.mark.parametrize(("subject", "side"), RECORDED)
def test_parity_equals_opensim_in_many_samples(data_folder, subject, side):
    """500 poses times 50 samples of wrap parameters of every wrapped muscle, also non-physiological ones."""
    poses, samples = draw(500, 50, seed=1)
    compare_with_opensim(data_folder / subject / "model.osim", side, poses, samples)


def test_parity_with_offset_frames_and_conditional_points(odd_model):
    model, coordinates = describe_model(odd_model), ("hip", "knee")
    poses = np.random.default_rng(2).uniform([-1.0, 0.0], [1.0, 2.0], (100, 2))
    samples = np.random.default_rng(3).uniform(SAMPLE_LOW, SAMPLE_HIGH, (10, 6))
    # A second path through the conditional point, which wraps.
    path = replace(model.muscle("conditional"), wraps=model.muscle("flexor").wraps)
    muscles = tuple(path if entry.name == path.name else entry for entry in model.muscles)
    length, arms = by_opensim(odd_model, model, ["flexor"], coordinates, poses, samples)
    posed = ExactPaths(model, ["flexor"], coordinates).posed(poses)["flexor"]
    found = wrap_at_samples(posed, samples[:, None], PARITY)
    np.testing.assert_allclose(found.length, length[:, :, 0], atol=1e-12)
    np.testing.assert_allclose(found.moment_arm, arms[:, :, :, 0], atol=1e-11)
    assert 0.1 < found.touching.mean() < 1.0
    conditional = ExactPaths(replace(model, muscles=muscles), ["conditional"], coordinates).posed(poses)
    eligible = np.asarray(conditional["conditional"].path.eligible)
    active = (poses[:, 1] >= 0.5) & (poses[:, 1] <= 2.0)
    np.testing.assert_array_equal(eligible, np.stack([active, np.ones(100, dtype=bool)], axis=1))


@pytest.fixture(scope="module")
def leg(s1_left):
    """Engine of all wrapped muscles of a leg, some poses, and samples of wrap parameters."""
    model = describe_model(s1_left / "model.osim")
    coordinates = coordinates_of(model, "l")
    engine = ExactPaths(model, wrapped_muscles(model, "l"), coordinates)
    return engine, *draw(24, 6, seed=4)


def clear_of_jumps(margins, least=1e-3):
    return (margins.inside > least) & (margins.off_end > least) & (margins.long_wrap > least)


def test_geodesic_moment_arm_is_minus_the_derivative_of_length(leg):
    """For every coordinate and every muscle, those with two cylinders included."""
    engine, poses, samples = leg
    at, step = engine.posed(poses), 2e-6
    worst = 0.0
    for place in range(len(engine.coordinates)):
        shift = step * np.eye(LOW.size)[place]
        ahead, behind = engine.posed(poses + shift), engine.posed(poses - shift)
        for name, posed in at.items():
            parameters = np.repeat(samples[:, None], len(engine.wraps_of(name)), axis=1)
            here, above, below = (
                wrap_at_samples(one, parameters) for one in (posed, ahead[name], behind[name])
            )
            # No discontinuity and no kink at lift-off lies between the three poses.
            smooth = clear_of_jumps(here.margins) & (above.touching == below.touching).all(axis=-1)
            kink = np.abs(above.length + below.length - 2 * here.length) > 1e-10
            slope = (above.length - below.length) / (2 * step)
            error = np.abs(here.moment_arm[:, :, place] + slope)[smooth & ~kink]
            assert kink[smooth].mean() < 0.02
            worst = max(worst, error.max())
    assert worst < 1e-9


@pytest.mark.parametrize("wraps", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_gradients_by_wrap_parameters_equal_differences(leg, wraps):
    """Reverse mode, for lengths, moment arms and clearances of all muscles with this number of cylinders."""
    engine, poses, _ = leg
    posed = engine.posed(poses)
    muscles = [name for name in engine.muscles if len(engine.wraps_of(name)) == wraps]
    assert len(muscles) == {1: 19, 2: 2}[wraps]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(posed[name] for name in muscles))
    generator = np.random.default_rng(6)
    start = np.stack([nominal_parameters(wraps)] * len(muscles))
    start += 0.1 * generator.uniform(-1, 1, start.shape) * (SAMPLE_HIGH - NOMINAL)

    def paths(parameters):
        return jax.vmap(lambda one, own: one.wrapped(own))(stacked, parameters)

    def quantities(parameters):
        """Lengths, moment arms and clearances (``muscle pose quantity``)."""
        path = paths(parameters)
        return jnp.concatenate([path.length[..., None], path.moment_arm, path.clearances], axis=-1)

    here = jax.tree.map(np.asarray, jax.jit(paths)(jnp.asarray(start)))
    values = np.asarray(jax.jit(quantities)(jnp.asarray(start)))
    # Paths are smooth on both sides of a discontinuity.
    clear = np.all([np.abs(margin) > 1e-3 for margin in jax.tree.leaves(here.margins)], axis=0)
    assert (clear & here.touching.any(axis=-1)).any(axis=1).sum() > 0.5 * len(muscles)
    # `FREE` is a constant without a derivative.
    weights = generator.normal(size=values.shape) * (clear[..., None] & (values != FREE))
    assert (weights[..., -3:] != 0.0).any()

    def total(parameters):
        return jnp.sum(jnp.where(weights == 0.0, 0.0, quantities(parameters)) * weights, axis=(1, 2))

    slope = jax.jit(jax.grad(lambda parameters: jnp.sum(total(parameters))))(jnp.asarray(start))
    value = jax.jit(total)
    for place in np.ndindex(start.shape[1:]):
        step = np.zeros(start.shape[1:])
        step[place] = 1e-6
        difference = (value(start + step) - value(start - step)) / 2e-6
        np.testing.assert_allclose(slope[(slice(None), *place)], difference, atol=3e-7, err_msg=str(place))


@pytest.mark.slow
def test_forward_and_reverse_mode_agree(leg):
    engine, poses, _ = leg
    posed = engine.posed(poses[:3])["gaslat_l"]
    start = jnp.asarray(nominal_parameters(2))

    def lengths_and_arms(parameters):
        path = posed.wrapped(parameters)
        return jnp.concatenate([path.length[:, None], path.moment_arm], axis=1)

    forward, reverse = (jax.jit(mode(lengths_and_arms))(start) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, atol=1e-12)
    assert np.abs(forward).max() > 1e-2


@pytest.mark.parametrize("tolerance", [1e-13, 0.0])
def test_scipy_finds_the_same_shortest_path_round_two_cylinders(tolerance, monkeypatch):
    """Two skew cylinders, both touched: SciPy solves for the four points of contact.

    With a tolerance of zero, rounding keeps the contacts from arriving, as it may on some processors.
    """
    monkeypatch.setattr(several_wraps, "_GEODESIC_TOLERANCE", tolerance)
    ends = np.array([[-0.2, 0.0, 0.0], [0.25, -0.005, 0.05]])
    centers = np.array([[-0.07, -0.01, 0.0], [0.1, -0.012, 0.02]])
    tilts = [np.eye(3), np.array([[1, 0, 0], [0, np.cos(0.3), -np.sin(0.3)], [0, np.sin(0.3), np.cos(0.3)]])]
    radii = np.array([0.03, 0.025])
    nothing = jnp.zeros((1, 2, 3))
    path = PointsAndBodies(
        position=jnp.asarray(ends),
        velocity=nothing,
        point_body=jnp.asarray([0, 1]),
        rotation=jnp.tile(jnp.eye(3), (2, 1, 1)),
        origin=jnp.zeros((2, 3)),
        angular=nothing,
        linear=nothing,
        wrap_body=jnp.asarray([0, 1]),
        first_point=jnp.asarray([0, 0]),
        last_point=jnp.asarray([1, 1]),
    )
    surfaces = Surface(
        rotation=jnp.asarray(np.stack(tilts)),
        center=jnp.asarray(centers),
        radius=jnp.asarray(radii),
        length=jnp.asarray([0.5, 0.5]),
        side_axis=jnp.asarray([0, 0]),
        side=jnp.asarray([0, 0]),
    )
    cylinders = jax.vmap(Surface.placed)(surfaces, jnp.asarray(nominal_parameters(2)))

    def along(x):
        """The three straight segments, and the two arcs as angle and rise."""
        contacts = [
            centers[place] + tilts[place] @ [radii[place] * np.cos(a), radii[place] * np.sin(a), z]
            for place, (angle, height, turn, rise) in enumerate(x.reshape(2, 4))
            for a, z in ((angle, height), (angle + turn, height + rise))
        ]
        stations = [ends[0], *contacts, ends[1]]
        pieces = [stations[place + 1] - stations[place] for place in (0, 2, 4)]
        return pieces, [(turn, rise) for _, _, turn, rise in x.reshape(2, 4)]

    def kinks(x):
        """Zero on a shortest path, where straight segments are tangent to the surface and to the arc."""
        pieces, _ = along(x)
        found = []
        for place, (angle, _, turn, rise) in enumerate(x.reshape(2, 4)):
            steepness = rise / np.hypot(radii[place] * turn, rise)
            for at, piece in ((angle, pieces[place]), (angle + turn, pieces[place + 1])):
                own = tilts[place].T @ piece / np.linalg.norm(piece)
                found += [own @ [np.cos(at), np.sin(at), 0.0], own[2] - steepness]
        return found

    solved = root(kinks, [1.75, 0.01, -0.2, 0.001, 1.6, 0.01, -0.1, 0.001], tol=1e-13)
    assert solved.success and (solved.x.reshape(2, 4)[:, 2] < -0.02).all()
    pieces, arcs = along(solved.x)
    length = sum(np.linalg.norm(piece) for piece in pieces)
    length += sum(np.hypot(radius * turn, rise) for radius, (turn, rise) in zip(radii, arcs, strict=True))
    found = wrap_shortest(path, cylinders)
    assert float(found.length) == pytest.approx(length, abs=1e-12)
    assert float(found.margins.long_wrap) > 0.0


def test_opensims_path_jumps_where_a_margin_is_zero(leg):
    """The margin decreases evenly as a cylinder moves towards a path point; at zero OpenSim's path jumps."""
    engine, poses, _ = leg
    posed = engine.posed(poses[:4])["psoas_l"]
    reach = np.linspace(0.0, 0.05, 401)
    jumped = 0
    for axis, sign in product((0, 1), (-1.0, 1.0)):
        parameters = np.tile(NOMINAL, (reach.size, 1, 1))
        parameters[:, 0, axis] = sign * reach
        paths = [wrap_at_samples(posed, parameters, wrapping) for wrapping in (PARITY, GEODESIC)]
        margin = paths[0].margins.inside
        assert np.abs(np.diff(margin, axis=0)).max() <= reach[1] + 1e-12
        steps, shortest = (np.abs(np.diff(path.length, axis=0)) for path in paths)
        jumps = steps > 1e-3
        assert (margin[:-1] * margin[1:])[jumps].max(initial=0.0) <= 0.0
        # The shortest path treats the end as a point of the surface and is continuous.
        near = np.abs(margin[:-1]) < 2e-3
        assert shortest[near].max(initial=0.0) < reach[1] + 1e-12
        jumped += jumps.sum()
    assert jumped > 0


def test_unsupported_paths_are_named_in_errors(odd_model):
    model = describe_model(odd_model)
    muscles = tuple(replace(entry, path_kind="FunctionBasedPath") for entry in model.muscles)
    with pytest.raises(InputError, match="muscle 'flexor' has a FunctionBasedPath"):
        ExactPaths(replace(model, muscles=muscles), ["flexor"], ("hip", "knee"))


@pytest.mark.parametrize(
    "wrapping", [pytest.param(GEODESIC, marks=pytest.mark.slow), PARITY], ids=["geodesic", "parity"]
)
def test_an_inactive_point_on_another_body_changes_no_path(s1_left, wrapping):
    """A conditional point out of its range belongs to no segment, whatever body it is on."""
    model = describe_model(s1_left / "model.osim")
    coordinates = ("knee_angle_l", "ankle_angle_l")
    gastrocnemius = model.muscle("gasmed_l")
    first, last = gastrocnemius.points
    between = replace(last, kind="ConditionalPathPoint", active_range=("knee_angle_l", 3.0, 4.0))
    longer = replace(gastrocnemius, points=(first, between, last))
    changed = replace(model, muscles=tuple(longer if one is gastrocnemius else one for one in model.muscles))
    poses = np.array([[0.0, -0.2], [0.3, 0.1], [1.2, 0.0]])
    # Round surfaces as they are, and moved up so far that no segment reaches them.
    parameters = np.stack([nominal_parameters(2)] * 2)
    parameters[1, :, 1] = 1.0
    expected, found = (
        wrap_at_samples(
            ExactPaths(one, ("gasmed_l",), coordinates).posed(poses)["gasmed_l"],
            parameters,
            wrapping,
        )
        for one in (model, changed)
    )
    assert (expected.on_surface > 0.0).any(axis=-1).tolist() == [[True] * 3, [False] * 3]
    np.testing.assert_allclose(found.length, expected.length, atol=1e-13)
    np.testing.assert_allclose(found.moment_arm, expected.moment_arm, atol=1e-13)
