"""``calibrate``: fit a subject's model to its recorded moments.

The model that a calibration found, as a file that OpenSim opens.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.problem import build_stages, fit_for_methods
from wrapjax.calibration.result import CalibrationResult
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.checkpoints import Checkpoints
from wrapjax.calibration.solvers.interface import AbstractCalibration, Status
from wrapjax.calibration.solvers.multistart import (
    IterationCallback,
    Outcome,
    best_start,
    solve_from_starts,
    starting_points,
)
from wrapjax.calibration.two_legs import (
    LegSetup,
    MuscleOptions,
    build_leg_setups,
    calibration_fingerprint,
    join_leg_objectives,
    leg_solution,
)
from wrapjax.geometry.wrapping import NOMINAL
from wrapjax.io.files import cache_folder
from wrapjax.io.model_file import MuscleParameters, read_model_file
from wrapjax.model.forward import muscle_states
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import with_path_modes
from wrapjax.osim.model import describe_model
from wrapjax.osim.personalised_model import MuscleConstants, write_personalised_model
from wrapjax.path_sources.exact import SURFACES, ExactGeometry
from wrapjax.path_sources.model_inputs import recording
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import STRATEGIES
from wrapjax.subject.subject import Subject
from wrapjax.subject.synergies import DEFAULT_SYNERGIES

if TYPE_CHECKING:
    from xarray import Dataset


def write_calibrated_model(subject: Subject, result: CalibrationResult, file: Path) -> None:
    """Write a subject's model with its cylinders and muscles as calibrated.

    Parameters
    ----------
    subject, result
        What was calibrated, and what came of it. Cylinders that were held stay as they are. Driven muscles
        get all constants that the calibration had, those too that it held; others of the leg get what the
        subject says of them, where that is not what the model says.
    file
        Where to; written whole or not at all.
    """
    wraps = {}
    if result.freedom.wraps is not None:
        values = NOMINAL + result.freedom.wraps.changes_of(np.asarray(result.parameters.path_changes))
        wraps = dict(zip(result.freedom.wraps.names, map(tuple, values.tolist()), strict=True))
    muscles = dict(_undriven(subject)) | dict(_constants(_calibrated(result)))
    write_personalised_model(subject.model_file, file, wraps, muscles)


def _calibrated(result: CalibrationResult) -> MuscleParameters:
    found = result.parameters
    return MuscleParameters(
        names=result.muscles,
        max_isometric_force=np.asarray(found.max_isometric_force),
        optimal_fiber_length=np.asarray(found.optimal_fiber_length),
        tendon_slack_length=np.asarray(found.tendon_slack_length),
        pennation_angle=np.asarray(found.pennation_angle),
    )


def _undriven(subject: Subject) -> Iterator[tuple[str, MuscleConstants]]:
    """Give constants of muscles that nothing drives, where the subject's table differs from its model."""
    if subject.undriven_parameters is None:
        return
    in_model = dict(_constants(read_model_file(subject.model_file).muscles))
    for name, constants in _constants(subject.undriven_parameters):
        if constants != in_model[name]:
            yield name, constants


def _constants(muscles: MuscleParameters) -> Iterator[tuple[str, MuscleConstants]]:
    columns = (
        muscles.optimal_fiber_length,
        muscles.tendon_slack_length,
        muscles.max_isometric_force,
        muscles.pennation_angle,
    )
    for name, *values in zip(muscles.names, *(column.tolist() for column in columns), strict=True):
        yield name, MuscleConstants(*values)


#: Starts of a calibration that does not ask for another number.
STARTS = 4


