"""Movement of skin: the derivatives of the estimation, the functions of the drift, and what they explain."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

from tests.joints.person import make_person
from wrapjax.joints.personalisation import personalize_joints
from wrapjax.joints.problem import prepare_problem
from wrapjax.joints.settings import JointSettings, MarkerTrial
from wrapjax.joints.skin import angle_features, drift_functions
from wrapjax.preprocessing.files.markers import write_trc


@pytest.fixture(scope="module")
def person(tmp_path_factory):
    return make_person(tmp_path_factory.mktemp("person"))


def _settings(person, **changes):
    return JointSettings(
        file=person.folder / "joints.toml",
        name="P",
        model_file=person.model,
        trials=(MarkerTrial("walk", person.folder / "walk.trc"),),
        parameters=person.parameters,
        frames=20,
        **changes,
    )


@pytest.fixture(scope="module")
def problem(person):
    return prepare_problem(_settings(person)).problem


def test_the_gradient_is_that_of_the_cost(problem):
    """By central differences along random directions through parameters, movements with angles, and drift."""
    rng = np.random.default_rng(0)
    at = jnp.asarray(0.2 * rng.normal(size=problem.lower.size))
    gradient = np.asarray(problem.linearized_at(at).gradient)
    split = problem.sd.size, problem.sd.size + len(problem.skin.markers)
    for part in np.split(np.arange(at.size), split):
        assert part.size
        direction = np.zeros(at.size)
        direction[part] = rng.normal(size=part.size)
        step = 1e-4
        costs = [float(problem.value_at(at + sign * step * direction)) for sign in (1.0, -1.0)]
        assert gradient @ direction == pytest.approx((costs[0] - costs[1]) / (4.0 * step), rel=1e-5)


@pytest.mark.slow
def test_the_matrix_is_that_of_all_unknowns_with_poses_eliminated(problem):
    """Against the projected Jacobian of each frame, by automatic differentiation of all unknowns."""
    at = jnp.asarray(0.1 * np.random.default_rng(1).normal(size=problem.lower.size))
    poses = problem.fit(at).poses
    expected = np.eye(at.size)
    count = int((np.asarray(problem.frames.precision) > 0.0).sum())
    derivatives = jax.jit(
        jax.jacfwd(lambda values, pose, frame: _weighted(problem, values, pose, frame), (0, 1))
    )
    for place in range(0, count):
        row = (place // poses.shape[1], place % poses.shape[1])
        frame = jax.tree.map(lambda array, row=row: jnp.asarray(array)[row], problem.frames)
        by_variable, by_pose = map(np.asarray, derivatives(at, poses[row], frame))
        basis, _ = np.linalg.qr(by_pose)
        expected += by_variable.T @ by_variable - (by_variable.T @ basis) @ (basis.T @ by_variable)
    found = np.asarray(problem.linearized_at(at).gauss_newton)
    np.testing.assert_allclose(found, expected, atol=1e-6 * expected.max())


def _weighted(problem, values, pose, frame):
    root = jnp.sqrt(frame.goals.weights * frame.precision)[:, None]
    return (root * problem._skeleton(values, frame).positions(pose)).reshape(-1)


def test_a_frame_has_one_triangular_solve(problem):
    """Two that run at once may wait for each other forever in XLA's pool of threads, as they did."""
    frame = jax.tree.map(lambda array: jnp.asarray(array)[0, 0], problem.frames)
    at = jnp.zeros(problem.lower.size)
    of_terms, of_fit = (
        _count("triangular_solve", jax.make_jaxpr(function)(at, frame).jaxpr)
        for function in (problem._frame_terms, problem._fit)
    )
    assert of_terms - of_fit == 1


def _count(name, program):
    """Count an operation in a program and all programs that it calls."""
    return sum(
        (equation.primitive.name == name)
        + sum(_count(name, inner) for inner in jaxprs_in_params(equation.params))
        for equation in program.eqns
    )


def test_features_are_angles_and_their_squares():
    generator = np.random.default_rng(3)
    poses = np.stack([generator.normal(0.3, 0.2, 50), np.full(50, 0.7)], axis=1)
    features = angle_features(poses, poses)
    assert features.shape == (50, 4)
    np.testing.assert_allclose(features.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(features[:, 0].std(), 1.0)
    np.testing.assert_allclose(features[:, 2], features[:, 0] ** 2 - 1.0)
    # The second coordinate rests.
    assert not features[:, 3].any()


def test_skin_moves_with_squared_angles_less_than_with_angles(problem):
    skin, count = problem.skin, len(problem.model.structure.coordinates)
    squared = np.array(skin.features) >= count
    assert squared.sum() == (~squared).sum() > 0
    np.testing.assert_allclose(np.sum(skin.sd[squared] ** 2), 0.09 * np.sum(skin.sd[~squared] ** 2))


def test_functions_of_the_drift_have_its_covariance():
    times = [np.linspace(0.0, 1.0, 40), np.linspace(0.0, 0.5, 20)]
    functions = drift_functions(times, markers=4)
    covariance = functions @ functions.T
    lag = times[0][:, None] - times[0][None]
    np.testing.assert_allclose(covariance[:40, :40], np.exp(-0.5 * (lag / 0.25) ** 2), atol=0.1)
    assert not covariance[:40, 40:].any()
    assert functions.shape[1] < 15


def test_many_drifting_markers_have_fewer_functions():
    times = [np.linspace(0.0, 30.0, 100)]
    assert 3 * 50 * drift_functions(times, markers=50).shape[1] <= 800


@pytest.mark.slow
def test_smooth_drift_of_the_skin_is_told_from_the_joints(person, tmp_path):
    """Markers that drift slowly by 1.5 mm leave little noise, and all values within 3 standard deviations.

    One short walk with this skin determines the knee's axis to 1.1 degrees, so no smaller error can be asked.
    """
    rng = np.random.default_rng(2)
    time = person.markers.time
    size = rng.normal(0.0, 0.0015 / np.sqrt(3.0), (2, len(person.markers.names), 1, 3))
    phase = 2.0 * np.pi * 0.7 * time[None, :, None]
    drift = size[0] * np.sin(phase) + size[1] * np.cos(phase)
    file = tmp_path / "walk.trc"
    write_trc(file, replace(person.markers, positions=person.markers.positions + drift))
    settings = replace(_settings(person), trials=(MarkerTrial("walk", file),))
    found = personalize_joints(settings)
    assert found.noise < 0.0006
    for entry, value, true, sd in zip(
        found.parameters, found.values, person.truth, found.posterior.sd, strict=True
    ):
        assert abs(value - true) < 3.0 * sd, entry.name
