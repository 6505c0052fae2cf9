"""Posterior: agreement with exact solutions, and of Laplace approximation and bootstrap."""

import functools
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from tests.model.small import MUSCLES, small_parameters, small_recording
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.checkpoints import Checkpoints
from wrapjax.calibration.solvers.interface import AbstractCalibration
from wrapjax.calibration.uncertainty.intervals import summarize_draws
from wrapjax.calibration.uncertainty.posterior import Posterior, draw_truncated_normal, posterior
from wrapjax.calibration.uncertainty.residual_noise import ResidualNoise, residual_noise
from wrapjax.calibration.uncertainty.uncertainty import randomized_refits
from wrapjax.model.forward import joint_moments
from wrapjax.model.freedom import Freedom, FreedParameter
from wrapjax.model.variables import free_variables
from wrapjax.muscle.curves import HILL_CURVES

SOLVER = AugmentedLagrangian()
SPEEDS = [np.array([1.0, 1.0])]


# ---- Truncated normal distribution


def test_truncated_draws_have_the_moments_of_rejection_sampling():
    """Mean and covariance equal those of untruncated draws of which those outside are rejected."""
    generator = np.random.default_rng(0)
    root = generator.normal(size=(4, 4))
    covariance, mean = root @ root.T + 0.05 * np.eye(4), np.array([0.5, -1.0, 0.3, 2.0])
    lower, upper = np.array([-0.5, -0.5, -np.inf, -np.inf]), np.array([1.0, np.inf, 0.8, np.inf])
    draws = draw_truncated_normal(mean, covariance, lower, upper, 4000, seed=1)
    every = mean + generator.standard_normal((400_000, 4)) @ np.linalg.cholesky(covariance).T
    kept = every[((every >= lower) & (every <= upper)).all(axis=1)]
    assert ((draws >= lower) & (draws <= upper)).all()
    np.testing.assert_allclose(draws.mean(axis=0), kept.mean(axis=0), atol=0.08 * kept.std(axis=0).min())
    np.testing.assert_allclose(draws.std(axis=0), kept.std(axis=0), rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(draws.T), np.corrcoef(kept.T), atol=0.06)


def test_draws_far_in_a_tail_are_exact():
    """Beyond thirty deviations the distribution is nearly exponential; logarithms must not underflow."""
    mean, bound = np.array([-30.0]), np.array([0.0])
    draws = draw_truncated_normal(mean, np.eye(1), bound, np.array([np.inf]), 4000, seed=2)[:, 0]
    exact = scipy.stats.truncnorm(30.0, np.inf, loc=-30.0)
    np.testing.assert_allclose(np.percentile(draws, [10, 50, 90]), exact.ppf([0.1, 0.5, 0.9]), rtol=0.1)


# ---- Noise of residuals


def known_noise(repeated: float) -> ResidualNoise:
    """Build noise of two coordinates, smooth over the cycle, with larger variance of means of cycles."""
    trivial = residual_noise(
        np.zeros((6, 2, 51)), np.repeat([0.8, 1.2], 3), np.zeros((6, 2, 51, 1)), np.zeros((1, 1))
    )
    harmonic = (np.arange(51) + 1) // 2
    variance = np.exp(-harmonic / 4.0) * np.array([4.0, 25.0])[:, None] * np.ones((6, 1, 1))
    variance[[0, 3]] *= repeated
    return replace(trivial, variance=variance)


def test_covariance_of_drawn_noise_is_the_given_one():
    noise = known_noise(3.0)
    generator = np.random.default_rng(3)
    draws = np.stack([noise.draw(generator) for _ in range(3000)])
    np.testing.assert_allclose(np.sqrt((draws**2).mean(axis=(0, 1, 3))), noise.deviation, rtol=0.02)
    slopes = np.random.default_rng(4).normal(size=(6, 2, 51, 3)).cumsum(axis=2)
    data = np.cov(np.einsum("dtcf,tcfv->dv", draws, slopes).T)
    np.testing.assert_allclose(data, noise.propagate(slopes), rtol=0.15, atol=0.1 * np.diag(data).min())


@pytest.mark.parametrize("repeated", [1.0, 6.0])
def test_noise_is_estimated_although_the_calibration_fitted_a_part(repeated):
    noise, shape = known_noise(repeated), (6, 2, 51)
    angle = 2.0 * np.pi * np.linspace(0.0, 1.0, 51)
    waves = np.stack([np.cos(turn * angle + phase) for turn in range(5) for phase in (0.0, 1.5)], axis=-1)
    slopes = np.concatenate([waves[None, None] * np.array([[1.0], [s]])[None, :, None] for s in (-1, 1)], -1)
    slopes = np.broadcast_to(slopes, (*shape, 20)) * np.repeat([1.0, 1.3], 3)[:, None, None, None]
    flat = slopes.reshape(-1, 20)
    gain = np.linalg.inv(flat.T @ flat + 1e-6 * np.eye(20))
    before, after, independent = [], [], []
    for seed in range(20):
        whole = noise.draw(np.random.default_rng(seed))
        left = (whole.ravel() - flat @ (gain @ (flat.T @ whole.ravel()))).reshape(shape)
        found = residual_noise(left, np.repeat([0.8, 1.2], 3), slopes, gain)
        before.append(np.sqrt((left**2).mean(axis=(0, 2))))
        after.append(found.deviation)
        independent.append(found.independent)
    assert (np.mean(before, axis=0) < 0.96 * noise.deviation).all()
    np.testing.assert_allclose(np.mean(after, axis=0), noise.deviation, rtol=0.15)
    assert np.mean(independent) == pytest.approx(noise.independent, rel=0.35)
    assert noise.independent < 0.35 * 6 * 2 * 51


