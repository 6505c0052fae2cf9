"""Approximate posterior distribution of the variables of a calibration.

The cost of a calibration is a sum of mean squares, so that it is no negative log likelihood: the weights of
its terms determine the estimate, but not its uncertainty. The covariance of the moments is therefore
estimated from the residuals (`residual_noise`), and that of priors and penalties follows from a deviation of
one allowable error in each muscle. The covariance of the estimate is that of its response to both (sandwich
form ``H^-1 S H^-1``, with S the covariance of the gradient); it is not smaller where the calibration weights
a prior more than is justified.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

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
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, PARAMETERS
from wrapjax.model.parameters import QUANTITIES
from wrapjax.model.variables import Variables

# Curvature times the squared width of the bounds, added for variables that neither priors nor moments
# determine (nearly constant within the bounds); and smallest precision of a prior whose mean is randomized.
_FLAT, _MIN_PRECISION = 1e-3, 1e-3

_Matrix = Float[np.ndarray, "variable variable"]
# Gibbs sampler: parallel chains, sweeps before the first draw, and sweeps from one draw to the next.
_CHAINS, _BURN_IN, _THINNING = 100, 25, 3


@dataclass(frozen=True)
class Posterior:
    """Posterior of the variables of a calibration, to second order about its solution.

    All matrices and gradients are in solver units. A gradient here is half the gradient of a cost, and a
    curvature half its Hessian.

    Parameters
    ----------
    problem
        Objective of one leg or of two.
    state
        Final state of the solver.
    noise
        Noise of the moments of each leg.
    modelled
        Moments of each leg at the solution, N m.
    information
        Factor that turns the moment term of the cost into minus twice a log likelihood.
    prior_information
        The same factor for priors and penalties: the number of muscles that their means are over.
    curvature
        Gauss-Newton curvature of the cost, including active hard limits.
    remainder
        What second derivatives of the residuals add to it.
    prior_curvature
        Gauss-Newton curvature of priors and penalties.
    gradient
        Gradient of the cost at the solution.
    prior_gradient
        Gradient of priors and penalties at the solution.
    moment_gradient
        Gradient of the moment term at the solution.
    gradient_noise
        Covariance of the gradient of the cost due to the noise of the moments.
    """

    problem: AbstractCalibration = field(repr=False)
    state: LagrangianState = field(repr=False)
    noise: tuple[ResidualNoise, ...] = field(repr=False)
    modelled: tuple[Float[np.ndarray, "trial coordinate frame"], ...] = field(repr=False)
    information: float
    prior_information: float
    curvature: _Matrix = field(repr=False)
    remainder: _Matrix = field(repr=False)
    prior_curvature: _Matrix = field(repr=False)
    gradient: Float[np.ndarray, " variable"] = field(repr=False)
    prior_gradient: Float[np.ndarray, " variable"] = field(repr=False)
    moment_gradient: Float[np.ndarray, " variable"] = field(repr=False)
    gradient_noise: _Matrix = field(repr=False)

    @property
    def solution(self) -> Float[np.ndarray, " variable"]:
        """Calibrated variables, solver units."""
        return np.asarray(self.state.variables)

    @property
    def at_bound(self) -> Int[np.ndarray, " variable"]:
        """Position of each variable: -1 at the lower bound, 1 at the upper, 0 between, 2 if they coincide."""
        return _at_bound(self.problem, self.solution)

    def laplace(self, count: int, seed: int) -> Float[np.ndarray, "draw variable"]:
        """Draw from the Laplace approximation: a normal distribution about the solution, within the bounds.

        Free variables have the covariance of the calibration's response to the noise of the moments and to
        deviations from the priors. Variables at a bound have a one-sided distribution, which is narrower for
        a larger gradient towards the bound.

        Parameters
        ----------
        count
            Number of draws.
        seed
            Seed of the draws.
        """
        position = self.at_bound
        free, bounded = np.flatnonzero(position == 0), np.flatnonzero(abs(position) == 1)
        order = np.concatenate([bounded, free])
        total = self.curvature + _flat(self.problem)
        inverse, free_covariance = self._inverse(free), self._free_covariance(free)
        response = -inverse @ total[np.ix_(free, bounded)]
        profile = total[np.ix_(bounded, bounded)] + total[np.ix_(bounded, free)] @ response
        weight = min(self.information, self.prior_information)
        bounded_covariance = np.linalg.inv(weight * profile)
        covariance = np.block(
            [
                [bounded_covariance, bounded_covariance @ response.T],
                [response @ bounded_covariance, free_covariance + response @ bounded_covariance @ response.T],
            ]
        )
        mean = -bounded_covariance @ (weight * self.gradient[bounded])
        return self._draw(np.concatenate([mean, response @ mean]), covariance, order, count, seed)

    def step(self, gradients: Float[np.ndarray, "variable change"]) -> Float[np.ndarray, "variable change"]:
        """Compute how far the solution moves, to first order, for changes of half the gradient of the cost.

        Variables at a bound stay there. Where the curvature is not positive in all directions, as it is at a
        minimum, that of Gauss-Newton is taken.
        """
        free = np.flatnonzero(self.at_bound == 0)
        full = (self.curvature + self.remainder + _flat(self.problem))[np.ix_(free, free)]
        moved = np.zeros_like(gradients)
        try:
            moved[free] = -scipy.linalg.cho_solve(scipy.linalg.cho_factor(full), gradients[free])
        except np.linalg.LinAlgError:
            moved[free] = -self._inverse(free) @ gradients[free]
        return moved

    def deviation(self) -> Float[np.ndarray, " variable"]:
        """Compute the standard deviation of each free variable given the others' bounds; NaN at a bound."""
        free = np.flatnonzero(self.at_bound == 0)
        deviation = np.full(len(self.solution), np.nan)
        deviation[free] = np.sqrt(np.diagonal(self._free_covariance(free)))
        return deviation

    def _inverse(self, free: Int[np.ndarray, " free"]) -> Float[np.ndarray, "free free"]:
        return np.linalg.inv((self.curvature + _flat(self.problem))[np.ix_(free, free)])

    def _free_covariance(self, free: Int[np.ndarray, " free"]) -> Float[np.ndarray, "free free"]:
        inverse = self._inverse(free)
        noise = self.gradient_noise + self.prior_curvature / self.prior_information
        return inverse @ noise[np.ix_(free, free)] @ inverse

    def sample_prior(self, count: int, seed: int) -> Float[np.ndarray, "draw variable"]:
        """Draw from the distribution given by priors, penalties and bounds alone; see `laplace`."""
        order = np.flatnonzero(self.at_bound != 2)
        inverse = np.linalg.inv((self.prior_curvature + _flat(self.problem))[np.ix_(order, order)])
        mean = -inverse @ self.prior_gradient[order]
        return self._draw(mean, inverse / self.prior_information, order, count, seed)

    def _draw(
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
        """Return the problem with simulated moments and randomized prior means, for one bootstrap draw.

        The moments are those of the calibrated model with simulated noise. Without noise the solution of this
        problem is that of the calibration; to first order the solutions of many such problems are distributed
        as the posterior (randomized maximum likelihood and randomize-then-optimize: Chen & Oliver 2012,
        doi:10.1007/s11004-011-9376-z; Bardsley et al. 2014, doi:10.1137/140964023). It differs from the
        calibration's problem in the values of arrays alone, so that compiled functions are reused.

        Parameters
        ----------
        number
            Number of the draw.
        seed
            Seed of all draws.
        """
        generator = np.random.default_rng([seed, number])
        values, vectors = np.linalg.eigh(self.prior_curvature / self.prior_information)
        shift_gradient = vectors @ (np.sqrt(values.clip(0.0)) * generator.standard_normal(len(values)))
        # Simulated moments have no misfit at the solution; the priors get the gradient of the misfit instead.
        shift_gradient = shift_gradient - self.moment_gradient
        randomized = []
        done = np.zeros(len(shift_gradient), dtype=bool)
        parts = zip(leg_objectives(self.problem), self.modelled, self.noise, strict=True)
        for (leg, place), modelled, noise in parts:
            variables = leg.variables
            counts = np.sqrt(_kind_counts(variables.labels))
            precision = np.maximum(np.asarray(variables.prior_precision), _MIN_PRECISION)
            shift = np.where(done[place], 0.0, shift_gradient[place]) / (precision / counts) ** 2
            done[place] = True
            randomized.append(
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
            return replace(self.problem, legs=(randomized[0], randomized[1]))
        return randomized[0]


def posterior(
    problem: AbstractCalibration, state: LagrangianState, speeds: Sequence[Float[np.ndarray, " _"]]
) -> Posterior:
    """Compute the posterior of a calibration about its solution.

    Parameters
    ----------
    problem
        Objective of the calibration, with the final shifts and weights of its limits.
    state
        Final state of the solver.
    speeds
        Walking speeds of the cycles of each leg, m/s; NaN where unknown.
    """
    variables = jnp.asarray(state.variables)
    full = problem.linearized_at(variables)
    priors = _priors_only(problem).linearized_at(variables)
    curvature, prior_curvature = np.asarray(full.gauss_newton), np.asarray(priors.gauss_newton)
    free = _at_bound(problem, np.asarray(variables)) == 0
    inverse = np.linalg.inv((curvature + _flat(problem))[np.ix_(free, free)])
    count = len(curvature)
    noises, modelled = [], []
    moment_curvature, gradient_noise = np.zeros((count, count)), np.zeros((count, count))
    moment_gradient = np.zeros(count)
    for (leg, place), speed in zip(leg_objectives(problem), speeds, strict=True):
        shape = leg.measured.shape
        scale = 1.0 / (float(leg.moment_error) * np.sqrt(leg.measured.size))
        rows, slopes = map(np.asarray, moments_and_slopes(leg, variables[place]))
        residuals, slopes = (rows / scale).reshape(shape), (slopes / scale).reshape(*shape, -1)
        own_free = np.flatnonzero(free[place])
        chosen = np.searchsorted(np.flatnonzero(free), place[own_free])
        gain = scale**2 * inverse[np.ix_(chosen, chosen)]
        noise = residual_noise(residuals, speed, slopes[..., own_free], gain)
        flat = slopes.reshape(-1, len(place))
        block = np.ix_(place, place)
        moment_curvature[block] += scale**2 * flat.T @ flat
        gradient_noise[block] += scale**4 * noise.propagate(slopes)
        moment_gradient[place] += scale**2 * flat.T @ residuals.ravel()
        noises.append(noise)
        modelled.append(np.asarray(leg.measured) + residuals)
    traces = [np.sum(inverse * part[np.ix_(free, free)]) for part in (moment_curvature, gradient_noise)]
    return Posterior(
        problem=problem,
        state=state,
        noise=tuple(noises),
        modelled=tuple(modelled),
        # Ratio of the curvature to the covariance of the gradient, averaged over what moments determine
        # (adjusted composite likelihood; Pauli, Racugno & Ventura 2011, Statistica Sinica 21:149).
        information=float(traces[0] / traces[1]),
        prior_information=float(max(len(leg.variables.index) for leg, _ in leg_objectives(problem))),
        curvature=curvature,
        remainder=np.asarray(full.remainder),
        prior_curvature=prior_curvature,
        gradient=np.asarray(full.gradient),
        prior_gradient=np.asarray(priors.gradient),
        moment_gradient=moment_gradient,
        gradient_noise=gradient_noise,
    )


class PhysicalUnits(NamedTuple):
    """How variables in solver units give parameters: ``offset + scale * variables``, each in its unit."""

    offset: Float[np.ndarray, " variable"]
    scale: Float[np.ndarray, " variable"]
    units: tuple[str, ...]


def physical_units(variables: Variables) -> PhysicalUnits:
    """Return the SI units of the variables of a leg; parameters of wraps count from their nominal values."""
    names = [label.rsplit(".", 1)[1] for label in variables.labels]
    offset = [NOMINAL_PARAMETERS[PARAMETERS.index(name)] if name in PARAMETERS else 0.0 for name in names]
    scale = np.asarray(variables.scale).ravel()[np.asarray(variables.places)[0]]
    return PhysicalUnits(np.array(offset), scale, tuple(map(_unit, names)))


def _unit(name: str) -> str:
    """Return the unit of a muscle parameter, wrap parameter or path mode."""
    if name in QUANTITIES:
        return QUANTITIES[name].unit
    return {"m": "m", "rad": "rad"}.get(name.rsplit("_", 1)[-1], "1")


def leg_objectives(problem: AbstractCalibration) -> list[tuple[Objective, Int[np.ndarray, " own"]]]:
    """Return the objective of each leg, and the indices of its variables among all."""
    if isinstance(problem, TwoLegObjective):
        return list(zip(problem.legs, problem.places, strict=True))
    assert isinstance(problem, Objective)
    return [(problem, np.arange(problem.variables.count))]


def _priors_only(problem: AbstractCalibration) -> AbstractCalibration:
    """Return the problem with zero weights of moments and limits; arrays keep their shapes."""
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
    """Compute the moment residuals of a leg and their Jacobian by its variables."""
    return leg.terms(leg.parameters(variables))["joint_moment"], leg.moment_jacobian(variables)


def draw_truncated_normal(
    mean: Float[np.ndarray, " variable"],
    covariance: Float[np.ndarray, "variable variable"],
    lower: Float[np.ndarray, " variable"],
    upper: Float[np.ndarray, " variable"],
    count: int,
    seed: int,
) -> Float[np.ndarray, "draw variable"]:
    """Draw from a normal distribution truncated to bounds.

    A Gibbs sampler draws the variables with bounds, along every variable and along the principal axes of
    their covariance; the axes make it efficient where variables are strongly correlated. Variables without
    bounds are drawn from their exact conditional distribution.

    Parameters
    ----------
    mean
        Mean before truncation; it may lie outside the bounds.
    covariance
        Covariance before truncation, positive definite.
    lower, upper
        Bounds; infinite where there are none.
    count
        Number of draws.
    seed
        Seed of the draws.

    Returns
    -------
    Array
        Draws, all within the bounds.
    """
    generator = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance)
    free = mean + generator.standard_normal((count, len(mean))) @ root.T
    bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if not bounded.size:
        return free
    block = covariance[np.ix_(bounded, bounded)]
    box = lower[bounded], upper[bounded]
    bounded_draws = _gibbs(mean[bounded], block, *box, count, generator)
    # Shift unbounded variables by their regression on the change of the bounded ones (exact conditional).
    regression = scipy.linalg.solve(block, covariance[bounded], assume_a="pos")
    draws = free + (bounded_draws - free[:, bounded]) @ regression
    draws[:, bounded] = bounded_draws
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
    for sweep in range(_BURN_IN + _THINNING * needed):
        for axis, (direction, weights, precision_along) in enumerate(
            zip(axes, along, curvature, strict=True)
        ):
            center = -((at - mean) @ weights) / precision_along
            if axis < len(mean):
                low, high = lower[axis] - at[:, axis], upper[axis] - at[:, axis]
            else:
                with np.errstate(divide="ignore", invalid="ignore"):
                    ends = np.stack([(lower - at) / direction, (upper - at) / direction])
                ends = np.where(np.abs(direction) > 1e-12, ends, [[[-np.inf]], [[np.inf]]])
                low, high = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
            step = _draw_truncated_univariate(center, 1.0 / np.sqrt(precision_along), low, high, generator)
            at = np.clip(at + step[:, None] * direction, lower, upper)
        if sweep >= _BURN_IN and (sweep - _BURN_IN) % _THINNING == 0:
            draws.append(at)
    return np.concatenate(draws)[:count]


def _draw_truncated_univariate(
    center: np.ndarray,
    deviation: float,
    low: np.ndarray,
    high: np.ndarray,
    generator: np.random.Generator,
) -> np.ndarray:
    """Draw from univariate normal distributions truncated to intervals, accurately also far in a tail."""
    first, last = (low - center) / deviation, (high - center) / deviation
    mirrored = first + last > 0.0  # logarithms of probabilities are accurate in the lower tail
    bottom, top = np.where(mirrored, -last, first), np.where(mirrored, -first, last)
    fraction = generator.uniform(1e-12, 1.0, len(center))
    logs = scipy.special.log_ndtr(bottom), scipy.special.log_ndtr(top)
    drawn = scipy.special.ndtri_exp(np.logaddexp(logs[0] + np.log1p(-fraction), logs[1] + np.log(fraction)))
    drawn = np.clip(drawn, bottom, np.maximum(bottom, top))
    return np.asarray(center + deviation * np.where(mirrored, -drawn, drawn))
