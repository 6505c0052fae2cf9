"""Time and quality of a calibration: its kernels, its compilation and whole solves, peers beside."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case, moment_residuals, total_cost
from benchmarks.machine import THREAD_VARIABLES
from benchmarks.metric import Metric
from benchmarks.peers import PEERS
from benchmarks.race import Run
from benchmarks.timing import median_seconds
from wrapjax.calibrate import Pace, ProjectedLM
from wrapjax.calibrate.projected_lm import propose_step
from wrapjax.calibrate.solution import SolverState
from wrapjax.model import joint_moments

#: A peer has arrived when its cost is this close to ours, relatively. The problem has several minima
#: less than one percent apart, and which of them an optimizer meets is luck.
ARRIVED = 1e-2


def kernels(case: Case, *, quick: bool = False) -> list[Metric]:
    """Time the forward model and its derivatives; compare the per-muscle Jacobian with a plain one."""
    point = case.start
    forward = case.compiled(
        lambda problem, x: joint_moments(problem.curves, problem.variables.unpack(x), problem.recording)
    )
    cost = case.compiled(total_cost)
    gradient = case.compiled(jax.grad(total_cost, argnums=1))
    linearize = case.compiled(lambda problem, x: problem.linearize(x))
    by_muscle = case.compiled(lambda problem, x: problem.moment_jacobian(x))
    plain = case.compiled(jax.jacfwd(moment_residuals, argnums=1))
    state = SolverState(point, linearize(point), Pace(jnp.asarray(1e-4), jnp.asarray(2.0)))
    hessian = state.linearization.gauss_newton + state.linearization.remainder
    bounds = jnp.asarray(case.problem.lower), jnp.asarray(case.problem.upper)
    seconds = median_seconds(
        {
            "forward_model": lambda: forward(point),
            "cost": lambda: cost(point),
            "gradient": lambda: gradient(point),
            "linearization": lambda: linearize(point),
            "step": lambda: propose_step(state, hessian, *bounds),
            "jacobian_by_muscle": lambda: by_muscle(point),
            "jacobian_plain": lambda: plain(point),
        },
        repeats=5 if quick else 21,
    )
    notes = {
        "forward_model": f"{case.size}; EMG to joint moments",
        "cost": "all terms",
        "gradient": "jax.grad of the cost",
        "linearization": "cost, gradient and exact Hessian of all terms",
        "step": "to the minimum of the damped quadratic model within bounds",
        "jacobian_by_muscle": "of the moment residuals",
        "jacobian_plain": "the same by jax.jacfwd",
    }
    found, expected = np.asarray(by_muscle(point)), np.asarray(plain(point))
    return [
        *(Metric(f"kernels/{name}", 1e3 * seconds[name], "ms", "lower", notes[name]) for name in notes),
        Metric(
            "kernels/jacobian_speedup",
            seconds["jacobian_plain"] / seconds["jacobian_by_muscle"],
            "x",
            "higher",
            "plain over by muscle; target at least 20",
        ),
        Metric(
            "kernels/jacobian_difference",
            float(np.abs(found - expected).max()),
            "1",
            "lower",
            f"largest entry {np.abs(expected).max():.3g}",
        ),
    ]


def compilation(case: Case) -> list[Metric]:
    """Time the first calibration in a new process: with an empty compilation cache, then with a full one.

    These run as a user runs them, on all cores.
    """
    with tempfile.TemporaryDirectory() as folder:
        case.fit.save(Path(folder) / "fit")
        environment = {key: value for key, value in os.environ.items() if key not in THREAD_VARIABLES}
        environment |= {
            "JAX_ENABLE_X64": "1",
            "JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "compiled"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
        }
        words = [
            sys.executable,
            "-m",
            "benchmarks.first_calibration",
            case.subject.folder,
            Path(folder) / "fit",
        ]
        first, cached = (
            json.loads(subprocess.run(words, env=environment, check=True, capture_output=True).stdout)
            for _ in range(2)
        )
    metrics = []
    for name, seconds, target in (("first", first, 20), ("cached", cached, 3)):
        place = "empty compilation cache" if name == "first" else "kernels from the cache"
        metrics += [
            Metric(f"compile/{name}_prepare", seconds["prepare"], "s", "lower", f"problem set-up, {place}"),
            Metric(
                f"compile/{name}",
                seconds["compile"],
                "s",
                "lower",
                f"solver, {place}; target at most {target}",
            ),
            Metric(
                f"compile/{name}_solve", seconds["solve"], "s", "lower", "first solve after it, all cores"
            ),
        ]
    return metrics


def solves(case: Case, *, quick: bool = False, limit: float = 120.0) -> list[Metric]:
    """Solve NGA with our solver and with peers, from one start; quality beside time.

    No peer runs longer than ``limit`` seconds.
    """
    ours = _our_run(case, repeats=2 if quick else 5)
    metrics = _metrics(case, ours)
    for name, solve in PEERS.items():
        try:
            run = solve(case, limit)
        except ImportError as error:
            metrics.append(Metric(f"solve/{name}", np.nan, "s", "lower", f"not installed: {error.name}"))
            continue
        metrics += _metrics(case, run) + [_speedup(ours, run)]
    return metrics


def _our_run(case: Case, repeats: int) -> Run:
    solver = ProjectedLM()
    solver.compile(case.problem, case.start)
    # The first solve may still compile what only the second step needs; it is not timed.
    solver.solve(case.problem, case.start)
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        solution = solver.solve(case.problem, case.start)
        seconds.append(time.perf_counter() - began)
    trace = tuple((one.seconds, one.cost) for one in solution.history)
    return Run(
        name="wrapjax",
        seconds=float(np.median(seconds)),
        cost=solution.cost,
        variables=solution.variables,
        trace=trace,
        message=f"{solution.iterations} iterations; {solution.status.value}",
    )


def _metrics(case: Case, run: Run) -> list[Metric]:
    prefix = f"solve/{run.name}"
    errors = case.moment_mae(run.variables)
    return [
        Metric(prefix, run.seconds, "s", "lower", run.message),
        Metric(f"{prefix}/cost", run.cost, "1", "lower", ""),
        *(Metric(f"{prefix}/mae_{use}", error, "N m", "lower", "") for use, error in errors.items()),
    ]


def _speedup(ours: Run, peer: Run) -> Metric:
    """Peer's time to come near our cost, over the time of our whole solve."""
    arrival = peer.arrival(ours.cost * (1.0 + ARRIVED))
    seconds = peer.seconds if arrival is None else arrival
    note = "its time to within 1 % of our cost, over our time to the end"
    if arrival is None:
        note = f"at least: it never came within 1 % of our cost (best {peer.cost:.5g} to {ours.cost:.5g})"
    return Metric(f"solve/{peer.name}/slower", seconds / ours.seconds, "x", "higher", note)
