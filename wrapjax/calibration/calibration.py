"""Calibration of a subject's model to measured joint moments (``calibrate``), and its model file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.objective import Objective
from wrapjax.calibration.problem import (
    LegSetup,
    MuscleOptions,
    build_leg_setups,
    build_stages,
    calibration_fingerprint,
    fit_for_methods,
)
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.checkpoints import Checkpoints
from wrapjax.calibration.solvers.external_solvers import constrained_solver
from wrapjax.calibration.solvers.interface import AbstractBoundedSolver, AbstractCalibration, Status
from wrapjax.calibration.solvers.multistart import (
    IterationCallback,
    Outcome,
    best_start,
    solve_from_starts,
    starting_points,
)
from wrapjax.calibration.two_legs import join_leg_objectives, leg_solution
from wrapjax.errors import InputError, Problem
from wrapjax.io.model_file import MuscleParameters, read_model_file
from wrapjax.io.store import Store
from wrapjax.model.forward import muscle_states
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import with_path_modes
from wrapjax.muscle.published_laws import GIVEN_LAW
from wrapjax.osim.model import describe_model
from wrapjax.osim.personalised_model import MuscleConstants, write_personalised_model
from wrapjax.path_sources.exact import SURFACES, ExactGeometry
from wrapjax.path_sources.model_inputs import recording
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import STRATEGIES
from wrapjax.renamed import renamed_arguments
from wrapjax.subject.subject import Subject
from wrapjax.subject.synergies import DEFAULT_SYNERGIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset


#: Default number of starting points.
STARTS = 4


@dataclass(frozen=True)
class Calibration:
    """Finished calibration of a leg.

    Parameters
    ----------
    subject
        Subject that was calibrated, with its undriven muscles where synergies drive them.
    fit
        Source of the muscle paths.
    result
        Calibrated parameters, curves and solver output.
    other_leg
        Calibration of the subject's other leg, if both were calibrated together.
    checkpoints
        Checkpoints of the calibration, deleted by `save`; None without any.
    """

    subject: Subject
    fit: Fit | ExactGeometry
    result: CalibrationResult
    other_leg: Calibration | None = None
    checkpoints: Checkpoints | None = None

    @property
    def legs(self) -> tuple[Calibration, ...]:
        """Calibrations of the legs that were calibrated together, this one first."""
        return (self,) if self.other_leg is None else (self, self.other_leg)

    @property
    def status(self) -> Status:
        """Reason why the solver stopped; the same for legs that were calibrated together."""
        return self.result.solution.status

    def to_dataset(self) -> Dataset:
        """Return curves and parameters of this leg as an `xarray.Dataset`, with units."""
        from wrapjax.report.labelled.arrays import calibration_dataset

        return calibration_dataset(self.result)

    def summary(self) -> dict[str, Any]:
        """Return the content of ``summary.json``: errors (N m) by use and coordinate, convergence, limits."""
        from wrapjax.report.calibration.run_summary import summarize

        return summarize(self.subject, self.result)

    def plot_moments(self) -> Figure:
        """Draw measured and modelled moments (N m) over the gait cycle."""
        from wrapjax.report.calibration.calibration_curves import moment_figure

        return moment_figure(self.result)

    def plot_activations(self) -> Figure:
        """Draw the activation of every muscle over the gait cycle."""
        from wrapjax.report.calibration.calibration_curves import activation_figure, driving_signals

        return activation_figure(self.result, driving_signals(self.subject, self.result))

    def plot_fiber_lengths(self) -> Figure:
        """Draw the normalised fiber length of every muscle over the gait cycle."""
        from wrapjax.report.calibration.calibration_curves import fiber_length_figure

        return fiber_length_figure(self.result)

    def plot_moment_arms(self) -> Figure:
        """Draw the moment arms (mm) that calibration changed most, before and after.

        Raises
        ------
        InputError
            If no moment arm changed, as in NGA.
        """
        from wrapjax.report.paths.path_views import largest_changes, moment_arm_figure

        if not largest_changes(self.result):
            message = f"no moment arm to draw: {self.result.method} changed none"
            raise InputError(Problem(self.subject.name, message))
        return moment_arm_figure(self.result)

    def plot_cost(self) -> Figure:
        """Draw the cost over the iterations of every start."""
        from wrapjax.report.calibration.parameters_and_solver import history_figure

        return history_figure(self.result)

    def save(self, folder: str | Path, *, force: bool = False, motion: bool = False) -> None:
        """Write the folder of the run: summary, parameters, curves, model and report.

        Parameters
        ----------
        folder
            Folder to create; the other leg, if any, is in its subfolder ``other_leg``.
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

        legs = [(leg.subject, leg.result) for leg in self.legs]
        write_run(
            legs,
            Path(folder),
            force=force,
            describe_model=describe_model,
            write_calibrated_model=write_calibrated_model,
            motion=motion,
        )
        if self.checkpoints is not None:
            self.checkpoints.close()


