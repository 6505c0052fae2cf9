"""``uncertainty``: how far a calibration's parameters may be from what they are said to be.

Calibrations of made-up moments, one a draw, resumable after any of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

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
from wrapjax.calibration.uncertainty.posterior import Posterior, leg_objectives, moments_and_slopes, posterior
from wrapjax.geometry.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.model.forward import joint_moments
from wrapjax.model.parameters import QUANTITIES
from wrapjax.model.variables import Variables
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.model_inputs import recording


def randomized_refits(
    judged: Posterior,
    solver: AugmentedLagrangian,
    count: int,
    seed: int,
    *,
    checkpoints: Checkpoints | None = None,
    advance: Callable[[int], None] | None = None,
) -> tuple[Float[np.ndarray, "draw variable"], tuple[Status, ...]]:
    """Calibrate again, from the solution, to moments and priors that were made up (`Posterior.randomized_problem`).

    Parameters
    ----------
    judged
        The solution.
    solver
        That found it.
    count, seed
        Of the draws; the first of many are those of few.
    journal
        Keeps what is finished. What it holds already is not done again.
    advance
        Called with the number of finished draws.

    Raises
    ------
    KeyboardInterrupt
        If the user stops it; the journal keeps what was done.
    """
    found, statuses = [], []
    for number in range(count):
        name = f"draw_{number}"
        entry = checkpoints.read(name) if checkpoints else None
        if entry is not None and entry.status is not None:
            variables, status = np.asarray(entry.state.variables), entry.status
        else:
            solution = solver.solve(judged.randomized_problem(number, seed), judged.state)
            variables, status = solution.variables, solution.status
            if status is Status.interrupted:
                raise KeyboardInterrupt
            if checkpoints:
                checkpoints.write(name, solution.state, solution.history, status)
        found.append(variables)
        statuses.append(status)
        if advance:
            advance(number + 1)
    return np.stack(found), tuple(statuses)


#: How spread can be found.
WAYS = ("laplace", "bootstrap")
#: Draws that do not ask for another number: of a bootstrap, each is a calibration.
DRAWS = {"laplace": 2000, "bootstrap": 50}
# Of what priors alone say: only its width is used.
_PRIOR_DRAWS = 1000


@dataclass(frozen=True)
class Uncertainty:
    """A calibration with the spread of what it found.

    Parameters
    ----------
    calibration
        What was judged.
    way
        ``laplace`` or ``bootstrap``.
    spreads
        Of each leg that was calibrated together.
    """

    calibration: Calibration
    way: str
    spreads: tuple[LegSpread, ...]

    @property
    def spread(self) -> LegSpread:
        """Of the leg (the first one of two)."""
        return self.spreads[0]

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the run's folder as `Calibration.save` does, with spreads in tables and report."""
        from wrapjax.report.run_folder import write_run

        write_run(
            [(leg.subject, leg.result) for leg in self.calibration.legs],
            Path(folder),
            force=force,
            describe_model=describe_model,
            write_calibrated_model=write_calibrated_model,
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
    """Say how well the recordings determine what a calibration found.

    What is judged is calibration's answer, with the weights that it had, to noise of the moments and to
    people who differ from what priors and penalties expect by one allowable error. How large the noise is,
    and how few independent samples a cycle holds, is read off the residuals; what they repeat in every cycle
    of a speed counts as one draw, not as many.

    Parameters
    ----------
    calibration
        From `calibrate`. Both legs are judged together where they were calibrated together.
    way
        ``laplace``: a normal distribution about the solution, within the bounds. ``bootstrap``:
        calibrations of moments made up by the model with noise like the residuals', and of priors drawn
        anew, each from the solution; it sees how nonlinear the model is. Its draws lie on the bounds that
        stopped them, where those of ``laplace`` keep off: what nothing but bounds decides is wider by it.
    draws
        How many: 2000 by ``laplace``, 50 by ``bootstrap`` if not given.
    seed
        Of the draws.
    advance
        Called with the number of finished draws of a bootstrap.

    Returns
    -------
    Uncertainty
        Standard deviation, 90 % interval and whether moments determine it, of each parameter in its unit; and
        a band about the modelled moments of every cycle. What is wrong with the model itself is in none of
        them, but for what residuals show.

    Raises
    ------
    KeyboardInterrupt
        If a bootstrap is stopped; the calibration's journal, where it has one, keeps what was done.
    """
    if way not in WAYS:
        raise ValueError(f"unknown way '{way}': expected one of {', '.join(WAYS)}")
    count = DRAWS[way] if draws is None else draws
    if count < 2:
        raise ValueError(f"{count} draws have no spread: expected at least 2")
    solution = calibration.result.solution
    problem, speeds = _problem(calibration)
    judged = posterior(problem, solution.state, speeds)
    converged = count
    if way == "laplace":
        found = judged.laplace(count, seed)
    else:
        found, statuses = randomized_refits(
            judged,
            calibration.result.solver,
            count,
            seed,
            checkpoints=calibration.checkpoints,
            advance=advance,
        )
        converged = sum(status.converged for status in statuses)
    before = judged.sample_prior(_PRIOR_DRAWS, seed)
    spreads = []
    for number, leg in enumerate(calibration.legs):
        own, place = leg_objectives(problem)[number]
        bands = _linear_band if way == "laplace" else _modelled_band
        low, high = bands(leg, own, judged.solution[place], found[:, place])
        spreads.append(
            _leg_spread(way, judged, number, own.variables, place, found, before, converged, low, high)
        )
    return Uncertainty(calibration, way, tuple(spreads))


def _problem(
    calibration: Calibration,
) -> tuple[AbstractCalibration, list[Float[np.ndarray, " trial"]]]:
    """Give what was minimised, and the speeds of each leg's cycles."""
    problems = [leg.result.solution.problem for leg in calibration.legs]
    objectives = [problem for problem in problems if isinstance(problem, Objective)]
    speeds = [leg.subject.trials.used_for("calibration").speeds for leg in calibration.legs]
    if len(objectives) == 1:
        return objectives[0], speeds
    return join_leg_objectives(*objectives), speeds


def _leg_spread(
    way: str,
    judged: Posterior,
    number: int,
    variables: Variables,
    place: Int[np.ndarray, " own"],
    found: Float[np.ndarray, "draw variable"],
    before: Float[np.ndarray, "_ variable"],
    converged: int,
    low: Float[np.ndarray, "trial coordinate frame"],
    high: Float[np.ndarray, "trial coordinate frame"],
) -> LegSpread:
    scale = np.asarray(variables.scale).ravel()[np.asarray(variables.places)[0]]
    names = [label.rsplit(".", 1)[1] for label in variables.labels]
    offset = np.array(
        [NOMINAL[WRAP_PARAMETERS.index(name)] if name in WRAP_PARAMETERS else 0.0 for name in names]
    )
    draws, prior = (offset + scale * one[:, place] for one in (found, before))
    noise = judged.noise[number]
    return LegSpread(
        way=way,
        parameters=summarize_draws(
            draws,
            prior,
            offset + scale * judged.solution[place],
            judged.at_bound[place],
            variables.labels,
            tuple(map(_unit, names)),
        ),
        draws=draws,
        converged=converged,
        low=low,
        high=high,
        noise=noise.deviation,
        independent_samples=noise.independent,
        information=judged.information,
    )


def _unit(name: str) -> str:
    """Of a muscle's parameter, a cylinder's, or a mode of a path."""
    if name in QUANTITIES:
        return QUANTITIES[name].unit
    return {"m": "m", "rad": "rad"}.get(name.rsplit("_", 1)[-1], "1")


def _linear_band(
    leg: Calibration,
    problem: Objective,
    solution: Float[np.ndarray, " variable"],
    draws: Float[np.ndarray, "draw variable"],
) -> tuple[np.ndarray, np.ndarray]:
    """As far as moments are straight: what draws go along a flat valley, they go along its tangent."""
    everything = _over_all_cycles(leg, problem)
    _, slopes = moments_and_slopes(everything, jnp.asarray(solution))
    rows = np.asarray(slopes) * (float(everything.moment_error) * np.sqrt(everything.measured.size))
    moves = (draws - solution) @ rows.T
    low, high = np.percentile(moves, [5.0, 95.0], axis=0).reshape(2, *everything.measured.shape)
    return leg.result.modelled + low, leg.result.modelled + high


def _modelled_band(
    leg: Calibration,
    problem: Objective,
    solution: Float[np.ndarray, " variable"],
    draws: Float[np.ndarray, "draw variable"],
) -> tuple[np.ndarray, np.ndarray]:
    everything = _over_all_cycles(leg, problem)
    moments = np.stack([np.asarray(_moments_of(everything, jnp.asarray(draw))) for draw in draws])
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
    """Take validation cycles in, without what restrains parameters."""
    subject, trials = leg.subject, leg.subject.trials
    paths = leg.fit.paths(subject, trials, leg.result.freedom)
    return replace(
        problem,
        recording=recording(subject, trials, paths),
        measured=jnp.asarray(trials.moments),
        penalties=(),
        limits=(),
    )
