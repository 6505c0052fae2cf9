"""Compiled functions are reused for another subject with the same shapes."""

import dataclasses

import pytest

from benchmarks.counting import counted_programs
from tests.model.small import small_limited_objective, small_objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt


def moments_alone(seed: int):
    """Build an objective without penalties, which compiles faster."""
    return dataclasses.replace(small_objective(seed), penalties=())


@pytest.mark.parametrize(
    ("make", "solver"),
    [
        pytest.param(moments_alone, ProjectedLevenbergMarquardt(max_iterations=3), id="moments alone"),
        pytest.param(
            small_objective,
            ProjectedLevenbergMarquardt(max_iterations=5),
            id="all penalties",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            small_limited_objective, AugmentedLagrangian(), id="paths and limits", marks=pytest.mark.slow
        ),
    ],
)
def test_second_subject_with_the_same_shapes_compiles_nothing(make, solver):
    first, second = make(0), make(1)
    start, other = first.start(first.initial), second.start(second.initial)
    with counted_programs() as asked:
        solver.compile(first, start)
        solver.solve(first, start)
    assert asked, "the count must include compilations"
    with counted_programs() as asked:
        solver.compile(second, other)
        solver.solve(second, other)
    assert asked == []