@renamed_arguments(journal="checkpoints")
def calibrate(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    freedom: Freedom | None = None,
    *,
    solver: AugmentedLagrangian
    | AbstractBoundedSolver
    | optx.AbstractLeastSquaresSolver
    | optx.AbstractMinimiser
    | Callable[..., Any]
    | None = None,
    starts: int = STARTS,
    seed: int = 0,
    callback: IterationCallback | None = None,
    curves: str = "paper",
    tendon: str = "rigid",
    muscle_law: str = GIVEN_LAW,
    surfaces: str = SURFACES[0],
    undriven: str = STRATEGIES[0],
    synergies: int = DEFAULT_SYNERGIES,
    checkpoints: Path | None = None,
    resume: bool = False,
) -> Calibration:
    """Calibrate a subject's model to the measured joint moments of its trials marked ``calibration``.

    The objective is the sum of mean squared errors of the joint moments, penalties and priors (`Objective`).
    If the subject has an ``other_leg``, both legs are calibrated together: muscles of the same name share
    activation constants and the ratios of fiber and slack lengths to the model's; delays, EMG scales and
    paths are separate. To calibrate one leg alone, remove ``other_leg`` from ``subject.toml``, or set it to
    None with `dataclasses.replace`.

    Parameters
    ----------
    subject
        Subject from `load_subject`.
    method
        Parameters that are adjusted in addition to EMG-to-activation parameters and fiber and slack lengths
        (Ao, Fregly et al.): ``NGA``, none; ``SGA``, the polynomials of all muscle paths; ``LSGA``, those of
        muscles that touch a wrap; ``PGA``, translations, rotations and radii of wraps. Ignored where
        ``freedom`` is given.
    fit
        Source of the muscle paths: polynomials from `wrapjax.fit`, computed or taken from the cache if not
        given, or paths from `wrapjax.exact_geometry`. Those of the other leg are always computed, by a source
        of the same kind.
    freedom
        Custom selection of parameters, with bounds and priors; for one leg alone.
    solver
        Solver with its tolerances: `AugmentedLagrangian`, with the defaults if not given, or one that it uses
        for problems within bounds: `AbstractBoundedSolver`, any least-squares solver or minimiser of
        optimistix, whose variables are substituted to stay within bounds (`OptimistixSolver`), or a class of
        jaxopt, or a partial of it (`JaxoptSolver`).
    starts
        Number of starting points: the values of the model, then random ones. Several minima are common.
    seed
        Seed of the random starting points; start number n has ``seed + n``.
    callback
        Called after each iteration with the number of the start, the iteration and the solver's state; raise
        `KeyboardInterrupt` in it to stop with the best result so far.
    curves
        Hill curves: ``paper`` (as published), ``opensim`` (a later refit), or a name that was added to
        `HILL_CURVES`.
    tendon
        ``rigid`` (as published), or ``compliant``: in equilibrium with the fibers in every frame, with a
        strain of 4 % at maximum isometric force. A compliant tendon takes several times as long.
    muscle_law
        Published muscle law, by its nearest point in the family of `wrapjax.muscle.personal_law`: ``nmsm``,
        that of the Hill curves as they are; ``de_groote``; ``thelen``; ``ceinms``.
    surfaces
        Wraps that PGA frees: ``touched``, those that some muscle touches in a recorded frame, or ``all``.
        Moments do not depend on a wrap that no muscle touches, so that it keeps its nominal parameters.
    undriven, synergies
        Strategy for muscles without an electrode, and number of synergies; see
        `wrapjax.path_sources.undriven_muscles.apply_undriven_strategy`.
    checkpoints
        Folder for checkpoints, from which an interrupted calibration can be resumed; it is deleted when the
        result is saved.
    resume
        Continue from the checkpoints instead of starting again.

    Returns
    -------
    Calibration
        Result with the lowest cost of all starts. Whether it converged is in its ``status``; a result that
        did not converge is returned as well.

    Raises
    ------
    InputError
        If there is no trial marked ``calibration``, ``fit`` is not one of the subject, the method has nothing
        to free, or checkpoints to resume are missing or those of another calibration.
    ValueError
        If an option is unknown, or a custom freedom is given for two legs.

    Examples
    --------
    >>> subject = load_subject("subject")  # doctest: +SKIP
    >>> calibration = calibrate(subject, "SGA", starts=4)  # doctest: +SKIP
    >>> calibration.status.converged, calibration.result.parameters.emg_scale  # doctest: +SKIP
    >>> calibration.save("run")  # doctest: +SKIP
    """
    solver = constrained_solver(solver)
    options = MuscleOptions(curves, tendon, muscle_law)
    legs = build_leg_setups(subject, fit, method, freedom, undriven, synergies, surfaces)
    fingerprint = calibration_fingerprint(legs, solver, options, starts, seed)
    by_leg = [
        build_stages(
            leg.subject,
            method,
            leg.fit,
            leg.freedom,
            curves=curves,
            tendon=tendon,
            muscle_law=muscle_law,
        )
        for leg in legs
    ]
    problems: tuple[AbstractCalibration, ...] = by_leg[0]
    if len(legs) == 2:
        problems = tuple(starmap(join_leg_objectives, zip(*by_leg, strict=True)))
    opened = None
    if checkpoints is not None:
        opened = Checkpoints.open(checkpoints, fingerprint, resume=resume)
    first = np.asarray(problems[0].start(problems[0].initial))
    started = time.perf_counter()
    for problem in problems:
        solver.compile(problem, problem.start(problem.initial))
    compiled = time.perf_counter() - started
    outcomes = solve_from_starts(
        problems, starting_points(problems[0], first, starts, seed), solver, callback, opened
    )
    finished = []
    for number, leg in enumerate(legs):
        leg_outcomes = outcomes if len(legs) == 1 else _outcomes_of_leg(outcomes, number)
        result = _result(leg, leg_outcomes, best_start(outcomes), solver, options, compiled)
        finished.append(Calibration(leg.subject, leg.fit, result))
    return replace(finished[0], other_leg=finished[1] if len(legs) == 2 else None, checkpoints=opened)


