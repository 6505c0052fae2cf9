"""A calibration's derivatives and steps are the same on a GPU as on the processor."""

import equinox as eqx
import jax
import numpy as np
import pytest

from tests.model.small import small_limited_objective, small_objective
from wrapjax.calibrate import ProjectedLM

#: Relative to the largest number of each array: sums are added up in another order.
TOLERANCE = 1e-9


def gpu():
    try:
        return jax.devices("gpu")[0]
    except RuntimeError:
        pytest.skip("no GPU")


def on(device, tree):
    return jax.tree.map(lambda leaf: jax.device_put(leaf, device) if eqx.is_array(leaf) else leaf, tree)


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
    there = linearize(on(device, problem), on(device, point))
    assert there.gauss_newton.devices() == {device}
    cpu = jax.devices("cpu")[0]
    assert_alike(there, linearize(on(cpu, problem), on(cpu, point)))


@pytest.mark.gpu
def test_solves_end_in_the_same_place():
    device, problem = gpu(), small_objective()
    point = problem.start(problem.initial)
    cpu = jax.devices("cpu")[0]
    with jax.default_device(device):
        there = ProjectedLM().solve(on(device, problem), on(device, point))
    with jax.default_device(cpu):
        here = ProjectedLM().solve(on(cpu, problem), on(cpu, point))
    assert there.cost == pytest.approx(here.cost, rel=TOLERANCE)
