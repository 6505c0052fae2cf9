"""Run times and compile times of the computations that a calibration consists of."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case, moment_residuals, total_cost
from benchmarks.machine import THREAD_VARIABLES
from benchmarks.metric import Metric
from benchmarks.timing import median_seconds
from wrapjax.calibration.solvers.interface import DampingState, SolverState
from wrapjax.calibration.solvers.levenberg_marquardt import propose_step
from wrapjax.model.forward import joint_moments


def kernels(case: Case, *, quick: bool = False) -> list[Metric]:
    """Time the forward model and its derivatives; compare the Jacobian by muscle with `jax.jacfwd`."""
    point = case.start
    forward = case.compiled(
        lambda problem, x: joint_moments(problem.curves, problem.variables.unpack(x), problem.recording)
    )
    cost = case.compiled(total_cost)
    gradient = case.compiled(jax.grad(total_cost, argnums=1))
    linearize = case.compiled(lambda problem, x: problem.linearize(x))
    by_muscle = case.compiled(lambda problem, x: problem.moment_jacobian(x))
    plain = case.compiled(jax.jacfwd(moment_residuals, argnums=1))
    state = SolverState(point, linearize(point), DampingState(jnp.asarray(1e-4), jnp.asarray(2.0)))
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
        "step": "minimum of the damped quadratic model within bounds",
        "jacobian_by_muscle": "Jacobian of the moment residuals",
        "jacobian_plain": "the same Jacobian by jax.jacfwd",
    }
    by_muscle_jacobian, expected = np.asarray(by_muscle(point)), np.asarray(plain(point))
    return [
        *(Metric(f"kernels/{name}", 1e3 * seconds[name], "ms", "lower", notes[name]) for name in notes),
        Metric(
            "kernels/jacobian_speedup",
            seconds["jacobian_plain"] / seconds["jacobian_by_muscle"],
            "x",
            "higher",
            "time of jax.jacfwd over time by muscle; target at least 20",
        ),
        Metric(
            "kernels/jacobian_difference",
            float(np.abs(by_muscle_jacobian - expected).max()),
            "1",
            "lower",
            f"largest entry of the Jacobian {np.abs(expected).max():.3g}",
            negligible=1e-9,
        ),
    ]


def compilation(case: Case) -> list[Metric]:
    """Time the first calibration in a new process: empty cache, full cache, and XLA's default options.

    The processes use all cores, as they do for a user.
    """
    with tempfile.TemporaryDirectory() as folder:
        case.fit.save(Path(folder) / "fit")
        environment = {key: value for key, value in os.environ.items() if key not in THREAD_VARIABLES}
        environment |= {
            "JAX_ENABLE_X64": "1",
            "JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "compiled"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        usual = {
            "XLA_FLAGS": "--xla_cpu_use_fusion_emitters=true --xla_backend_optimization_level=3 "
            "--xla_backend_extra_options=-disable-lsr=false",
            "JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "usual"),
        }
        words = [
            sys.executable,
            "-m",
            "benchmarks.first_calibration",
            str(case.subject.folder),
            str(Path(folder) / "fit"),
        ]
        runs = {
            name: json.loads(
                subprocess.run(words, env=environment | changed, check=True, capture_output=True).stdout
            )
            for name, changed in (("first", {}), ("cached", {}), ("usual", usual))
        }
    conditions = {
        "first": ("empty compilation cache", "; target at most 20"),
        "cached": ("programs from the compilation cache", "; target at most 3"),
        "usual": ("empty compilation cache, XLA's default options", ""),
    }
    metrics = []
    for name, (condition, target) in conditions.items():
        seconds = runs[name]
        metrics += [
            Metric(
                f"compile/{name}_prepare", seconds["prepare"], "s", "lower", f"problem set-up, {condition}"
            ),
            Metric(f"compile/{name}", seconds["compile"], "s", "lower", f"solver, {condition}{target}"),
            Metric(
                f"compile/{name}_solve",
                seconds["solve"],
                "s",
                "lower",
                f"first solve, {condition}, all cores",
            ),
        ]
    return metrics
