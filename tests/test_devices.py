"""A GPU and the processor give the same paths, derivatives, solver steps and batches of people."""

import equinox as eqx
import jax
import numpy as np
import pytest

from benchmarks.batching import batched
from benchmarks.devices import on_device
from benchmarks.tiled_problems import perturb_problem
from benchmarks.wrap_surfaces import KINDS, swept_path
from tests.model.small import small_limited_objective, small_objective
from tests.subject.synthetic import write_wrapped_subject
from validation.wrapping.single_path import COORDINATES, write_model
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.geometry.exact_paths.engine import GEODESIC, PARITY, ExactPaths, wrap_at_samples
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.muscle_paths import MODES, muscle_paths

#: Relative to the largest number of each array: sums are added up in another order.
TOLERANCE = 1e-9


def gpu():
    try:
        return jax.devices("gpu")[0]
    except RuntimeError:
        pytest.skip("no GPU")


def assert_alike(found, expected):
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        largest = np.abs(np.asarray(other)).max(initial=0.0)
        np.testing.assert_allclose(one, other, rtol=TOLERANCE, atol=TOLERANCE * largest)


@pytest.mark.gpu
@pytest.mark.parametrize("make", [small_objective, small_limited_objective])
def test_linearizations_agree(make):
    device, problem = gpu(), make()
    point = problem.start(problem.initial)
    linearize = eqx.filter_jit(lambda problem, x: problem.linearize(x))
    there = linearize(on_device(device, problem), on_device(device, point))
    assert there.gauss_newton.devices() == {device}
    cpu = jax.devices("cpu")[0]
    assert_alike(there, linearize(on_device(cpu, problem), on_device(cpu, point)))


@pytest.mark.gpu
def test_solves_have_the_same_cost():
    device, problem = gpu(), small_objective()
    point = problem.start(problem.initial)
    cpu = jax.devices("cpu")[0]
    with jax.default_device(device):
        there = ProjectedLevenbergMarquardt().solve(on_device(device, problem), on_device(device, point))
    with jax.default_device(cpu):
        here = ProjectedLevenbergMarquardt().solve(on_device(cpu, problem), on_device(cpu, point))
    assert there.cost == pytest.approx(here.cost, rel=TOLERANCE)


@pytest.mark.gpu
@pytest.mark.parametrize("wrapping", [GEODESIC, PARITY], ids=lambda one: one.name)
def test_paths_agree(wrapping, tmp_path):
    device = gpu()
    model = describe_model(write_wrapped_subject(tmp_path) / "model.osim")
    engine = ExactPaths(model, ["semiten_l"], ("hip_flexion_l", "knee_angle_l"))
    generator = np.random.default_rng(0)
    posed = engine.posed(generator.uniform([-0.4, 0.0], [0.8, 1.4], (20, 2)))["semiten_l"]
    low, high = [-0.01, -0.01, -0.01, -0.3, -0.3, 0.8], [0.01, 0.01, 0.01, 0.3, 0.3, 1.2]
    samples = generator.uniform(low, high, (10, 1, 6))
    with jax.default_device(device):
        there = wrap_at_samples(on_device(device, posed), samples, wrapping)
    with jax.default_device(jax.devices("cpu")[0]):
        here = wrap_at_samples(posed, samples, wrapping)
    assert_alike(there, here)


@pytest.mark.gpu
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", KINDS)
def test_paths_round_each_surface_agree(kind, mode, tmp_path):
    device = gpu()
    surface, poses = swept_path(kind, count=100, seed=1)
    write_model([surface], tmp_path / "path.osim")
    posed = muscle_paths(tmp_path / "path.osim", mode=mode, coordinates=COORDINATES).posed(poses)
    evaluate = eqx.filter_jit(lambda own: own())
    there = evaluate(on_device(device, posed))
    assert there.length.devices() == {device}
    assert_alike(there, evaluate(on_device(jax.devices("cpu")[0], posed)))


@pytest.mark.gpu
def test_batched_people_agree():
    device, problem = gpu(), small_objective()
    people = [perturb_problem(problem, seed) for seed in range(3)]
    points = np.stack([person.variables.start() for person in people])
    with jax.default_device(device):
        there = batched(lambda one, x: one.linearize(x), on_device(device, people))(on_device(device, points))
    for number, person in enumerate(people):
        here = eqx.filter_jit(lambda one, x: one.linearize(x))(person, points[number])
        assert_alike(jax.tree.map(lambda leaf, number=number: leaf[number], there), here)