# ---- A problem with an exact solution


class Line(AbstractCalibration):
    """Problem with bounds alone; the other parts of the posterior are set explicitly."""

    limits: tuple
    ends: np.ndarray

    @property
    def lower(self):
        return self.ends[0]

    @property
    def upper(self):
        return self.ends[1]

    @property
    def initial(self):
        raise NotImplementedError

    def with_limits(self, limits):
        return self

    def excess(self, variables):
        return ()

    def residuals(self, variables):
        raise NotImplementedError

    def linearize(self, variables):
        raise NotImplementedError

    def parameters(self, variables):
        raise NotImplementedError

    def start(self, parameters):
        raise NotImplementedError


def exact_case(lower: float, at: float, gradient: float) -> tuple[Posterior, np.ndarray]:
    """Build a posterior of two variables with white noise and precision ``information * (data + prior)``."""
    data, prior = np.array([[4.0, 3.0], [3.0, 4.0]]), np.diag([1.0, 0.5])
    problem = Line(limits=(), ends=np.array([[lower, -np.inf], [np.inf, np.inf]]))
    state = SOLVER.solve(linear_objective(0), np.ones(3)).state
    state = replace(state, variables=jnp.array([at, 2.0]))
    distribution = Posterior(
        problem=problem,
        state=state,
        noise=(),
        modelled=(),
        information=10.0,
        prior_information=10.0,
        curvature=data + prior,
        remainder=np.zeros((2, 2)),
        prior_curvature=prior,
        gradient=np.array([gradient, 0.0]),
        prior_gradient=np.zeros(2),
        moment_gradient=np.zeros(2),
        gradient_noise=data / 10.0,
    )
    return distribution, 10.0 * (data + prior)


def test_deviations_of_a_linear_problem_are_exact():
    free, precision = exact_case(-np.inf, 1.0, 0.0)
    expected = np.sqrt(np.diagonal(np.linalg.inv(precision)))
    np.testing.assert_allclose(free.deviation(), expected, rtol=1e-6)
    bounded, precision = exact_case(1.0, 1.0, 3.0)
    np.testing.assert_allclose(bounded.deviation(), [np.nan, precision[1, 1] ** -0.5], rtol=1e-6)


def test_a_solution_moves_by_the_full_hessian():
    """Second derivatives of the residuals count, unless with them the curvature is negative somewhere."""
    distribution, _ = exact_case(-np.inf, 1.0, 0.0)
    change = np.array([[1.0], [-2.0]])
    bent = replace(distribution, remainder=np.array([[1.0, 0.5], [0.5, -1.0]]))
    expected = -np.linalg.solve(bent.curvature + bent.remainder, change)
    np.testing.assert_allclose(bent.step(change), expected, rtol=1e-6)
    saddle = replace(distribution, remainder=-20.0 * np.eye(2))
    np.testing.assert_allclose(saddle.step(change), -np.linalg.solve(saddle.curvature, change), rtol=1e-6)
    bounded, _ = exact_case(1.0, 1.0, 3.0)
    assert bounded.step(change)[0] == 0.0


def test_laplace_draws_of_a_linear_problem_are_exact():
    distribution, precision = exact_case(-np.inf, 1.0, 0.0)
    draws = distribution.laplace(20_000, seed=0)
    # The small curvature for variables without bounds is negligible.
    np.testing.assert_allclose(np.cov(draws.T), np.linalg.inv(precision), rtol=0.05)
    np.testing.assert_allclose(draws.mean(axis=0), [1.0, 2.0], atol=0.01)


def test_variable_at_a_bound_has_a_one_sided_distribution():
    distribution, precision = exact_case(1.0, 1.0, 0.4)
    draws = distribution.laplace(20_000, seed=0)
    assert (draws[:, 0] >= 1.0).all()
    # The precision of its marginal is that of the profile over the other variable.
    profile = precision[0, 0] - precision[0, 1] ** 2 / precision[1, 1]
    center, width = 1.0 - 10.0 * 0.4 / profile, profile**-0.5
    exact = scipy.stats.truncnorm((1.0 - center) / width, np.inf, loc=center, scale=width)
    np.testing.assert_allclose(
        np.percentile(draws[:, 0], [10, 50, 90]) - 1.0, exact.ppf([0.1, 0.5, 0.9]) - 1.0, rtol=0.12
    )
    spread = summarize_draws(
        draws, 3.0 * draws, np.array([1.0, 2.0]), distribution.at_bound, ("a.x", "b.x"), ("1", "1")
    )
    assert spread.low[0] == 1.0 and spread.high[0] == pytest.approx(exact.ppf(0.9), rel=0.02)
    assert spread.low[1] < 2.0 < spread.high[1]


