"""Draws of a normal distribution of many variables within bounds.

A calibration's cost as a probability: how far parameters may be from where it ended.

The cost is a sum of mean squares in allowable errors, of moments and of what priors and penalties expect.
Weights of means say how calibration answers, not how much is known: of moments, residuals say that, and
their correlation; of priors and penalties, that each muscle is off by one allowable error as a rule. So the
spread is that of calibration's answer to noise and to people who differ from what priors expect (sandwich
form), and not narrower where calibration trusts a prior more than the prior deserves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.special
from jaxtyping import Array, Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.augmented_lagrangian import LagrangianState
from wrapjax.calibration.solvers.interface import AbstractCalibration
from wrapjax.calibration.two_legs import TwoLegObjective
from wrapjax.calibration.uncertainty.residual_noise import ResidualNoise, residual_noise

# Chains side by side, sweeps before the first draw is kept, and between two that are.
_CHAINS, _BURN_IN, _BETWEEN = 100, 25, 3


def draw_truncated_normal(
    mean: Float[np.ndarray, " variable"],
    covariance: Float[np.ndarray, "variable variable"],
    lower: Float[np.ndarray, " variable"],
    upper: Float[np.ndarray, " variable"],
    count: int,
    seed: int,
) -> Float[np.ndarray, "draw variable"]:
    """Draw from a normal distribution of which only what is within bounds counts.

    By Gibbs' sampler, along every variable and along the principal axes of those with bounds: the former
    leave corners quickly, the latter follow valleys. Variables without bounds follow exactly.

    Parameters
    ----------
    mean
        May lie outside the bounds.
    covariance
        Positive definite.
    lower, upper
        Infinite where there are none.
    count
        Number of draws.
    seed
        Of the draws.
    """
    generator = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance)
    free = mean + generator.standard_normal((count, len(mean))) @ root.T
    bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if not bounded.size:
        return free
    block = covariance[np.ix_(bounded, bounded)]
    box = lower[bounded], upper[bounded]
    kept = _gibbs(mean[bounded], block, *box, count, generator)
    # Others keep what they are beside what those with bounds say of them.
    follow = scipy.linalg.solve(block, covariance[bounded], assume_a="pos")
    draws = free + (kept - free[:, bounded]) @ follow
    draws[:, bounded] = kept
    return draws


def _gibbs(
    mean: np.ndarray,
    covariance: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    count: int,
    generator: np.random.Generator,
) -> Float[np.ndarray, "draw variable"]:
    precision = scipy.linalg.inv(covariance)
    axes = np.concatenate([np.eye(len(mean)), scipy.linalg.eigh(covariance)[1].T])
    along = axes @ precision
    curvature = np.einsum("ij,ij->i", along, axes)
    start = mean + generator.standard_normal((_CHAINS, len(mean))) * np.sqrt(np.diag(covariance))
    at = np.clip(start, lower, upper)
    draws: list[np.ndarray] = []
    needed = -(-count // _CHAINS)
    for sweep in range(_BURN_IN + _BETWEEN * needed):
        for axis, (direction, weights, own) in enumerate(zip(axes, along, curvature, strict=True)):
            center = -((at - mean) @ weights) / own
            if axis < len(mean):
                low, high = lower[axis] - at[:, axis], upper[axis] - at[:, axis]
            else:
                with np.errstate(divide="ignore", invalid="ignore"):
                    ends = np.stack([(lower - at) / direction, (upper - at) / direction])
                ends = np.where(np.abs(direction) > 1e-12, ends, [[[-np.inf]], [[np.inf]]])
                low, high = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
            step = _within(center, 1.0 / np.sqrt(own), low, high, generator)
            at = np.clip(at + step[:, None] * direction, lower, upper)
        if sweep >= _BURN_IN and (sweep - _BURN_IN) % _BETWEEN == 0:
            draws.append(at)
    return np.concatenate(draws)[:count]


def _within(
    center: np.ndarray,
    deviation: float,
    low: np.ndarray,
    high: np.ndarray,
    generator: np.random.Generator,
) -> np.ndarray:
    """Draw single normal values between two ends, also far out in a tail."""
    first, last = (low - center) / deviation, (high - center) / deviation
    turned = first + last > 0.0  # logarithms of probabilities are exact in the lower tail
    bottom, top = np.where(turned, -last, first), np.where(turned, -first, last)
    share = generator.uniform(1e-12, 1.0, len(center))
    logs = scipy.special.log_ndtr(bottom), scipy.special.log_ndtr(top)
    drawn = scipy.special.ndtri_exp(np.logaddexp(logs[0] + np.log1p(-share), logs[1] + np.log(share)))
    drawn = np.clip(drawn, bottom, np.maximum(bottom, top))
    return np.asarray(center + deviation * np.where(turned, -drawn, drawn))


# Of a variable that no prior and no moment sees: curvature by the width of its bounds, wide enough to be
# flat within them; and the least weight of a prior, by which it can be told a pull.
_FLAT, _LEAST_PRIOR = 1e-3, 1e-3

_Matrix = Float[np.ndarray, "variable variable"]


@dataclass(frozen=True)
class Posterior:
    """What is known about the variables of a calibration, to second order about its solution.

    Parameters
    ----------
    problem
        What was minimised: of one leg, or of two.
    state
        Where the solver ended.
    noise
        Of each leg's moments.
    modelled
        Each leg's moments at the solution, N m.
    information
        Factor that makes the moments' part of the cost minus twice a logarithm of probability.
    prior_information
        The same of priors and penalties: how many muscles their means are over.
    curvature
        Gauss-Newton Hessian of half the cost; of hard limits, those that push.
    restraint
        Of priors and penalties alone, and a little where bounds are all that is known.
    pull, restraint_pull, moment_pull
        Half the slope of the cost, and the parts of it that priors with penalties, and moments, make.
    moment_noise
        Covariance of half the cost's slope that the noise of the moments makes.
    """

    problem: AbstractCalibration = field(repr=False)
    state: LagrangianState = field(repr=False)
    noise: tuple[ResidualNoise, ...] = field(repr=False)
    modelled: tuple[Float[np.ndarray, "trial coordinate frame"], ...] = field(repr=False)
    information: float
    prior_information: float
    curvature: _Matrix = field(repr=False)
    restraint: _Matrix = field(repr=False)
    pull: Float[np.ndarray, " variable"] = field(repr=False)
    restraint_pull: Float[np.ndarray, " variable"] = field(repr=False)
    moment_pull: Float[np.ndarray, " variable"] = field(repr=False)
    moment_noise: _Matrix = field(repr=False)

    @property
    def solution(self) -> Float[np.ndarray, " variable"]:
        """Where calibration ended, solver units."""
        return np.asarray(self.state.variables)

    @property
    def at_bound(self) -> Int[np.ndarray, " variable"]:
        """-1 at the lower bound, 1 at the upper one, 0 between; 2 where they coincide."""
        return _at_bound(self.problem, self.solution)

    def laplace(self, count: int, seed: int) -> Float[np.ndarray, "draw variable"]:
        """Draw from the normal distribution about the solution, within the bounds.

        Free variables have the covariance that moments' noise and priors give them through calibration.
        Variables at a bound leave it one-sided, the less the harder they are pushed.
        """
        place = self.at_bound
        free, stuck = np.flatnonzero(place == 0), np.flatnonzero(abs(place) == 1)
        order = np.concatenate([stuck, free])
        total = self.curvature + _flat(self.problem)
        inverse = np.linalg.inv(total[np.ix_(free, free)])
        slope = self.moment_noise + self.restraint / self.prior_information
        own = inverse @ slope[np.ix_(free, free)] @ inverse
        follow = -inverse @ total[np.ix_(free, stuck)]
        profile = total[np.ix_(stuck, stuck)] + total[np.ix_(stuck, free)] @ follow
        weight = min(self.information, self.prior_information)
        of_stuck = np.linalg.inv(weight * profile)
        covariance = np.block(
            [[of_stuck, of_stuck @ follow.T], [follow @ of_stuck, own + follow @ of_stuck @ follow.T]]
        )
        mean = -of_stuck @ (weight * self.pull[stuck])
        return self._within(np.concatenate([mean, follow @ mean]), covariance, order, count, seed)

    def sample_prior(self, count: int, seed: int) -> Float[np.ndarray, "draw variable"]:
        """Draw from what priors, penalties and bounds alone say."""
        order = np.flatnonzero(self.at_bound != 2)
        inverse = np.linalg.inv((self.restraint + _flat(self.problem))[np.ix_(order, order)])
        mean = -inverse @ self.restraint_pull[order]
        return self._within(mean, inverse / self.prior_information, order, count, seed)

    def _within(
        self, mean: np.ndarray, covariance: _Matrix, order: np.ndarray, count: int, seed: int
    ) -> Float[np.ndarray, "draw variable"]:
        lower, upper = np.asarray(self.problem.lower), np.asarray(self.problem.upper)
        draws = np.tile(self.solution, (count, 1))
        covariance = 0.5 * (covariance + covariance.T)
        draws[:, order] = draw_truncated_normal(
            self.solution[order] + mean, covariance, lower[order], upper[order], count, seed
        )
        return draws

    def randomized_problem(self, number: int, seed: int) -> AbstractCalibration:
        """Give the problem with moments of the model with other noise, and priors that pull otherwise.

        Without noise its solution is the calibration's own, and to first order the solutions of many are
        distributed as the posterior (Chen & Oliver 2012, doi:10.1007/s11004-011-9376-z; Bardsley et al. 2014,
        doi:10.1137/140964023). Only arrays differ from the calibration's problem: compiled code is the same.
        """
        generator = np.random.default_rng([seed, number])
        values, vectors = np.linalg.eigh(self.restraint / self.prior_information)
        pull = vectors @ (np.sqrt(values.clip(0.0)) * generator.standard_normal(len(values)))
        # What moments' misfit pulls at the solution is gone with the misfit: priors pull as much instead.
        pull = pull - self.moment_pull
        redone = []
        told = np.zeros(len(pull), dtype=bool)
        parts = zip(leg_objectives(self.problem), self.modelled, self.noise, strict=True)
        for (leg, place), modelled, noise in parts:
            variables = leg.variables
            counts = np.sqrt(_kind_counts(variables.labels))
            precision = np.maximum(np.asarray(variables.prior_precision), _LEAST_PRIOR)
            shift = np.where(told[place], 0.0, pull[place]) / (precision / counts) ** 2
            told[place] = True
            redone.append(
                replace(
                    leg,
                    measured=jnp.asarray(modelled + noise.draw(generator)),
                    variables=replace(
                        variables,
                        prior_mean=np.asarray(variables.prior_mean) + shift,
                        prior_precision=precision,
                    ),
                )
            )
        if isinstance(self.problem, TwoLegObjective):
            return replace(self.problem, legs=(redone[0], redone[1]))
        return redone[0]


def posterior(
    problem: AbstractCalibration, state: LagrangianState, speeds: Sequence[Float[np.ndarray, " trial"]]
) -> Posterior:
    """Judge a solution.

    Parameters
    ----------
    problem
        What was minimised, with its limits as they were at the end.
    state
        Where the solver ended.
    speeds
        Of each leg's cycles, m/s; NaN where unknown.
    """
    variables = jnp.asarray(state.variables)
    whole = problem.linearized_at(variables)
    alone = _restraints_only(problem).linearized_at(variables)
    curvature, restraint = np.asarray(whole.gauss_newton), np.asarray(alone.gauss_newton)
    free = _at_bound(problem, np.asarray(variables)) == 0
    inverse = np.linalg.inv((curvature + _flat(problem))[np.ix_(free, free)])
    count = len(curvature)
    noises, modelled = [], []
    seen, noisy, pull = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    for (leg, place), speed in zip(leg_objectives(problem), speeds, strict=True):
        shape = leg.measured.shape
        scale = 1.0 / (float(leg.moment_error) * np.sqrt(leg.measured.size))
        rows, slopes = map(np.asarray, moments_and_slopes(leg, variables[place]))
        residuals, slopes = (rows / scale).reshape(shape), (slopes / scale).reshape(*shape, -1)
        own = np.flatnonzero(free[place])
        chosen = np.searchsorted(np.flatnonzero(free), place[own])
        gain = scale**2 * inverse[np.ix_(chosen, chosen)]
        noise = residual_noise(residuals, speed, slopes[..., own], gain)
        flat = slopes.reshape(-1, len(place))
        block = np.ix_(place, place)
        seen[block] += scale**2 * flat.T @ flat
        noisy[block] += scale**4 * noise.through(slopes)
        pull[place] += scale**2 * flat.T @ residuals.ravel()
        noises.append(noise)
        modelled.append(np.asarray(leg.measured) + residuals)
    both = [np.sum(inverse * part[np.ix_(free, free)]) for part in (seen, noisy)]
    return Posterior(
        problem=problem,
        state=state,
        noise=tuple(noises),
        modelled=tuple(modelled),
        # As many independent samples as tell the parameters, on average over what moments tell of them, as
        # much (Pauli, Racugno & Ventura 2011, Statistica Sinica 21:149).
        information=float(both[0] / both[1]),
        prior_information=float(max(len(leg.variables.index) for leg, _ in leg_objectives(problem))),
        curvature=curvature,
        restraint=restraint,
        pull=np.asarray(whole.gradient),
        restraint_pull=np.asarray(alone.gradient),
        moment_pull=pull,
        moment_noise=noisy,
    )


def leg_objectives(problem: AbstractCalibration) -> list[tuple[Objective, Int[np.ndarray, " own"]]]:
    """Give each leg's problem, and where its variables stand among all."""
    if isinstance(problem, TwoLegObjective):
        return list(zip(problem.legs, problem.places, strict=True))
    assert isinstance(problem, Objective)
    return [(problem, np.arange(problem.variables.count))]


