"""Multistart: reproducible starts, choice of the best result, and continuation from checkpoints."""

import dataclasses

import numpy as np
import pytest

from tests.model.small import small_limited_objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.checkpoints import Checkpoints
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import best_start, solve_from_starts, starting_points
from wrapjax.errors import InputError
from wrapjax.model.freedom import Freedom
from wrapjax.model.variables import free_variables

SOLVER = AugmentedLagrangian()


@pytest.fixture(scope="module")
def stages():
    """Stages with held and with free paths, with few variables."""
    moving = small_limited_objective(seed=1)
    from tests.model.small import MUSCLES
    from wrapjax.model.freedom import nga_freedom

    names = ("emg_scale", "optimal_fiber_length")
    kept = tuple(one for one in nga_freedom(moving.initial).parameters if one.name in names)
    held = dataclasses.replace(
        moving, variables=free_variables(moving.initial, Freedom("held", kept), MUSCLES), limits=()
    )
    return held, moving


@pytest.fixture(scope="module")
def starts(stages):
    return starting_points(stages[0], np.asarray(stages[0].start(stages[0].initial)), 2, seed=5)


@pytest.fixture(scope="module")
def undisturbed(stages, starts):
    return solve_from_starts(stages, starts, SOLVER)


def test_starts_are_determined_by_their_seed(stages):
    problem = stages[0]
    first = np.asarray(problem.start(problem.initial))
    points = starting_points(problem, first, 4, seed=10)
    assert [seed for seed, _ in points] == [None, 11, 12, 13]
    np.testing.assert_array_equal(points[0][1], first)
    again = starting_points(problem, first, 2, seed=12)
    np.testing.assert_array_equal(again[1][1], points[3][1])
    for _, point in points:
        assert (point >= problem.lower).all() and (point <= problem.upper).all()
    assert len({point.tobytes() for _, point in points}) == 4


def test_the_chosen_start_has_converged(undisturbed):
    def ended(cost, status):
        solution = dataclasses.replace(undisturbed[0].solution, cost=cost, status=status)
        return dataclasses.replace(undisturbed[0], solution=solution)

    low, high = ended(1.0, Status.gradient), ended(2.0, Status.cost)
    lower_but_not_converged = ended(0.5, Status.iterations)
    assert best_start((high, low)) == 1 and best_start((low, high)) == 0
    assert best_start((lower_but_not_converged, high, low)) == 2
    assert best_start((lower_but_not_converged, ended(0.7, Status.damping))) == 0


def test_last_stage_starts_from_the_solution_of_the_first(stages, undisturbed):
    for outcome in undisturbed:
        alone = SOLVER.solve(stages[0], outcome.start)
        history = outcome.solution.history
        assert [one.number for one in history] == list(range(len(history)))
        assert history[alone.iterations].cost == pytest.approx(alone.cost, rel=1e-12)


def _stop_at(start, number):
    def watch(own, iteration, state):
        if (own, iteration.number) == (start, number):
            raise KeyboardInterrupt

    return watch


@pytest.mark.parametrize(("start", "share"), [(0, 0.05), (0, 0.6), (1, 0.05), (1, 0.9)])
def test_interrupted_solves_continue_to_the_same_optimum(stages, starts, undisturbed, tmp_path, start, share):
    number = max(1, int(share * undisturbed[start].solution.iterations))
    book = Checkpoints.open(tmp_path / "book", "question", resume=False)
    stopped = solve_from_starts(stages, starts, SOLVER, _stop_at(start, number), book)
    assert stopped[-1].solution.status is Status.interrupted and len(stopped) == start + 1
    seen = []
    resumed = solve_from_starts(
        stages,
        starts,
        SOLVER,
        lambda own, iteration, state: seen.append(own),
        Checkpoints.open(tmp_path / "book", "question", resume=True),
    )
    assert start == 0 or 0 not in seen, "a finished start was solved again"
    for ours, theirs in zip(resumed, undisturbed, strict=True):
        assert ours.solution.status.converged
        assert ours.solution.cost == pytest.approx(theirs.solution.cost, rel=1e-12)
        np.testing.assert_allclose(ours.solution.variables, theirs.solution.variables, atol=1e-8)
        assert ours.solution.iterations <= theirs.solution.iterations + 1
        assert ours.solution.max_violation == pytest.approx(theirs.solution.max_violation, abs=1e-9)


def test_a_damaged_checkpoint_counts_as_absent(stages, starts, undisturbed, tmp_path):
    book = Checkpoints.open(tmp_path / "book", "question", resume=False)
    solve_from_starts(stages[:1], starts[:1], SOLVER, None, book)
    assert book.read("start_0_stage_0").status.converged
    file = tmp_path / "book" / "start_0_stage_0.npz"
    file.write_bytes(file.read_bytes()[:200])
    assert book.read("start_0_stage_0") is None
    assert book.read("start_7_stage_0") is None


def test_checkpoints_of_another_calibration_are_refused(tmp_path):
    Checkpoints.open(tmp_path / "book", "one question", resume=False)
    with pytest.raises(InputError, match="other data or settings"):
        Checkpoints.open(tmp_path / "book", "another", resume=True)
    with pytest.raises(InputError, match="no interrupted work"):
        Checkpoints.open(tmp_path / "nowhere", "one question", resume=True)
    book = Checkpoints.open(tmp_path / "book", "one question", resume=True)
    book.close()
    assert not (tmp_path / "book").exists()
