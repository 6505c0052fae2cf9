"""Problems that benchmarks make bigger or batch are what they stand for; effort is counted as it is spent."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.batching import batched
from benchmarks.counting import counted_evaluations
from benchmarks.growth import Growth
from benchmarks.jacobian import residual_jacobian
from benchmarks.published import NMSM_PIPELINE, beside_published
from benchmarks.race import IterationCallback
from benchmarks.roofline import Roof, work_of
from benchmarks.tiled import another_person, tiled
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


def test_tiled_muscles_and_trials_are_those_of_the_subject(problem):
    """Three muscles twice, two trials twice: each copy does what the first one does."""
    large = tiled(problem, muscles=6, trials=4)
    assert large.variables.count == 2 * problem.variables.count
    found, own = moments(large), moments(problem)
    for muscles in (slice(0, 3), slice(3, 6)):
        for trials in (slice(0, 2), slice(2, 4)):
            np.testing.assert_allclose(found[muscles, trials], own, rtol=1e-12)
    # Groups are those of the first muscles, and once more those of their copies.
    for penalty, twice in zip(problem.penalties, large.penalties, strict=True):
        groups = getattr(penalty, "groups", ())
        copies = tuple(tuple(one + 3 for one in group) for group in groups)
        assert getattr(twice, "groups", ()) == groups + copies


def test_tiled_paths_may_change_by_as_many_modes(problem):
    free = tiled(problem, muscles=2, trials=1, modes=4)
    assert free.variables.count == 2 * (6 + 4)
    assert [limit.name for limit in free.limits] == ["longest_fiber", "shortest_fiber", "moment_arm_sign"]


def test_jacobian_by_muscle_is_the_plain_one_of_all_residuals(problem):
    factor = np.random.default_rng(5).uniform(0.93, 1.07, problem.variables.count)
    point = problem.variables.start() * jnp.asarray(factor)
    plain = jax.jit(jax.jacfwd(problem.residuals))(point)
    found = eqx.filter_jit(residual_jacobian)(problem, point)
    np.testing.assert_allclose(found, plain, rtol=1e-9, atol=1e-11)


def test_a_batch_of_people_gives_what_each_gives_alone(problem):
    people = [problem, another_person(problem, 1), another_person(problem, 2)]
    assert not np.allclose(people[1].measured, people[2].measured)
    points = jnp.stack([one.variables.start() for one in people])
    together = batched(residuals, people)(points)
    for found, person, point in zip(together, people, points, strict=True):
        np.testing.assert_allclose(found, eqx.filter_jit(residuals)(person, point), rtol=1e-9, atol=1e-12)


def test_evaluations_are_those_that_the_solver_asks_for():
    """A cost for every step that is tried; derivatives at the start and after each step that is taken."""
    valley = dense(
        lambda x: jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), -2.0 * jnp.ones(2), 2.0 * jnp.ones(2)
    )
    with counted_evaluations() as asked:
        found = ProjectedLevenbergMarquardt(max_iterations=12).solve(valley, np.array([-1.2, 1.0]))
    taken = int((np.diff([one.cost for one in found.history]) < 0.0).sum())
    assert 0 < taken < found.iterations
    assert (asked.values, asked.linearizations, asked.total) == (12, 1 + taken, 13 + taken)


def test_published_figures_are_over_ours():
    watch = IterationCallback(1e9)
    for cost in (3.0, 2.0):
        watch.see(np.zeros(1), cost)
    run = watch.finish("wrapjax", "")
    assert run.evaluations == 2 and run.core_seconds >= 0.0
    metrics = {one.name: one.value for one in beside_published(run, 1e-3, "a problem", NMSM_PIPELINE)}
    assert metrics["solve/nmsm_pipeline/evaluations_over_ours"] == 161_831 / 2
    assert NMSM_PIPELINE.core_seconds == 7.4 * 60.0 * 16


def test_slope_is_the_power_of_the_size():
    growth = Growth("muscles", "residuals", (2, 4, 8), (4e-3, 16e-3, 64e-3), (1.0, 1.0, 1.0))
    assert growth.slope == pytest.approx(2.0)
    assert [metric.value for metric in growth.metrics()] == pytest.approx([2.0, 64.0, 1.0])


def test_work_of_a_product_of_matrices_is_counted():
    first, second = jnp.ones((64, 64)), jnp.ones((64, 64))
    work = work_of("product", jnp.matmul, (first, second))
    assert work.flops == pytest.approx(2 * 64**3, rel=0.02)
    assert work.bytes_moved == pytest.approx(3 * 8 * 64**2, rel=0.02)
    roof = Roof(peak=1e10, bandwidth=1e9)
    assert (roof.at(1.0), roof.at(100.0), roof.ridge) == (1e9, 1e10, 10.0)