def _restraints_only(problem: AbstractCalibration) -> AbstractCalibration:
    """Leave out moments and limits, by arrays alone."""
    unlimited = tuple(replace(limit, weight=jnp.zeros_like(limit.weight)) for limit in problem.limits)
    problem = problem.with_limits(unlimited)
    if isinstance(problem, TwoLegObjective):
        first, second = (replace(leg, moment_error=np.array(np.inf)) for leg in problem.legs)
        return replace(problem, legs=(first, second))
    assert isinstance(problem, Objective)
    return replace(problem, moment_error=np.array(np.inf))


def _at_bound(problem: AbstractCalibration, variables: np.ndarray) -> Int[np.ndarray, " variable"]:
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    place = np.where(variables <= lower, -1, np.where(variables >= upper, 1, 0))
    return np.where(lower == upper, 2, place)


def _flat(problem: AbstractCalibration) -> _Matrix:
    width = np.asarray(problem.upper) - np.asarray(problem.lower)
    return np.diag(np.divide(_FLAT, width**2, out=np.full(width.shape, 1.0), where=width > 0.0))


def _kind_counts(labels: Sequence[str]) -> Float[np.ndarray, " variable"]:
    kinds = [label.rsplit(".", 1)[1] for label in labels]
    return np.array([float(kinds.count(kind)) for kind in kinds])


@eqx.filter_jit
def moments_and_slopes(
    leg: Objective, variables: Float[Array, " variable"]
) -> tuple[Float[Array, " row"], Float[Array, "row variable"]]:
    """Give the rows of the moments, and their derivatives by the leg's variables."""
    return leg.terms(leg.parameters(variables))["joint_moment"], leg.moment_jacobian(variables)