def test_variables_that_moments_do_not_determine_are_reported():
    generator = np.random.default_rng(5)
    prior = generator.normal(size=(4000, 2))
    draws = prior * np.array([0.3, 0.95])
    spread = summarize_draws(draws, prior, np.zeros(2), np.zeros(2, dtype=int), ("a.x", "b.x"), ("1", "1"))
    assert spread.identified.tolist() == [True, False]


# ---- A linear model: maximum isometric forces alone are free


@functools.cache
def noiseless() -> Objective:
    """Objective whose moments are linear in the maximum isometric forces."""
    recording, base = small_recording(0), small_parameters()
    strength = np.asarray(base.max_isometric_force)
    freed = FreedParameter(
        "max_isometric_force", 0.0 * strength, 10.0 * strength, strength, strength, 0.3 * strength
    )
    curves = HILL_CURVES["paper"]
    return Objective(
        curves=curves,
        recording=recording,
        measured=eqx.filter_jit(joint_moments)(curves, base, recording),
        variables=free_variables(base, Freedom("strength", (freed,)), MUSCLES),
        penalties=(),
        limits=(),
    )


@eqx.filter_jit
def moments_of(problem: Objective, variables):
    return joint_moments(problem.curves, problem.parameters(variables), problem.recording)


def linear_objective(seed: int, noise: float = 2.0, true=(1.0, 1.0, 1.0)) -> Objective:
    """Add noise, smooth over a cycle and independent between cycles, to the true moments."""
    generator = np.random.default_rng(seed)
    waves = generator.normal(size=(2, 2, 7)) * noise * np.sqrt(2.0 / 7.0)
    phases = 2.0 * np.pi * np.arange(21) / 21
    turns = np.stack([np.cos(turn * phases + 0.5 * np.pi * side) for turn in (1, 2, 3) for side in (0, 1)])
    turns = np.concatenate([np.full((1, 21), 0.5**0.5), turns])
    problem = noiseless()
    return replace(problem, measured=moments_of(problem, jnp.asarray(true)) + jnp.asarray(waves @ turns))


@pytest.fixture(scope="module")
def distribution():
    problem = linear_objective(1)
    solution = SOLVER.solve(problem, problem.start(problem.initial))
    assert solution.status.converged
    return posterior(solution.problem, solution.state, SPEEDS)


def test_intervals_cover_true_values_in_nine_of_ten_cases():
    """Subjects are drawn from the prior with independent noise; 24 give the coverage to about 4 %."""
    people = 1.0 + 0.3 * np.random.default_rng(7).standard_normal((24, 3))
    held = []
    for seed, true in enumerate(people):
        problem = linear_objective(seed, true=tuple(true))
        solution = SOLVER.solve(problem, problem.start(problem.initial))
        draws = posterior(solution.problem, solution.state, SPEEDS).laplace(400, seed=seed)
        low, high = np.percentile(draws, [5.0, 95.0], axis=0)
        held.append((low <= true) & (high >= true))
    assert 0.8 <= np.mean(held) <= 0.99


def test_laplace_and_bootstrap_agree_where_the_model_is_linear(distribution):
    """Within a fifth: the standard error of a deviation from 200 draws is 5 %, and that of the noise adds."""
    drawn, statuses = randomized_refits(distribution, SOLVER, 200, seed=0)
    assert all(status.converged for status in statuses)
    straight = distribution.laplace(4000, seed=0)
    np.testing.assert_allclose(drawn.std(axis=0), straight.std(axis=0), rtol=0.2)
    off = (drawn.mean(axis=0) - distribution.solution) / straight.std(axis=0)
    assert np.abs(off).max() < 0.25  # made-up moments are about the solution, pulled nowhere
    np.testing.assert_allclose(np.corrcoef(drawn.T), np.corrcoef(straight.T), atol=0.2)


def test_refits_reuse_compiled_functions(distribution):
    randomized_refits(distribution, SOLVER, 1, seed=0)
    compiled = []

    def note(event, seconds, **details):
        if "jaxpr_to_mlir_module" in event:
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        randomized_refits(distribution, SOLVER, 3, seed=1)
    finally:
        jax.monitoring.unregister_event_duration_listener(note)
    assert compiled == []


def test_finished_draws_are_not_repeated(distribution, tmp_path):
    class NoWork(AugmentedLagrangian):
        def solve(self, *arguments):
            raise AssertionError("a draw was done again")

    checkpoints = Checkpoints.open(tmp_path / "book", "question", resume=False)
    done, _ = randomized_refits(distribution, SOLVER, 3, seed=0, checkpoints=checkpoints)
    again, statuses = randomized_refits(distribution, NoWork(), 3, seed=0, checkpoints=checkpoints)
    np.testing.assert_array_equal(again, done)
    assert len(statuses) == 3
    few, _ = randomized_refits(distribution, SOLVER, 2, seed=0)
    np.testing.assert_array_equal(few, done[:2])
