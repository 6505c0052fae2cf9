"""Uncertainty of calibrated parameters and moments (`uncertainty`) by Laplace approximation or bootstrap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibration.calibration import Calibration, write_calibrated_model
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.checkpoints import Checkpoints
from wrapjax.calibration.solvers.interface import AbstractCalibration, Status
from wrapjax.calibration.two_legs import join_leg_objectives
from wrapjax.calibration.uncertainty.intervals import LegSpread, summarize_draws
from wrapjax.calibration.uncertainty.posterior import (
    Posterior,
    leg_objectives,
    moments_and_slopes,
    physical_units,
    posterior,
)
from wrapjax.errors import InputError, Problem
from wrapjax.model.forward import joint_moments
from wrapjax.model.variables import Variables
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.model_inputs import recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset


def randomized_refits(
    distribution: Posterior,
    solver: AugmentedLagrangian,
    count: int,
    seed: int,
    *,
    checkpoints: Checkpoints | None = None,
    advance: Callable[[int], None] | None = None,
) -> tuple[Float[np.ndarray, "draw variable"], tuple[Status, ...]]:
    """Calibrate to randomized problems (`Posterior.randomized_problem`), one per draw, from the solution.

    Parameters
    ----------
    distribution
        Posterior of the calibration.
    solver
        Solver of the calibration.
    count, seed
        Number and seed of the draws; the first draws do not depend on their number.
    checkpoints
        Checkpoints of the draws; finished ones are not repeated.
    advance
        Called with the number of finished draws.

    Returns
    -------
    draws, statuses
        Variables (solver units) and status of each draw.

    Raises
    ------
    KeyboardInterrupt
        If interrupted; the checkpoints have the finished draws.
    """
    draws, statuses = [], []
    for number in range(count):
        name = f"draw_{number}"
        checkpoint = checkpoints.read(name) if checkpoints else None
        if checkpoint is not None and checkpoint.status is not None:
            variables, status = np.asarray(checkpoint.state.variables), checkpoint.status
        else:
            solution = solver.solve(distribution.randomized_problem(number, seed), distribution.state)
            variables, status = solution.variables, solution.status
            if status is Status.interrupted:
                raise KeyboardInterrupt
            if checkpoints:
                checkpoints.write(name, solution.state, solution.history, status)
        draws.append(variables)
        statuses.append(status)
        if advance:
            advance(number + 1)
    return np.stack(draws), tuple(statuses)


#: Methods of `uncertainty`.
WAYS = ("laplace", "bootstrap")
#: Default number of draws; each draw of a bootstrap is a calibration.
DRAWS = {"laplace": 2000, "bootstrap": 50}
# Number of draws from the prior, of which the standard deviation alone is used.
_PRIOR_DRAWS = 1000


@dataclass(frozen=True)
class Uncertainty:
    """Calibration with the uncertainty of its parameters and moments.

    Parameters
    ----------
    calibration
        Calibration whose uncertainty was estimated.
    way
        Method: ``laplace`` or ``bootstrap``.
    spreads
        Uncertainty of each leg that was calibrated together.
    """

    calibration: Calibration
    way: str
    spreads: tuple[LegSpread, ...]

    @property
    def spread(self) -> LegSpread:
        """Uncertainty of the leg (the first of two)."""
        return self.spreads[0]

    def summary(self) -> dict[str, Any]:
        """Return the content of ``uncertainty.json`` of the leg (the first of two)."""
        from wrapjax.report.calibration.spread import describe_uncertainty

        return describe_uncertainty(self.calibration.result, self.spread)

    def to_dataset(self) -> Dataset:
        """Return the uncertainty of the parameters of the leg (the first of two) as an `xarray.Dataset`."""
        from wrapjax.report.labelled.arrays import spread_dataset

        return spread_dataset(self.spread.parameters, self.way)

    def plot_moments(self) -> Figure:
        """Draw measured and modelled moments (N m) with the 90 % band of the draws."""
        from wrapjax.report.calibration.spread import band_figure

        return band_figure(self.calibration.result, self.spread)

    def save(self, folder: str | Path, *, force: bool = False, motion: bool = False) -> None:
        """Write the folder of the run as `Calibration.save` does, with uncertainties in tables and report.

        Parameters
        ----------
        folder
            Folder to create.
        force
            Replace an existing folder.
        motion
            If wraps were calibrated, also write ``motion.html``, which shows them in motion; takes seconds.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is not set, or it cannot be created.
        """
        from wrapjax.report.calibration.run_page import write_run

        write_run(
            [(leg.subject, leg.result) for leg in self.calibration.legs],
            Path(folder),
            force=force,
            describe_model=describe_model,
            write_calibrated_model=write_calibrated_model,
            motion=motion,
            spreads=self.spreads,
        )
        if self.calibration.checkpoints is not None:
            self.calibration.checkpoints.close()


def uncertainty(
    calibration: Calibration,
    way: str = "laplace",
    *,
    draws: int | None = None,
    seed: int = 0,
    advance: Callable[[int], None] | None = None,
) -> Uncertainty:
    """Estimate the uncertainty of the parameters and moments of a calibration.

    The uncertainty is that of the calibration's response, with its weights, to noise of the moments and to
    subjects that differ from priors and penalties by one allowable error. The variance of the noise and its
    correlation over a cycle are estimated from the residuals; residuals that recur in every cycle of a speed
    count as one sample (see `wrapjax.calibration.uncertainty.posterior`).

    Parameters
    ----------
    calibration
        Calibration from `calibrate`. Legs that were calibrated together are treated together.
    way
        ``laplace``: draws from a normal distribution about the solution, within the bounds. ``bootstrap``:
        calibrations to simulated moments (the calibrated model with noise like that of the residuals) with
        randomized priors, each from the solution; it includes the nonlinearity of the model. Bootstrap draws
        can lie on bounds and Laplace draws do not, so that parameters that are determined by bounds alone
        have wider bootstrap intervals.
    draws
        Number of draws; 2000 for ``laplace`` and 50 for ``bootstrap`` if not given.
    seed
        Seed of the draws.
    advance
        Called with the number of finished draws of a bootstrap.

    Returns
    -------
    Uncertainty
        Standard deviation, 90 % interval and identifiability of each parameter in its unit, and a 90 % band
        about the modelled moments (N m) of every cycle. Errors of the model are included only as far as they
        are visible in the residuals.

    Raises
    ------
    InputError
        If the calibration has trials of other tasks than gait, or with given numbers of samples.
    ValueError
        If the method is unknown, or there are fewer than 2 draws.
    KeyboardInterrupt
        If a bootstrap is interrupted; the checkpoints of the calibration, if any, have the finished draws.

    Examples
    --------
    >>> estimated = uncertainty(calibrate(subject))  # doctest: +SKIP
    >>> estimated.spread.parameters.deviation  # doctest: +SKIP
    >>> estimated.save("run")  # doctest: +SKIP
    """
    if way not in WAYS:
        raise ValueError(f"unknown way '{way}': expected one of {', '.join(WAYS)}")
    count = DRAWS[way] if draws is None else draws
    if count < 2:
        raise ValueError(f"{count} draws have no spread: expected at least 2")
    for leg in calibration.legs:
        if not leg.subject.trials.is_gait_only:
            message = "expected gait cycles alone, whose residuals recur phase by phase, found other tasks"
            raise InputError(
                Problem(str(leg.subject.folder), message, hint="calibrate without --uncertainty")
            )
        if leg.subject.trials.given_samples is not None:
            message = "expected gait cycles that all count alike, found trials with 'effective_samples'"
            raise InputError(
                Problem(
                    str(leg.subject.folder), message, hint="leave out --uncertainty or 'effective_samples'"
                )
            )
    solution = calibration.result.solution
    problem, speeds = _problem(calibration)
    distribution = posterior(problem, solution.state, speeds)
    converged = count
    if way == "laplace":
        variable_draws = distribution.laplace(count, seed)
    else:
        variable_draws, statuses = randomized_refits(
            distribution,
            calibration.result.solver,
            count,
            seed,
            checkpoints=calibration.checkpoints,
            advance=advance,
        )
        converged = sum(status.converged for status in statuses)
    prior_draws = distribution.sample_prior(_PRIOR_DRAWS, seed)
    spreads = []
    for number, leg in enumerate(calibration.legs):
        own, place = leg_objectives(problem)[number]
        bands = _linear_band if way == "laplace" else _modelled_band
        low, high = bands(leg, own, distribution.solution[place], variable_draws[:, place])
        spreads.append(
            _leg_spread(
                way,
                distribution,
                number,
                own.variables,
                place,
                variable_draws,
                prior_draws,
                converged,
                low,
                high,
            )
        )
    return Uncertainty(calibration, way, tuple(spreads))


def _problem(
    calibration: Calibration,
) -> tuple[AbstractCalibration, list[Float[np.ndarray, " _"]]]:
    """Return the objective of the calibration, and the walking speeds of each leg's cycles."""
    problems = [leg.result.solution.problem for leg in calibration.legs]
    objectives = [problem for problem in problems if isinstance(problem, Objective)]
    speeds = [leg.subject.trials.used_for("calibration").speeds for leg in calibration.legs]
    if len(objectives) == 1:
        return objectives[0], speeds
    return join_leg_objectives(*objectives), speeds


