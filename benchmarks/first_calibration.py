"""Times (s) of preparing, compiling and solving the first calibration of a process, printed as JSON.

Started by `benchmarks.calibration`: ``python -m benchmarks.first_calibration SUBJECT FIT``
"""

from __future__ import annotations

import json
import sys
import time

import wrapjax
from wrapjax.calibration.problem import build_objective
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt


def main() -> None:
    subject = wrapjax.load_subject(sys.argv[1])
    fit = wrapjax.load_fit(sys.argv[2], subject)
    moments = [time.perf_counter()]
    problem = build_objective(subject, "NGA", fit)
    moments.append(time.perf_counter())
    solver, start = ProjectedLevenbergMarquardt(), problem.variables.start()
    solver.compile(problem, start)
    moments.append(time.perf_counter())
    solver.solve(problem, start)
    moments.append(time.perf_counter())
    names = ("prepare", "compile", "solve")
    print(json.dumps({name: moments[at + 1] - moments[at] for at, name in enumerate(names)}))


if __name__ == "__main__":
    main()