@dataclass(frozen=True)
class Calibration:
    """A finished calibration of a leg."""

    subject: Subject
    fit: Fit | ExactGeometry
    result: CalibrationResult
    #: The person's other leg, where both were calibrated together.
    other_leg: Calibration | None = None
    #: Where the work is kept until it is saved.
    checkpoints: Checkpoints | None = None

    @property
    def legs(self) -> tuple[Calibration, ...]:
        """This leg, and the other one if both were calibrated together."""
        return (self,) if self.other_leg is None else (self, self.other_leg)

    @property
    def status(self) -> Status:
        """Why the solver stopped; of two legs, for both."""
        return self.result.solution.status

    @property
    def dataset(self) -> Dataset:
        """This leg's curves and parameters as an `xarray.Dataset`, every variable with its unit."""
        from wrapjax.report.labelled_arrays import calibration_dataset

        return calibration_dataset(self.result)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the run's folder: summary, parameters, curves and report; ``other_leg/`` within it."""
        from wrapjax.report.run_folder import write_run

        legs = [(leg.subject, leg.result) for leg in self.legs]
        write_run(
            legs,
            Path(folder),
            force=force,
            describe_model=describe_model,
            write_calibrated_model=write_calibrated_model,
        )
        if self.checkpoints is not None:
            self.checkpoints.close()


def calibrate(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    freedom: Freedom | None = None,
    *,
    solver: AugmentedLagrangian | None = None,
    starts: int = STARTS,
    seed: int = 0,
    callback: IterationCallback | None = None,
    curves: str = "paper",
    tendon: str = "rigid",
    surfaces: str = SURFACES[0],
    undriven: str = STRATEGIES[0],
    synergies: int = DEFAULT_SYNERGIES,
    checkpoints: Path | None = None,
    resume: bool = False,
) -> Calibration:
    """Calibrate a subject's model on its trials marked ``calibration``.

    Where the subject names its ``other_leg``, both legs are calibrated together: muscles of the same name
    share activation constants and the ratios of fiber and slack lengths to the model's. Delays, EMG scales
    and paths are each leg's own. To calibrate one leg alone, take the key out of ``subject.toml``, or
    `dataclasses.replace` it by None.

    Parameters
    ----------
    subject
        From `load_subject`.
    method
        What is adjusted: ``NGA``, nothing of the geometry; ``SGA``, the polynomials of all muscle
        paths; ``LSGA``, those of muscles that touch a wrapping surface; ``PGA``, the place, turn and
        size of the cylinders that muscles touch.
    fit
        Source of the paths: from `wrapjax.fit`, made (or found in the cache) if not given; or from
        `wrapjax.exact_geometry`. The other leg's are always made, in the same way.
    freedom
        Another selection of what may move, with its own bounds and priors; for one leg alone.
    solver
        Tolerances and limits.
    starts
        How many: the model's own values, then random ones. Several minima are normal here.
    seed
        Start number n is made from ``seed + n``.
    callback
        Called with the number of the start, the iteration and the state after each iteration; raise
        `KeyboardInterrupt` to stop with the best so far.
    curves
        Hill curves: ``paper`` (as published) or ``opensim`` (the later refit).
    tendon
        ``rigid`` (as published), or ``compliant``: in equilibrium with the fibers at every frame, 4 %
        longer at maximum isometric force. That takes several times as long.
    surfaces
        Which cylinders PGA moves: ``touched``, those that some muscle lies on in a recorded frame, or
        ``all``; of a cylinder that stays out of reach moments say nothing, and it stays where it is.
    undriven, synergies
        What drives muscles without an electrode, and how many synergies where they do; see
        `wrapjax.path_sources.undriven_muscles.apply_undriven_strategy`.
    journal
        Folder in which to keep where the work stands, so that it can be resumed; removed when the
        result is saved.
    resume
        Go on with the journal's work instead of beginning anew.

    Returns
    -------
    Calibration
        Whether it converged is in ``status``; a fit that did not is returned, not raised.
    """
    solver = solver or AugmentedLagrangian()
    legs = build_leg_setups(subject, fit, method, freedom, undriven, synergies, surfaces)
    law = MuscleOptions(curves, tendon)
    question = calibration_fingerprint(legs, solver, law, starts, seed)
    by_leg = [
        build_stages(leg.subject, method, leg.fit, leg.freedom, curves=curves, tendon=tendon) for leg in legs
    ]
    problems: tuple[AbstractCalibration, ...] = by_leg[0]
    if len(legs) == 2:
        problems = tuple(starmap(join_leg_objectives, zip(*by_leg, strict=True)))
    book = None
    if checkpoints is not None:
        book = Checkpoints.open(checkpoints, question, resume=resume)
    first = np.asarray(problems[0].start(problems[0].initial))
    began = time.perf_counter()
    for problem in problems:
        solver.compile(problem, problem.start(problem.initial))
    compiled = time.perf_counter() - began
    outcomes = solve_from_starts(
        problems, starting_points(problems[0], first, starts, seed), solver, callback, book
    )
    finished = []
    for number, leg in enumerate(legs):
        own = outcomes if len(legs) == 1 else _outcomes_of_leg(outcomes, number)
        result = _result(leg, own, best_start(outcomes), solver, law, compiled)
        finished.append(Calibration(leg.subject, leg.fit, result))
    return replace(finished[0], other_leg=finished[1] if len(legs) == 2 else None, checkpoints=book)


