"""Times and moment errors of SGA and LSGA, compared with NGA, one start each."""

from __future__ import annotations

import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import wrapjax
from benchmarks.metric import Metric
from benchmarks.timing import median_seconds
from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.problem import build_stages
from wrapjax.calibration.solvers.interface import DampingState, SolverState
from wrapjax.calibration.solvers.levenberg_marquardt import propose_step
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.subject.subject import Subject

#: Least relative reduction of NGA's mean absolute moment error by each method.
TARGETS = {
    "SGA": {"calibration": 0.35, "validation": 0.24},
    "LSGA": {"calibration": 0.27, "validation": 0.18},
}


def path_methods(subject: Subject, fit: Fit, *, quick: bool = False) -> list[Metric]:
    """Calibrate by NGA, SGA and LSGA; time the kernels of the methods that change paths."""
    metrics = []
    nga: dict[str, float] = {}
    for method in ("NGA", "LSGA") if quick else ("NGA", "SGA", "LSGA"):
        if method != "NGA":
            metrics += _kernels(subject, fit, method)
        began = time.perf_counter()
        result = wrapjax.calibrate(subject, method, fit, starts=1).result
        total = time.perf_counter() - began
        errors = _errors(result)
        nga = nga or errors
        prefix = f"paths/{method}"
        solution = result.solution
        metrics += [
            Metric(prefix, result.solve_seconds, "s", "lower", f"{solution.iterations} iterations; compiled"),
            Metric(f"{prefix}/compile", result.compile_seconds, "s", "lower", f"{total:.1f} s in total"),
            Metric(f"{prefix}/variables", len(result.labels), "1", "higher", solution.status.value),
            Metric(f"{prefix}/cost", solution.cost, "1", "lower", ""),
            Metric(
                f"{prefix}/violation",
                solution.max_violation,
                "1",
                "lower",
                "target at most 1e-6",
                negligible=1e-6,
            ),
        ]
        for use, error in errors.items():
            metrics.append(Metric(f"{prefix}/mae_{use}", error, "N m", "lower", ""))
            if method in TARGETS:
                fall, target = 1.0 - error / nga[use], TARGETS[method][use]
                note = f"below NGA; target at least {100 * target:.0f}"
                metrics.append(Metric(f"{prefix}/fall_{use}", 100.0 * fall, "%", "higher", note))
    return metrics


def _kernels(subject: Subject, fit: Fit, method: str) -> list[Metric]:
    problem = build_stages(subject, method, fit)[-1]
    start = problem.start(problem.variables.base)
    linearize = eqx.filter_jit(lambda problem, x: problem.linearize(x))
    cost = eqx.filter_jit(lambda problem, x: problem.value(x))
    damping_state = DampingState(jnp.asarray(1e-4), jnp.asarray(2.0))
    state = SolverState(start, linearize(problem, start), damping_state)
    hessian = state.linearization.gauss_newton + state.linearization.remainder
    bounds = jnp.asarray(problem.lower), jnp.asarray(problem.upper)
    seconds = median_seconds(
        {
            "cost": lambda: cost(problem, start),
            "linearization": lambda: linearize(problem, start),
            "step": lambda: propose_step(state, hessian, *bounds),
        },
        repeats=7,
    )
    return [
        Metric(f"paths/{method}/{name}", 1e3 * value, "ms", "lower", "") for name, value in seconds.items()
    ]


def _errors(result: CalibrationResult) -> dict[str, float]:
    error = np.abs(result.modelled - result.measured).mean(axis=(1, 2))
    uses = np.array(result.uses)
    return {use: float(error[uses == use].mean()) for use in ("calibration", "validation")}
