"""Page faults and times of calibrations with and without the C library's memory kept.

``python -m benchmarks.page_faults`` solves the last stage of a calibration by each method in processes of
their own, with and without `wrapjax.jax_setup.keep_freed_memory` in turn, and prints medians of the time, of
the user and system parts of the processor's, of page faults, and the largest memory of the process. The costs
must be the same to the last bit.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time

from benchmarks.machine import pin_threads
from benchmarks.subjects import add_subject_argument, default_subject

METHODS = ("NGA", "SGA", "LSGA", "PGA")
KEPT, NOT_KEPT = "kept", "not kept"


def main() -> int:
    options = _parser().parse_args()
    if options.memory:
        print(json.dumps(_solve(options)))
        return 0
    print("| method | memory | time, s | user, s | system, s | page faults | largest, GB | iterations |")
    print("|---|---|---|---|---|---|---|---|")
    with default_subject(options.subject) as subject:
        for method in options.methods:
            runs: dict[str, list[dict]] = {NOT_KEPT: [], KEPT: []}
            for _ in range(options.repeats):
                for memory, so_far in runs.items():
                    so_far.append(_in_process(subject, method, memory, options.iterations))
            if len({run["cost"] for so_far in runs.values() for run in so_far}) != 1:
                print(f"{method}: costs differ between the runs", file=sys.stderr)
                return 1
            for memory, so_far in runs.items():
                middle = {name: statistics.median(run[name] for run in so_far) for name in so_far[0]}
                print(
                    f"| {method} | {memory} | {middle['time']:.1f} | {middle['user']:.1f} "
                    f"| {middle['system']:.2f} | {middle['faults']:.0f} | {middle['largest']:.2f} "
                    f"| {middle['iterations']:.0f} |",
                    flush=True,
                )
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.page_faults", description=__doc__)
    add_subject_argument(parser)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--iterations", type=int, default=25, help="iterations of each solve (default: 25)")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each kind (default: 3)")
    parser.add_argument("--memory", choices=(KEPT, NOT_KEPT), help=argparse.SUPPRESS)
    return parser


def _in_process(subject, method: str, memory: str, iterations: int) -> dict:
    command = [sys.executable, "-m", "benchmarks.page_faults", "--subject", subject, "--methods", method]
    command += ["--memory", memory, "--iterations", iterations]
    done = subprocess.run(list(map(str, command)), check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def _solve(options: argparse.Namespace) -> dict:
    """Solve the last stage of a calibration from the model's values."""
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    from unittest.mock import patch

    from wrapjax import jax_setup

    with patch.object(
        jax_setup, "keep_freed_memory", jax_setup.keep_freed_memory if options.memory == KEPT else os.getpid
    ):
        jax_setup.set_up_jax()
    import wrapjax
    from wrapjax.calibration.problem import build_stages
    from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
    from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt

    (method,) = options.methods
    problem = build_stages(wrapjax.load_subject(options.subject), method)[-1]
    solver = AugmentedLagrangian(ProjectedLevenbergMarquardt(max_iterations=options.iterations))
    start = problem.start(problem.initial)
    solver.compile(problem, start)
    before, began = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    solution = solver.solve(problem, start)
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_SELF)
    return {
        "time": seconds,
        "user": after.ru_utime - before.ru_utime,
        "system": after.ru_stime - before.ru_stime,
        "faults": after.ru_minflt - before.ru_minflt,
        "largest": after.ru_maxrss / 1e6,
        "iterations": solution.iterations,
        "cost": solution.cost,
    }


if __name__ == "__main__":
    sys.exit(main())