def cached_calibration(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    *,
    starts: int = STARTS,
    seed: int = 0,
    callback: IterationCallback | None = None,
) -> Calibration:
    """Calibrate, or recall how the same calibration ended; an interrupted one goes on (see `calibrate`)."""
    fitted = fit_for_methods((method,), subject) if fit is None else fit
    legs = build_leg_setups(subject, fitted, method, None)
    question = calibration_fingerprint(legs, AugmentedLagrangian(), MuscleOptions(), starts, seed)
    checkpoints = cache_folder("calibrations") / question
    begun = (checkpoints / "question.json").exists()
    return calibrate(
        subject,
        method,
        fitted,
        starts=starts,
        seed=seed,
        callback=callback,
        checkpoints=checkpoints,
        resume=begun,
    )


def _outcomes_of_leg(outcomes: tuple[Outcome, ...], leg: int) -> tuple[Outcome, ...]:
    cut = [(outcome, leg_solution(outcome.solution, leg)) for outcome in outcomes]
    return tuple(replace(outcome, solution=solution) for outcome, solution in cut)


def _result(
    leg: LegSetup,
    outcomes: tuple[Outcome, ...],
    chosen: int,
    solver: AugmentedLagrangian,
    law: MuscleOptions,
    compile_seconds: float,
) -> CalibrationResult:
    subject, fit, freedom = leg.subject, leg.fit, leg.freedom
    solution = outcomes[chosen].solution
    problem = solution.problem  # of an earlier stage, if it was interrupted there
    assert isinstance(problem, Objective)
    trials = subject.trials
    paths = fit.paths(subject, trials, freedom)
    everything = recording(subject, trials, paths)
    found = problem.parameters(jnp.asarray(solution.variables))
    terms = eqx.filter_jit(problem.terms)(found)
    initial, parameters = (
        with_path_modes(tree, paths.modes_count) for tree in (problem.variables.base, found)
    )
    run = eqx.filter_jit(muscle_states)
    states = run(problem.curves, parameters, everything, problem.alterations)
    initial_states = run(problem.curves, initial, everything, problem.alterations)
    stuck = (solution.variables <= problem.lower) | (solution.variables >= problem.upper)
    return CalibrationResult(
        method=freedom.name,
        muscles=subject.muscles.names,
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        uses=trials.uses,
        speeds=trials.speeds,
        time=trials.time,
        initial=initial,
        parameters=parameters,
        freedom=freedom,
        at_bounds=tuple(np.array(problem.variables.labels)[stuck].tolist()),
        labels=problem.variables.labels,
        geometry=fit.geometry if isinstance(fit, Fit) else fit.name,
        paths=fit.surrogate.select_muscles(subject.muscles.names) if isinstance(fit, Fit) else None,
        calibrated_paths=fit.calibrated(subject, freedom, parameters) if isinstance(fit, Fit) else None,
        measured=trials.moments,
        modelled=np.asarray(states.moment.sum(axis=0)),
        initial_modelled=np.asarray(initial_states.moment.sum(axis=0)),
        states=jax.tree.map(np.asarray, states),
        initial_states=jax.tree.map(np.asarray, initial_states),
        cost_by_term={name: float(jnp.sum(rows**2)) for name, rows in terms.items()},
        outcomes=outcomes,
        chosen=chosen,
        curves=law.curves,
        tendon=law.tendon,
        solver=solver,
        n_residuals=problem.measured.size,
        compile_seconds=compile_seconds,
    )
