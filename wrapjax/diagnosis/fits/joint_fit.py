"""Joint bounded least squares over calibrated parameters and effect sizes, on all or some of the cycles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.calibration.objective import MOMENT_ERROR, Objective
from wrapjax.calibration.solvers.checkpoints import solve_fingerprint
from wrapjax.calibration.solvers.interface import AbstractLeastSquares, Linearization, Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.diagnosis.effects.effect import Effects, split_effect_sizes
from wrapjax.diagnosis.fits.prediction import AlterationFunctions, SizesByEffect, altered_inputs, signatures
from wrapjax.io.store import Store
from wrapjax.model.forward import Recording
from wrapjax.model.parameters import ModelParameters

#: Solver of every joint fit. A few digits of effect sizes and moments are needed, and starts are close.
SOLVER = ProjectedLevenbergMarquardt(gtol=1e-3, ftol=1e-5, max_iterations=40)


class JointProblem(AbstractLeastSquares):
    """A calibration whose variables are followed by effect sizes, in prior standard deviations.

    The gradient is exact. The second derivatives by effect sizes use derivatives of the moments that are
    computed once: effect sizes are few and small, so that steps stay good.
    """

    #: Calibration without any effect, with held paths.
    plain: Objective
    #: Changes of the forward model by the effects. The compiled program depends neither on names nor on the
    #: number of priors, so that other parts of an effect share it.
    alteration_functions: AlterationFunctions
    #: Number of parameters of each effect.
    counts: tuple[int, ...] = eqx.field(static=True)
    #: Prior standard deviations of the effect sizes; and bounds in these units, lower and upper.
    effect_size_sd: Float[Array, " effect_size"]
    effect_size_bounds: Float[Array, "bound effect_size"]
    #: Cost of a squared effect size of one prior standard deviation.
    effect_size_weight: Float[Array, ""]
    #: Derivatives of the predicted moments by effect sizes in prior standard deviations, N m.
    slopes: Float[Array, "effect_size row"]

    @property
    def lower(self) -> Float[Array | np.ndarray, " variable"]:
        """Lower bounds."""
        return np.concatenate([self.plain.lower, self.effect_size_bounds[0]])

    @property
    def upper(self) -> Float[Array | np.ndarray, " variable"]:
        """Upper bounds."""
        return np.concatenate([self.plain.upper, self.effect_size_bounds[1]])

    def effect_sizes(self, variables: Float[Array, " variable"]) -> Float[Array, " effect_size"]:
        """Return the effect sizes in physical units."""
        return variables[self.plain.variables.count :] * self.effect_size_sd

    def altered(self, variables: Float[Array, " variable"]) -> Objective:
        """Return the calibration with the effects fixed at their present sizes."""
        recording, alterations = altered_inputs(
            *self._plain_inputs, self.alteration_functions, self._sizes_by_effect(variables)
        )
        return replace(self.plain, recording=recording, alterations=alterations)

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of squares, including the prior of the effect sizes."""
        count = self.plain.variables.count
        prior = self.effect_size_weight * jnp.sum(variables[count:] ** 2)
        return self.altered(variables).value_at(variables[:count]) + prior

    def value_at(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of squares; see `linearized_at`."""
        return self.value(variables)

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Cost, gradient, and approximate second derivatives; see the class."""
        count = self.plain.variables.count
        model, slopes, by_input = _expand(self.altered(variables), variables[:count])
        if not self.counts:
            return model
        gradient = _pull_back(
            *self._plain_inputs, self.alteration_functions, self._sizes_by_effect(variables), by_input
        )
        return _join(
            model,
            slopes,
            gradient * self.effect_size_sd,
            self.slopes * self.plain.row_scale()[None],
            variables[count:],
            self.effect_size_weight,
        )

    def linearized_at(self, variables: Float[Array, " variable"]) -> Linearization:
        """Call each compiled program in turn: effects then share the one that takes longest to compile."""
        return self.linearize(variables)

    @property
    def _plain_inputs(self) -> tuple[Recording, ModelParameters]:
        return self.plain.recording, self.plain.initial

    def _sizes_by_effect(self, variables: Float[Array, " variable"]) -> SizesByEffect:
        return split_effect_sizes(self.effect_sizes(variables), self.counts)


@eqx.filter_jit
def _expand(
    problem: Objective, calibrated: Float[Array, " variable"]
) -> tuple[Linearization, Float[Array, "row variable"], Any]:
    """Expand a calibration.

    Returns
    -------
    model, slopes, by_input
        Expansion of the cost, derivatives of the scaled moments by the variables, and derivative of half the
        cost by each number among the inputs of the forward model.
    """
    inputs = (problem.recording, problem.alterations)
    numbers, rest = eqx.partition(inputs, eqx.is_inexact_array)

    def half(numbers: Any) -> Float[Array, ""]:
        recording, alterations = eqx.combine(numbers, rest)
        return 0.5 * replace(problem, recording=recording, alterations=alterations).value(calibrated)

    return *problem.expand(calibrated), jax.grad(half)(numbers)


@eqx.filter_jit
def _pull_back(
    recording: Recording,
    parameters: ModelParameters,
    alteration_functions: AlterationFunctions,
    effect_sizes: SizesByEffect,
    by_input: Any,
) -> Float[Array, " effect_size"]:
    """Compute the derivative by each effect size from derivatives by the inputs of the forward model."""

    def numbers(effect_sizes: SizesByEffect) -> Any:
        inputs = altered_inputs(recording, parameters, alteration_functions, effect_sizes)
        return eqx.filter(inputs, eqx.is_inexact_array)

    return jnp.concatenate(jax.vjp(numbers, effect_sizes)[1](by_input)[0])


@jax.jit
def _join(
    model: Linearization,
    by_calibrated: Float[Array, "row variable"],
    gradient: Float[Array, " effect_size"],
    by_effect_size: Float[Array, "effect_size row"],
    effect_sizes: Float[Array, " effect_size"],
    weight: Float[Array, ""],
) -> Linearization:
    """Append effect sizes, with their prior, to the expansion by calibrated variables."""
    across = by_effect_size @ by_calibrated
    corner = by_effect_size @ by_effect_size.T + weight * jnp.eye(len(effect_sizes))
    return Linearization(
        cost=model.cost + weight * jnp.sum(effect_sizes**2),
        gradient=jnp.concatenate([model.gradient, gradient + weight * effect_sizes]),
        gauss_newton=jnp.block([[model.gauss_newton, across.T], [across, corner]]),
        remainder=jnp.pad(model.remainder, (0, len(effect_sizes))),
    )


@dataclass(frozen=True)
class JointFit:
    """Solution of a joint problem.

    Parameters
    ----------
    problem
        Problem that was solved.
    variables
        Calibrated variables, then effect sizes in prior standard deviations.
    cost
        Sum of squares at the solution.
    model
        Expansion of the cost at the solution.
    status
        Reason why the solver stopped.
    """

    problem: JointProblem
    variables: Float[np.ndarray, " variable"]
    cost: float
    model: Linearization
    status: Status

    @property
    def calibrated(self) -> Float[np.ndarray, " variable"]:
        """Calibrated variables, without effect sizes."""
        return self.variables[: self.problem.plain.variables.count]

    @property
    def effect_sizes(self) -> Float[np.ndarray, " effect_size"]:
        """Effect sizes in physical units."""
        return np.asarray(self.problem.effect_sizes(jnp.asarray(self.variables)))


def joint_problem(
    plain: Objective,
    effects: Effects,
    calibrated: Float[np.ndarray, " variable"],
    effect_sizes: Float[np.ndarray, " effect_size"],
    effect_size_weight: float,
) -> JointProblem:
    """Set up a joint fit; compute derivatives of the moments by effect sizes near where it will start.

    Parameters
    ----------
    plain
        Calibration over all cycles that any fit may use.
    effects
        Effects to fit; none for a fit of the plain model by the same solver.
    calibrated, effect_sizes
        Calibrated variables and effect sizes (physical units) at which derivatives are computed.
    effect_size_weight
        Cost of a squared effect size of one prior standard deviation.
    """
    parameters = plain.parameters(jnp.asarray(calibrated))
    if effects.count:
        by_size = signatures(plain.curves, parameters, plain.recording, effects, jnp.asarray(effect_sizes))
        slopes = jnp.asarray(by_size.reshape(effects.count, -1) * effects.prior_sd[:, None])
    else:
        slopes = jnp.zeros((0, plain.measured.size))
    return JointProblem(
        plain=plain,
        alteration_functions=effects.alteration_functions,
        counts=effects.counts,
        effect_size_sd=jnp.asarray(effects.prior_sd),
        effect_size_bounds=jnp.asarray(np.stack([effects.lower, effects.upper]) / effects.prior_sd),
        effect_size_weight=jnp.asarray(effect_size_weight),
        slopes=slopes,
    )


def fit_jointly(
    problem: JointProblem,
    start: Float[np.ndarray, " variable"],
    used: Bool[np.ndarray, " trial"] | None = None,
    solver: ProjectedLevenbergMarquardt = SOLVER,
    cache: Store | None = None,
) -> JointFit:
    """Fit calibrated parameters and effect sizes together.

    Parameters
    ----------
    problem
        Problem from `joint_problem`.
    start
        Variables at which the solver starts.
    used
        Cycles whose moments are fitted; all if not given. Penalties use EMG and angles of all cycles.
    solver
        Solver with its tolerances.
    cache
        Earlier fits; a fit among them is read and not solved again.

    Raises
    ------
    KeyboardInterrupt
        If the solve was interrupted: an unfinished fit must not be used.
    """
    chosen = replace(problem, plain=replace(problem.plain, moment_error=allowed_errors(problem.plain, used)))
    name = solve_fingerprint(chosen, start, solver) if cache else ""
    if cache and (known := _read_solution(cache, name)):
        variables, status = known
        model = chosen.linearized_at(jnp.asarray(variables))
        return JointFit(chosen, variables, float(model.cost), model, status)
    solution = solver.solve(chosen, start)
    if solution.status is Status.interrupted:
        raise KeyboardInterrupt
    if cache:
        cache.write_arrays(name, variables=solution.variables, status=np.array(solution.status.name))
    return JointFit(chosen, solution.variables, solution.cost, solution.linearization, solution.status)


def _read_solution(cache: Store, name: str) -> tuple[Float[np.ndarray, " variable"], Status] | None:
    """Read the variables and the status of a finished solve; None if there is none."""
    arrays = cache.read_arrays(name)
    try:
        return None if arrays is None else (arrays["variables"], Status[str(arrays["status"])])
    except KeyError:
        return None


def allowed_errors(
    plain: Objective, used: Bool[np.ndarray, " trial"] | None
) -> Float[np.ndarray, "trial one one"]:
    """Return allowable moment errors (N m) of each cycle, infinite where it is not used.

    The used cycles get the weight of all, so that the balance with the penalties stays the same.

    Raises
    ------
    ValueError
        If no cycle is used.
    """
    chosen = np.ones(plain.measured.shape[0], dtype=bool) if used is None else np.asarray(used)
    if not chosen.any():
        raise ValueError("a fit needs at least one cycle")
    error = MOMENT_ERROR * np.sqrt(chosen.mean())
    return np.where(chosen, error, np.inf)[:, None, None]


def effect_size_covariance(
    fit: JointFit, effect_size_weight: float
) -> Float[np.ndarray, "effect_size effect_size"]:
    """Compute the covariance of the effect sizes by Laplace's approximation, in their units.

    Calibrated parameters are marginalised.

    Parameters
    ----------
    fit
        Joint fit.
    effect_size_weight
        Cost of a squared prior standard deviation; it converts the curvature of the cost to that of a
        negative log likelihood.
    """
    curvature = np.asarray(fit.model.gauss_newton)
    count, sd = fit.problem.plain.variables.count, np.asarray(fit.problem.effect_size_sd)
    calibrated = curvature[:count, :count] + 1e-9 * np.trace(curvature) / len(curvature) * np.eye(count)
    across = curvature[:count, count:]
    marginal = curvature[count:, count:] - across.T @ np.linalg.solve(calibrated, across)
    # A fit to some cycles gives them the weight of all, and they hold less information.
    used = np.mean(np.isfinite(fit.problem.plain.moment_error))
    scaled = effect_size_weight / used * np.linalg.inv(0.5 * (marginal + marginal.T))
    return scaled * np.outer(sd, sd)
