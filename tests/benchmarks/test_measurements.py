"""Tiled and batched problems, evaluation counts, published times and roofline of the benchmarks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.batching import batched
from benchmarks.counting import counted_evaluations
from benchmarks.growth import Growth
from benchmarks.jacobian import residual_jacobian
from benchmarks.published_times import NMSM_PIPELINE, compare_with_published
from benchmarks.roofline import Roof, measure_work
from benchmarks.tiled_problems import perturb_problem, tile_problem
from benchmarks.timed_run import EvaluationRecorder
from tests.calibration.test_levenberg_marquardt import dense
from tests.model.small import small_objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt


@pytest.fixture(scope="module")
def problem():
    return small_objective()


def residuals(problem, variables):
    return problem.residuals(variables)


@eqx.filter_jit
def moments(problem):
    return problem._states(problem.initial).moment


def test_tiled_problem_repeats_muscles_and_trials(problem):
    """Tile three muscles and two trials twice; the moments of each copy equal those of the original."""
    large = tile_problem(problem, muscles=6, trials=4)
    assert large.variables.count == 2 * problem.variables.count
    tiled, expected = moments(large), moments(problem)
    for muscles in (slice(0, 3), slice(3, 6)):
        for trials in (slice(0, 2), slice(2, 4)):
            np.testing.assert_allclose(tiled[muscles, trials], expected, rtol=1e-12)
    # Groups of the original muscles are followed by those of their copies.
    for penalty, twice in zip(problem.penalties, large.penalties, strict=True):
        groups = getattr(penalty, "groups", ())
        copies = tuple(tuple(one + 3 for one in group) for group in groups)
        assert getattr(twice, "groups", ()) == groups + copies


def test_tiled_problem_frees_path_modes(problem):
    free = tile_problem(problem, muscles=2, trials=1, modes=4)
    assert free.variables.count == 2 * (6 + 4)
    assert [limit.name for limit in free.limits] == ["longest_fiber", "shortest_fiber", "moment_arm_sign"]


def test_jacobian_by_muscle_equals_jacfwd(problem):
    factor = np.random.default_rng(5).uniform(0.93, 1.07, problem.variables.count)
    point = problem.variables.start() * jnp.asarray(factor)
    plain = jax.jit(jax.jacfwd(problem.residuals))(point)
    found = eqx.filter_jit(residual_jacobian)(problem, point)
    np.testing.assert_allclose(found, plain, rtol=1e-9, atol=1e-11)


def test_batch_equals_single_evaluations(problem):
    problems = [problem, perturb_problem(problem, 1), perturb_problem(problem, 2)]
    assert not np.allclose(problems[1].measured, problems[2].measured)
    points = jnp.stack([one.variables.start() for one in problems])
    batch = batched(residuals, problems)(points)
    for actual, single, point in zip(batch, problems, points, strict=True):
        np.testing.assert_allclose(actual, eqx.filter_jit(residuals)(single, point), rtol=1e-9, atol=1e-12)


def test_evaluations_of_the_solver_are_counted():
    """Expect a cost for every trial step, and derivatives at the start and after each accepted step."""
    valley = dense(
        lambda x: jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), -2.0 * jnp.ones(2), 2.0 * jnp.ones(2)
    )
    with counted_evaluations() as asked:
        found = ProjectedLevenbergMarquardt(max_iterations=12).solve(valley, np.array([-1.2, 1.0]))
    accepted = int((np.diff([one.cost for one in found.history]) < 0.0).sum())
    assert 0 < accepted < found.iterations
    assert (asked.values, asked.linearizations, asked.total) == (12, 1 + accepted, 13 + accepted)


def test_published_effort_is_divided_by_measured_effort():
    recorder = EvaluationRecorder(1e9)
    for cost in (3.0, 2.0):
        recorder.record(np.zeros(1), cost)
    run = recorder.finish("wrapjax", "")
    assert run.evaluations == 2 and run.core_seconds >= 0.0
    metrics = {one.name: one.value for one in compare_with_published(run, 1e-3, "a problem", NMSM_PIPELINE)}
    assert metrics["solve/nmsm_pipeline/evaluations_over_ours"] == 161_831 / 2
    assert NMSM_PIPELINE.core_seconds == 7.4 * 60.0 * 16


def test_slope_is_the_exponent_of_the_size():
    growth = Growth("muscles", "residuals", (2, 4, 8), (4e-3, 16e-3, 64e-3), (1.0, 1.0, 1.0))
    assert growth.slope == pytest.approx(2.0)
    assert [metric.value for metric in growth.metrics()] == pytest.approx([2.0, 64.0, 1.0])


def test_operations_of_a_matrix_product_are_counted():
    first, second = jnp.ones((64, 64)), jnp.ones((64, 64))
    work = measure_work("product", jnp.matmul, (first, second))
    assert work.flops == pytest.approx(2 * 64**3, rel=0.02)
    assert work.bytes_moved == pytest.approx(3 * 8 * 64**2, rel=0.02)
    roof = Roof(peak=1e10, bandwidth=1e9)
    assert (roof.at(1.0), roof.at(100.0), roof.ridge) == (1e9, 1e10, 10.0)
