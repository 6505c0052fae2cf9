"""``calibrate`` and ``objective``: fit a subject's model to its recorded moments."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.api.assembly import group_indices, model_parameters, recording, surrogate_paths
from wrapjax.api.fitting import Fit
from wrapjax.api.fitting import fit as fit_paths
from wrapjax.calibrate import (
    CalibrationResult,
    Iteration,
    Objective,
    ProjectedLM,
    Status,
    pipeline_penalties,
)
from wrapjax.calibrate.projected_lm import SolverState
from wrapjax.errors import InputError, Problem
from wrapjax.model import Freedom, ModelParameters, free_variables, muscle_states, nga
from wrapjax.muscle import HILL_CURVES
from wrapjax.precision import require_float64
from wrapjax.subject import Subject

#: Ways of adjusting a model, by the names of Ao, Fregly et al.
METHODS: dict[str, Callable[[ModelParameters], Freedom]] = {"NGA": nga}


@dataclass(frozen=True)
class Calibration:
    """A finished calibration of a subject."""

    subject: Subject
    fit: Fit
    result: CalibrationResult

    @property
    def status(self) -> Status:
        """Why the solver stopped."""
        return self.result.solution.status

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the run's folder: summary, parameters, curves and report."""
        from wrapjax.report.run_folder import write_run

        write_run(self.subject, self.result, Path(folder), force=force)


def prepare(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | None = None,
    freedom: Freedom | None = None,
    *,
    curves: str = "paper",
) -> Objective:
    """Build what `calibrate` minimises.

    Parameters
    ----------
    subject
        From `load_subject`.
    method
        One of `METHODS`; ignored where ``freedom`` is given.
    fit
        From `wrapjax.fit`; made (or found in the cache) if not given.
    freedom
        What may move, with bounds and priors.
    curves
        Hill curves: ``paper`` or ``opensim``.
    """
    require_float64()
    trials = subject.trials.used_for("calibration")
    if not trials.names:
        raise InputError(
            Problem(str(subject.folder / "subject.toml"), 'no trial is marked use = "calibration"')
        )
    base = model_parameters(subject)
    inputs = recording(subject, trials, surrogate_paths(_fitted(subject, fit).surrogate, subject, trials))
    names = subject.muscles.names
    reference = eqx.filter_jit(muscle_states)(HILL_CURVES[curves], base, inputs)
    return Objective(
        curves=HILL_CURVES[curves],
        recording=inputs,
        measured=jnp.asarray(trials.moments),
        variables=free_variables(base, freedom or _freedom(method, base), names),
        penalties=pipeline_penalties(
            reference,
            group_indices(subject.activation_groups, names),
            group_indices(subject.fiber_length_groups, names),
        ),
    )


def objective(
    subject: Subject, method: str = "NGA", fit: Fit | None = None
) -> Callable[[ModelParameters], Float[Array, ""]]:
    """Give the calibration's cost as a pure jitted function of the parameter tree.

    Use it with `jax.grad`, `jax.jit` and `jax.vmap`; `wrapjax.api.assembly.model_parameters` gives the
    tree to start from.

    Examples
    --------
    >>> cost = objective(subject, "NGA")  # doctest: +SKIP
    >>> slopes = jax.grad(cost)(model_parameters(subject))  # doctest: +SKIP
    """
    return eqx.filter_jit(prepare(subject, method, fit).cost)


def calibrate(
    subject: Subject,
    method: str = "NGA",
    fit: Fit | None = None,
    freedom: Freedom | None = None,
    *,
    solver: ProjectedLM | None = None,
    callback: Callable[[Iteration, SolverState], None] | None = None,
    curves: str = "paper",
) -> Calibration:
    """Calibrate a subject's model on its trials marked ``calibration``.

    Parameters
    ----------
    subject
        From `load_subject`.
    method
        What is adjusted: ``NGA``, nothing of the geometry.
    fit
        Fitted paths, from `wrapjax.fit`; made (or found in the cache) if not given.
    freedom
        Another selection of what may move, with its own bounds and priors.
    solver
        Tolerances and limits.
    callback
        Called after each iteration; raise `KeyboardInterrupt` to stop with the best so far.
    curves
        Hill curves: ``paper`` (as published) or ``opensim`` (the later refit).

    Returns
    -------
    Calibration
        Whether it converged is in ``status``; a fit that did not is returned, not raised.
    """
    fitted = _fitted(subject, fit)
    problem = prepare(subject, method, fitted, freedom, curves=curves)
    solver = solver or ProjectedLM()
    start = problem.variables.start()
    began = time.perf_counter()
    solver.compile(problem, start)
    compiled = time.perf_counter() - began
    solution = solver.solve(problem, start, callback)

    solved = jnp.asarray(solution.variables)
    parameters = problem.variables.unpack(solved)
    trials = subject.trials
    everything = recording(subject, trials, surrogate_paths(fitted.surrogate, subject, trials))
    run = eqx.filter_jit(muscle_states)
    states = run(problem.curves, parameters, everything)
    initial_states = run(problem.curves, problem.variables.base, everything)
    stuck = (solution.variables <= problem.lower) | (solution.variables >= problem.upper)
    terms = problem.terms(parameters)
    result = CalibrationResult(
        method=freedom.name if freedom else method,
        muscles=subject.muscles.names,
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        uses=trials.uses,
        speeds=trials.speeds,
        time=trials.time,
        initial=problem.variables.base,
        parameters=parameters,
        freedom=freedom or _freedom(method, problem.variables.base),
        at_bounds=tuple(np.array(problem.variables.labels)[stuck].tolist()),
        measured=trials.moments,
        modelled=np.asarray(states.moment.sum(axis=0)),
        initial_modelled=np.asarray(initial_states.moment.sum(axis=0)),
        states=jax.tree.map(np.asarray, states),
        initial_states=jax.tree.map(np.asarray, initial_states),
        cost_by_term={name: float(jnp.sum(rows**2)) for name, rows in terms.items()},
        solution=solution,
        curves=curves,
        solver=solver,
        n_residuals=problem.measured.size,
        compile_seconds=compiled,
    )
    return Calibration(subject, fitted, result)


def _fitted(subject: Subject, fit: Fit | None) -> Fit:
    return fit_paths(subject) if fit is None else fit


def _freedom(method: str, base: ModelParameters) -> Freedom:
    if method not in METHODS:
        raise ValueError(f"unknown method '{method}': expected one of {', '.join(METHODS)}")
    return METHODS[method](base)