def cached_calibration(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | ExactGeometry | None = None,
    *,
    starts: int = STARTS,
    seed: int = 0,
    callback: IterationCallback | None = None,
) -> Calibration:
    """Calibrate with checkpoints in the user's cache, which restore or continue the same calibration.

    Parameters are those of `calibrate`.
    """
    fitted = fit_for_methods((method,), subject) if fit is None else fit
    legs = build_leg_setups(subject, fitted, method, None)
    fingerprint = calibration_fingerprint(legs, AugmentedLagrangian(), MuscleOptions(), starts, seed)
    checkpoints = Store.of_user("calibrations").place(fingerprint)
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
    return tuple(replace(outcome, solution=leg_solution(outcome.solution, leg)) for outcome in outcomes)


def _result(
    leg: LegSetup,
    outcomes: tuple[Outcome, ...],
    chosen: int,
    solver: AugmentedLagrangian,
    options: MuscleOptions,
    compile_seconds: float,
) -> CalibrationResult:
    subject, fit, freedom = leg.subject, leg.fit, leg.freedom
    solution = outcomes[chosen].solution
    problem = solution.problem  # that of an earlier stage after an interruption in it
    assert isinstance(problem, Objective)
    trials = subject.trials
    paths = fit.paths(subject, trials, freedom)
    all_cycles = recording(subject, trials, paths)
    found = problem.parameters(jnp.asarray(solution.variables))
    terms = eqx.filter_jit(problem.terms)(found)
    initial, parameters = (
        with_path_modes(tree, paths.modes_count) for tree in (problem.variables.base, found)
    )
    run = eqx.filter_jit(muscle_states)
    states = run(problem.curves, parameters, all_cycles, problem.alterations)
    initial_states = run(problem.curves, initial, all_cycles, problem.alterations)
    at_bounds = (solution.variables <= problem.lower) | (solution.variables >= problem.upper)
    return CalibrationResult(
        method=freedom.name,
        muscles=subject.muscles.names,
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        uses=trials.uses,
        speeds=trials.speeds,
        tasks=trials.tasks,
        recordings=trials.recordings,
        time=trials.time,
        initial=initial,
        parameters=parameters,
        freedom=freedom,
        at_bounds=tuple(np.array(problem.variables.labels)[at_bounds].tolist()),
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
        curves=options.curves,
        tendon=options.tendon,
        muscle_law=options.law,
        solver=solver,
        n_residuals=int(np.isfinite(trials.used_for("calibration").moments).sum()),
        compile_seconds=compile_seconds,
    )


def write_calibrated_model(subject: Subject, result: CalibrationResult, file: Path) -> None:
    """Write the OpenSim model of a subject with calibrated muscle parameters and wraps.

    Driven muscles have the parameters of the calibration, including those that it held. Undriven muscles of
    the leg have those of the subject's parameter table, where it differs from the model. Wraps that were held
    are unchanged.

    Parameters
    ----------
    subject
        Subject that was calibrated.
    result
        Result of its calibration.
    file
        Model file to write, atomically.
    """
    wraps = {}
    if result.freedom.wraps is not None:
        values = result.freedom.wraps.values_of(np.asarray(result.parameters.path_changes))
        wraps = dict(zip(result.freedom.wraps.names, map(tuple, values.tolist()), strict=True))
    muscles = dict(_undriven_constants(subject)) | dict(_constants(_calibrated_parameters(result)))
    write_personalised_model(subject.model_file, file, wraps, muscles)


def _calibrated_parameters(result: CalibrationResult) -> MuscleParameters:
    found = result.parameters
    return MuscleParameters(
        names=result.muscles,
        max_isometric_force=np.asarray(found.max_isometric_force),
        optimal_fiber_length=np.asarray(found.optimal_fiber_length),
        tendon_slack_length=np.asarray(found.tendon_slack_length),
        pennation_angle=np.asarray(found.pennation_angle),
    )


def _undriven_constants(subject: Subject) -> Iterator[tuple[str, MuscleConstants]]:
    """Iterate over undriven muscles whose parameters differ between the subject's table and its model."""
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
