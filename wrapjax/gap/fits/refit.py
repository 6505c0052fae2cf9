"""Calibrated parameters and amounts of effects, fitted together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.calibrate import (
    MOMENT_ERROR,
    AbstractLeastSquares,
    Linearization,
    Objective,
    ProjectedLM,
    Status,
)
from wrapjax.gap.effect import Effects, Form, split_amounts
from wrapjax.gap.prediction import signatures

#: Solver of every refit. Amounts and predictions are looked at to a few digits, and starts are near.
SOLVER = ProjectedLM(gtol=1e-3, ftol=1e-5, max_iterations=40)


class JointProblem(AbstractLeastSquares):
    """A calibration whose variables are followed by amounts of effects, in prior standard deviations.

    Its gradient is exact. Of the second derivatives those by amounts are taken from slopes of the moments
    that were computed once: amounts are few and small, and steps stay good.
    """

    #: Without any effect, and with held paths.
    plain: Objective
    #: Of the effects. What is compiled knows neither names nor sizes: other parts of an effect then share it.
    forms: tuple[Form, ...]
    #: How many amounts each has.
    counts: tuple[int, ...] = eqx.field(static=True)
    #: Their prior standard deviations, and between how many of these they are, one row an end.
    amount_sd: Float[Array, " amount"]
    amount_bounds: Float[Array, "end amount"]
    #: What one squared prior standard deviation of an amount costs.
    amount_weight: Float[Array, ""]
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

    def amounts(self, variables: Float[Array, " variable"]) -> Float[Array, " amount"]:
        """Read the amounts, in their units."""
        return variables[self.plain.variables.count :] * self.amount_sd

    def altered(self, variables: Float[Array, " variable"]) -> Objective:
        """Hold the amounts, as they are, in the plain problem."""
        return self._with(self.amounts(variables))

    def _with(self, amounts: Float[Array, " amount"]) -> Objective:
        own = split_amounts(amounts, self.counts)
        alterations = tuple(form(part) for form, part in zip(self.forms, own, strict=True))
        return replace(self.plain, alterations=alterations)

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of squares, the amounts' own too."""
        count = self.plain.variables.count
        own = self.amount_weight * jnp.sum(variables[count:] ** 2)
        return self.altered(variables).value(variables[:count]) + own

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Cost and gradient, and the second derivatives as above."""
        count = self.plain.variables.count
        problem, calibrated, unit = self.altered(variables), variables[:count], variables[count:]
        own = problem.linearize(calibrated)
        if not self.counts:
            return own

        def of_amounts(unit: Float[Array, " amount"]) -> Float[Array, ""]:
            return self._with(unit * self.amount_sd).value(calibrated)

        rows = self.slopes * problem.row_scale()[None]
        across = rows @ problem.moment_jacobian(calibrated)
        corner = rows @ rows.T + self.amount_weight * jnp.eye(len(unit))
        return Linearization(
            cost=own.cost + self.amount_weight * jnp.sum(unit**2),
            gradient=jnp.concatenate(
                [own.gradient, 0.5 * jax.grad(of_amounts)(unit) + self.amount_weight * unit]
            ),
            gauss_newton=jnp.block([[own.gauss_newton, across.T], [across, corner]]),
            remainder=jnp.pad(own.remainder, (0, len(unit))),
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
    def amounts(self) -> Float[np.ndarray, " amount"]:
        """Of the effects, in their units."""
        return np.asarray(self.problem.amounts(jnp.asarray(self.variables)))


def joint_problem(
    plain: Objective,
    effects: Effects,
    calibrated: Float[np.ndarray, " variable"],
    amounts: Float[np.ndarray, " amount"],
    amount_weight: float,
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
        found = signatures(plain.curves, parameters, plain.recording, effects, jnp.asarray(amounts))
        slopes = found.reshape(effects.count, -1) * effects.prior_sd[:, None]
    else:
        slopes = jnp.zeros((0, plain.measured.size))
    return JointProblem(
        plain=plain,
        forms=effects.forms,
        counts=effects.counts,
        amount_sd=jnp.asarray(effects.prior_sd),
        amount_bounds=jnp.asarray(np.stack([effects.lower, effects.upper]) / effects.prior_sd),
        amount_weight=jnp.asarray(amount_weight),
        slopes=slopes,
    )


def fit_jointly(
    problem: JointProblem,
    start: Float[np.ndarray, " variable"],
    used: Bool[np.ndarray, " trial"] | None = None,
    solver: ProjectedLM = SOLVER,
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
    """
    own = replace(problem, plain=replace(problem.plain, moment_error=allowed_errors(problem.plain, used)))
    solution = solver.solve(own, start)
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
