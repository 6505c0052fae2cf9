"""Calibration to recorded walking: errors of moments and paths, and optimality."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import OptimizeResult, least_squares

from wrapjax.calibration.calibration import calibrate
from wrapjax.calibration.problem import build_objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.model.freedom import nga_freedom
from wrapjax.path_sources.model_inputs import model_parameters
from wrapjax.path_sources.path_fitting import fit
from wrapjax.subject.subject import load_subject as load_subject

DELAY = ("electromechanical_delay",)
ACTIVATION = ("activation_time_constant", "activation_nonlinearity")
SCALE = ("emg_scale",)
FIBER_LENGTH = ("optimal_fiber_length",)
SLACK_LENGTH = ("tendon_slack_length",)

#: Largest root mean square error of a moment arm, mm. The first two lift on and off their cylinder; of the
#: others OpenSim's moment arms are not the derivatives of its lengths, and their errors are only reported.
MOMENT_ARM_LIMITS = {"glmax1_l": 0.7, "glmax2_l": 0.7, "gaslat_l": np.inf, "gasmed_l": np.inf}


@pytest.fixture(scope="session")
def subject(s1_left):
    return load_subject(s1_left)


@pytest.fixture(scope="session")
def paths(subject):
    return fit(subject, processes=2)


def calibration_mae(calibration) -> float:
    result = calibration.result
    rows = np.array(result.uses) == "calibration"
    return float(np.abs(result.modelled - result.measured)[rows].mean())


@pytest.mark.slow  # the next test is quicker and defends the same but for one prior
def test_moment_error_with_the_terms_of_the_nmsm_pipeline(subject, paths):
    """Without a prior on delays, as in the published cost."""
    freedom = nga_freedom(model_parameters(subject), delay_sd=np.inf)
    calibration = calibrate(subject, fit=paths, freedom=freedom, starts=1)
    assert calibration.status.converged, calibration.status.value
    assert calibration_mae(calibration) <= 6.75


def test_moment_error_with_a_prior_on_delays(subject, paths):
    calibration = calibrate(subject, fit=paths, starts=1)
    assert calibration.status.converged, calibration.status.value
    assert calibration_mae(calibration) <= 6.9
    assert calibration.result.n_residuals == 3636
    assert len(calibration.result.solution.variables) == 204


def test_path_errors_in_validation_poses(subject, paths):
    """Errors of every muscle, pooled over its coordinates."""
    assert set(paths.errors) == set(subject.muscles.names)
    judged = {name: error for name, error in paths.errors.items() if not name.startswith("gas")}
    length = {name: error.length_rmse_mm for name, error in judged.items()}
    assert max(length.values()) <= 0.1, length
    arm = {name: error.moment_arm_rmse_mm for name, error in judged.items()}
    assert not {name: error for name, error in arm.items() if error > MOMENT_ARM_LIMITS.get(name, 0.4)}


@pytest.fixture(scope="module")
def reduced(subject, paths):
    """Build problems of one slow and one fast cycle in which only the named parameters are free."""
    cycles = dataclasses.replace(subject, trials=subject.trials.used_for("calibration").select([0, 3]))
    everything = nga_freedom(model_parameters(cycles))

    def make(names):
        held = [parameter.name for parameter in everything.parameters if parameter.name not in names]
        return build_objective(cycles, fit=paths, freedom=everything.without(held))

    return make


def test_optimum_is_that_of_scipy(reduced):
    """EMG scales alone have one minimum, a third of them at bounds: both find it from the same start."""
    problem = reduced(SCALE)
    ours = ProjectedLevenbergMarquardt().solve(problem, problem.variables.start())
    theirs = scipy_trf(problem, problem.variables.start())
    assert theirs.success, theirs.message
    np.testing.assert_allclose(ours.cost, 2.0 * theirs.cost, rtol=1e-6)


@pytest.mark.slow  # each kind of parameter is a program of its own
@pytest.mark.parametrize(
    "names",
    [
        DELAY,
        FIBER_LENGTH,
        (*SCALE, *FIBER_LENGTH, *SLACK_LENGTH),
        (*DELAY, *ACTIVATION),
    ],
    ids="+".join,
)
def test_neither_solver_improves_the_solution_of_the_other(reduced, names):
    """These have several minima, and which one a solver meets from a given start is luck.

    So each starts where the other ended: SciPy finds nothing lower than our optimum, and we, after
    SciPy's first evaluations (it creeps along bounds), end no higher than it did.
    """
    problem = reduced(names)
    solver = ProjectedLevenbergMarquardt()
    ours = solver.solve(problem, problem.variables.start())
    assert projected_gradient(problem, ours.variables) < 1e-6
    after_ours = scipy_trf(problem, ours.variables)
    assert after_ours.success, after_ours.message
    np.testing.assert_allclose(2.0 * after_ours.cost, ours.cost, rtol=1e-6)
    theirs = scipy_trf(problem, problem.variables.start(), evaluations=30)
    after_theirs = solver.solve(problem, theirs.x)
    assert after_theirs.cost <= 2.0 * theirs.cost * (1.0 + 1e-6)


def scipy_trf(problem, start, evaluations: int | None = None) -> OptimizeResult:
    """Run `least_squares` on all residuals with their plain Jacobian; its cost is half the sum of squares."""
    residuals = eqx.filter_jit(lambda problem, x: problem.residuals(x))
    jacobian = eqx.filter_jit(jax.jacfwd(lambda problem, x: problem.residuals(x), argnums=1))
    return least_squares(
        lambda x: np.asarray(residuals(problem, x)),
        np.asarray(start),
        jac=lambda x: np.asarray(jacobian(problem, x)),
        bounds=(problem.lower, problem.upper),
        method="trf",
        x_scale="jac",
        ftol=1e-12,
        xtol=1e-10,
        gtol=1e-8,
        max_nfev=evaluations,
    )


def projected_gradient(problem, variables) -> float:
    """Compute the largest change by a projected gradient step, by reverse-mode differentiation."""
    slope = eqx.filter_jit(jax.grad(lambda x, problem: 0.5 * jnp.sum(problem.residuals(x) ** 2)))
    moved = np.clip(variables - slope(jnp.asarray(variables), problem), problem.lower, problem.upper)
    return float(np.abs(moved - variables).max())


# ---- Free paths


@pytest.fixture(scope="module")
def nga_errors(subject, paths):
    return errors_by_use(calibrate(subject, "NGA", paths, starts=1))


def errors_by_use(calibration) -> dict[str, float]:
    result = calibration.result
    error = np.abs(result.modelled - result.measured).mean(axis=(1, 2))
    uses = np.array(result.uses)
    return {use: float(error[uses == use].mean()) for use in ("calibration", "validation")}


def assert_limits_hold(calibration):
    result = calibration.result
    assert calibration.status.converged, calibration.status.value
    assert result.solution.max_violation <= 1e-6
    rows = np.array(result.uses) == "calibration"
    length = np.asarray(result.states.fiber.normalized_length)[:, rows]
    assert length.min() >= 0.3 - 1e-6 and length.max() <= 1.3 + 1e-6
    before, after = (
        np.asarray(states.path.moment_arm)[:, rows] for states in (result.initial_states, result.states)
    )
    for sign in (1.0, -1.0):
        kept = (sign * before > 0.0).all(axis=(1, 3))
        # A tenth of a micrometer: violations are counted in cm.
        assert (sign * after).min(axis=(1, 3))[kept].min() >= -1e-8


@pytest.mark.slow
def test_limits_hold_on_two_cycles(subject, paths):
    trials = subject.trials
    chosen = [trials.uses.index("calibration"), trials.uses.index("validation")]
    short = dataclasses.replace(subject, trials=trials.select(chosen))
    calibration = calibrate(short, "LSGA", paths, starts=1)
    assert_limits_hold(calibration)
    moved = np.abs(np.asarray(calibration.result.parameters.path_changes)).max(axis=1) > 0.0
    assert {name for name, own in zip(short.muscles.names, moved, strict=True) if own} == set(paths.touching)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "calibration", "validation"), [("SGA", 0.35, 0.24), ("LSGA", 0.27, 0.18)])
def test_errors_are_below_those_of_nga(subject, paths, nga_errors, method, calibration, validation):
    found = calibrate(subject, method, paths, starts=1)
    assert_limits_hold(found)
    errors = errors_by_use(found)
    assert errors["calibration"] <= (1.0 - calibration) * nga_errors["calibration"]
    assert errors["validation"] <= (1.0 - validation) * nga_errors["validation"]


def test_the_published_muscles_touch_a_wrap(paths):
    adductors = {f"add{part}_l" for part in ("brev", "long", "magDist", "magIsch", "magMid", "magProx")}
    others = {
        f"{name}_l"
        for name in ["gaslat", "gasmed", "glmax1", "glmax2", "iliacus", "psoas", "semimem", "semiten"]
    }
    assert set(paths.touching) == adductors | others
