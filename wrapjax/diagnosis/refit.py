"""Calibrated parameters and amounts of effects, fitted together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.calibration.objective import MOMENT_ERROR, Objective
from wrapjax.calibration.solvers.checkpoints import SolveCache, solve_fingerprint
from wrapjax.calibration.solvers.interface import AbstractLeastSquares, Linearization, Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.diagnosis.effects.effect import Effects, split_effect_sizes
from wrapjax.diagnosis.prediction import EffectSizes, Forms, carry_out, signatures
from wrapjax.model.forward import Recording
from wrapjax.model.parameters import ModelParameters

#: Solver of every refit. Amounts and predictions are looked at to a few digits, and starts are near.
SOLVER = ProjectedLevenbergMarquardt(gtol=1e-3, ftol=1e-5, max_iterations=40)


class JointProblem(AbstractLeastSquares):
    """A calibration whose variables are followed by amounts of effects, in prior standard deviations.

    Its gradient is exact. Of the second derivatives those by amounts are taken from slopes of the moments
    that were computed once: amounts are few and small, and steps stay good.
    """

    #: Without any effect, and with held paths.
    plain: Objective
    #: Of the effects. What is compiled knows neither names nor sizes: other parts of an effect then share it.
    forms: Forms
    #: How many amounts each has.
    counts: tuple[int, ...] = eqx.field(static=True)
    #: Their prior standard deviations, and between how many of these they are, one row an end.
    amount_sd: Float[Array, " amount"]
    amount_bounds: Float[Array, "end amount"]
    #: What one squared prior standard deviation of an amount costs.
    effect_size_weight: Float[Array, ""]
    #: Of the predicted moments by amounts in prior standard deviations, N m.
    slopes: Float[Array, "amount row"]

    @property
    def lower(self) -> Float[Array | np.ndarray, " variable"]:
        """Lower bounds."""
        return np.concatenate([self.plain.lower, self.amount_bounds[0]])

    @property
    def upper(self) -> Float[Array | np.ndarray, " variable"]:
        """Upper bounds."""
        return np.concatenate([self.plain.upper, self.amount_bounds[1]])

    def effect_sizes(self, variables: Float[Array, " variable"]) -> Float[Array, " amount"]:
        """Read the amounts, in their units."""
        return variables[self.plain.variables.count :] * self.amount_sd

    def altered(self, variables: Float[Array, " variable"]) -> Objective:
        """Hold the amounts, as they are, in the plain problem."""
        recording, alterations = carry_out(*self._plain_inputs, self.forms, self._own_amounts(variables))
        return replace(self.plain, recording=recording, alterations=alterations)

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of squares, the amounts' own too."""
        count = self.plain.variables.count
        own = self.effect_size_weight * jnp.sum(variables[count:] ** 2)
        return self.altered(variables).value_at(variables[:count]) + own

    def value_at(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """See `linearized_at`."""
        return self.value(variables)

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Cost and gradient, and the second derivatives as above."""
        count = self.plain.variables.count
        model, slopes, by_input = _expand(self.altered(variables), variables[:count])
        if not self.counts:
            return model
        by_amount = _pulled_back(*self._plain_inputs, self.forms, self._own_amounts(variables), by_input)
        return _joined(
            model,
            slopes,
            by_amount * self.amount_sd,
            self.slopes * self.plain.row_scale()[None],
            variables[count:],
            self.effect_size_weight,
        )

    def linearized_at(self, variables: Float[Array, " variable"]) -> Linearization:
        """Call each program in its turn: of several effects, most then share the one that takes long."""
        return self.linearize(variables)

    @property
    def _plain_inputs(self) -> tuple[Recording, ModelParameters]:
        return self.plain.recording, self.plain.initial

    def _own_amounts(self, variables: Float[Array, " variable"]) -> EffectSizes:
        return split_effect_sizes(self.effect_sizes(variables), self.counts)


@eqx.filter_jit
def _expand(
    problem: Objective, calibrated: Float[Array, " variable"]
) -> tuple[Linearization, Float[Array, "row variable"], Any]:
    """Expand a calibration; give its moments' slopes, and half its cost's by each number that alters it."""
    inputs = (problem.recording, problem.alterations)
    numbers, rest = eqx.partition(inputs, eqx.is_inexact_array)

    def half(numbers: Any) -> Float[Array, ""]:
        recording, alterations = eqx.combine(numbers, rest)
        return 0.5 * replace(problem, recording=recording, alterations=alterations).value(calibrated)

    return *problem.expand(calibrated), jax.grad(half)(numbers)


@eqx.filter_jit
def _pulled_back(
    recording: Recording, parameters: ModelParameters, forms: Forms, effect_sizes: EffectSizes, by_input: Any
) -> Float[Array, " amount"]:
    """Slope by each amount, from slopes by what the amounts alter."""

    def numbers(effect_sizes: EffectSizes) -> Any:
        return eqx.filter(carry_out(recording, parameters, forms, effect_sizes), eqx.is_inexact_array)

    return jnp.concatenate(jax.vjp(numbers, effect_sizes)[1](by_input)[0])


@jax.jit
def _joined(
    model: Linearization,
    by_calibrated: Float[Array, "row variable"],
    gradient: Float[Array, " amount"],
    by_amounts: Float[Array, "amount row"],
    effect_sizes: Float[Array, " amount"],
    weight: Float[Array, ""],
) -> Linearization:
    """Put amounts, which have a cost of their own, after what is calibrated."""
    across = by_amounts @ by_calibrated
    corner = by_amounts @ by_amounts.T + weight * jnp.eye(len(effect_sizes))
    return Linearization(
        cost=model.cost + weight * jnp.sum(effect_sizes**2),
        gradient=jnp.concatenate([model.gradient, gradient + weight * effect_sizes]),
        gauss_newton=jnp.block([[model.gauss_newton, across.T], [across, corner]]),
        remainder=jnp.pad(model.remainder, (0, len(effect_sizes))),
    )


@dataclass(frozen=True)
class Refit:
    """Where a joint fit ended.

    Parameters
    ----------
    problem
        What was solved.
    variables
        Calibrated ones, then amounts in prior standard deviations.
    cost
        Sum of squares there.
    model
        And its expansion.
    status
        Why it stopped.
    """

    problem: JointProblem
    variables: Float[np.ndarray, " variable"]
    cost: float
    model: Linearization
    status: Status

    @property
    def calibrated(self) -> Float[np.ndarray, " variable"]:
        """Calibrated variables alone."""
        return self.variables[: self.problem.plain.variables.count]

    @property
    def effect_sizes(self) -> Float[np.ndarray, " amount"]:
        """Of the effects, in their units."""
        return np.asarray(self.problem.effect_sizes(jnp.asarray(self.variables)))


def joint_problem(
    plain: Objective,
    effects: Effects,
    calibrated: Float[np.ndarray, " variable"],
    effect_sizes: Float[np.ndarray, " amount"],
    effect_size_weight: float,
) -> JointProblem:
    """Draw the slopes by amounts where a refit will start.

    Parameters
    ----------
    plain
        The calibration, over all cycles that any fit may see.
    effects
        At least one, or none for a refit of the plain model with the same effort.
    calibrated, amounts
        Where slopes are drawn.
    amount_weight
        What one squared prior standard deviation of an amount costs.
    """
    parameters = plain.parameters(jnp.asarray(calibrated))
    if effects.count:
        found = signatures(plain.curves, parameters, plain.recording, effects, jnp.asarray(effect_sizes))
        slopes = jnp.asarray(found.reshape(effects.count, -1) * effects.prior_sd[:, None])
    else:
        slopes = jnp.zeros((0, plain.measured.size))
    return JointProblem(
        plain=plain,
        forms=effects.forms,
        counts=effects.counts,
        amount_sd=jnp.asarray(effects.prior_sd),
        amount_bounds=jnp.asarray(np.stack([effects.lower, effects.upper]) / effects.prior_sd),
        effect_size_weight=jnp.asarray(effect_size_weight),
        slopes=slopes,
    )


def fit_jointly(
    problem: JointProblem,
    start: Float[np.ndarray, " variable"],
    used: Bool[np.ndarray, " trial"] | None = None,
    solver: ProjectedLevenbergMarquardt = SOLVER,
    kept: SolveCache | None = None,
) -> Refit:
    """Fit calibrated parameters and amounts together.

    Parameters
    ----------
    problem
        From `joint_problem`.
    start
        Variables.
    used
        Cycles whose moments count; all if not given. Their EMG and angles are looked at either way.
    solver
        With its tolerances.
    kept
        Fits that were done before; what is among them is not done again.

    Raises
    ------
    KeyboardInterrupt
        If the user stops it: nothing may be concluded from half a fit.
    """
    own = replace(problem, plain=replace(problem.plain, moment_error=allowed_errors(problem.plain, used)))
    name = solve_fingerprint(own, start, solver) if kept else ""
    known = kept.read(name) if kept else None
    if known is not None:
        variables, status = known
        model = own.linearized_at(jnp.asarray(variables))
        return Refit(own, variables, float(model.cost), model, status)
    solution = solver.solve(own, start)
    if solution.status is Status.interrupted:
        raise KeyboardInterrupt
    if kept:
        kept.write(name, solution.variables, solution.status)
    return Refit(own, solution.variables, solution.cost, solution.linearization, solution.status)


def allowed_errors(
    plain: Objective, used: Bool[np.ndarray, " trial"] | None
) -> Float[np.ndarray, "trial one one"]:
    """Allow any error in cycles that do not count; the others then weigh what all did."""
    chosen = np.ones(plain.measured.shape[0], dtype=bool) if used is None else np.asarray(used)
    if not chosen.any():
        raise ValueError("a fit needs at least one cycle")
    error = MOMENT_ERROR * np.sqrt(chosen.mean())
    return np.where(chosen, error, np.inf)[:, None, None]