def _leg_spread(
    way: str,
    distribution: Posterior,
    number: int,
    variables: Variables,
    place: Int[np.ndarray, " own"],
    variable_draws: Float[np.ndarray, "draw variable"],
    prior_draws: Float[np.ndarray, "_ variable"],
    converged: int,
    low: Float[np.ndarray, "trial coordinate frame"],
    high: Float[np.ndarray, "trial coordinate frame"],
) -> LegSpread:
    offset, scale, units = physical_units(variables)
    draws, prior = (offset + scale * one[:, place] for one in (variable_draws, prior_draws))
    noise = distribution.noise[number]
    return LegSpread(
        way=way,
        parameters=summarize_draws(
            draws,
            prior,
            offset + scale * distribution.solution[place],
            distribution.at_bound[place],
            variables.labels,
            units,
        ),
        draws=draws,
        converged=converged,
        low=low,
        high=high,
        noise=noise.deviation,
        independent_samples=noise.independent,
        information=distribution.information,
    )


def _linear_band(
    leg: Calibration,
    problem: Objective,
    solution: Float[np.ndarray, " variable"],
    draws: Float[np.ndarray, "draw variable"],
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the 90 % band of the moments of draws, linearised about the solution."""
    all_cycles = _over_all_cycles(leg, problem)
    _, slopes = moments_and_slopes(all_cycles, jnp.asarray(solution))
    rows = np.asarray(slopes) * (float(all_cycles.moment_error) * np.sqrt(all_cycles.measured.size))
    changes = (draws - solution) @ rows.T
    low, high = np.percentile(changes, [5.0, 95.0], axis=0).reshape(2, *all_cycles.measured.shape)
    return leg.result.modelled + low, leg.result.modelled + high


def _modelled_band(
    leg: Calibration,
    problem: Objective,
    solution: Float[np.ndarray, " variable"],
    draws: Float[np.ndarray, "draw variable"],
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the 90 % band of the moments of draws with the nonlinear model."""
    all_cycles = _over_all_cycles(leg, problem)
    moments = np.stack([np.asarray(_moments_of(all_cycles, jnp.asarray(draw))) for draw in draws])
    low, high = np.percentile(moments, [5.0, 95.0], axis=0)
    return low, high


@eqx.filter_jit
def _moments_of(
    problem: Objective, variables: Float[Array, " variable"]
) -> Float[Array, "trial coordinate frame"]:
    return joint_moments(
        problem.curves, problem.parameters(variables), problem.recording, problem.alterations
    )


def _over_all_cycles(leg: Calibration, problem: Objective) -> Objective:
    """Return the objective over all cycles of the subject, without penalties and limits."""
    subject, trials = leg.subject, leg.subject.trials
    paths = leg.fit.paths(subject, trials, leg.result.freedom)
    return replace(
        problem,
        recording=recording(subject, trials, paths),
        measured=jnp.asarray(trials.moments),
        penalties=(),
        limits=(),
    )
