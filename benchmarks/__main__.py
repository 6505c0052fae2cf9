"""Benchmark the speed of wrapjax and of comparable tools: ``python -m benchmarks``."""

from __future__ import annotations

import argparse
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.machine import pin_threads
from benchmarks.subjects import add_subject_argument, default_subject
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from benchmarks.case import Case
    from benchmarks.metric import Metric
    from wrapjax.subject.subject import Subject

GROUPS = (
    *("kernels", "compile", "solve", "recompilation", "growth", "roofline"),
    *("paths", "surrogate", "engine", "devices"),
)


def main() -> int:
    options = _parser().parse_args()
    # JAX and NumPy read the thread counts once, when they are imported.
    pin_threads(options.threads)
    set_up_jax()
    with default_subject(options.subject) as folder:
        metrics = _measure(folder, options)
    from benchmarks.metric import text_table

    print(text_table(metrics))
    if options.out:
        from benchmarks.run_file import write_run

        asked = " ".join(("quick" if options.quick else "whole", *sorted(options.only)))
        write_run(options.out, asked, folder.name, metrics)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    add_subject_argument(parser)
    parser.add_argument(
        "--only",
        nargs="+",
        choices=GROUPS,
        default=GROUPS,
        metavar="NAME",
        help="groups of benchmarks to run",
    )
    parser.add_argument(
        "--muscles", nargs="+", metavar="NAME", help="muscles of the surrogate benchmark (default: eight)"
    )
    parser.add_argument(
        "--limit",
        type=float,
        default=120.0,
        metavar="SECONDS",
        help="time limit of each peer solver (default: 120)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="few repeats, 15 s for each peer solver, two muscles"
    )
    parser.add_argument(
        "--full", action="store_true", help="run all 500,000 analyses of each muscle instead of extrapolating"
    )
    parser.add_argument(
        "--threads", type=int, default=1, metavar="N", help="threads of each numerical library (default: 1)"
    )
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file to write the metrics to")
    parser.add_argument(
        "--figures",
        type=Path,
        metavar="DIR",
        help="folder for the figures of growth and roofline (PNG and SVG)",
    )
    return parser


def _measure(folder: Path, options: argparse.Namespace) -> list[Metric]:
    import wrapjax
    from benchmarks import calibration, devices, engine, recompilation, solving, surrogate
    from benchmarks.case import nga_case
    from benchmarks.path_methods import path_methods
    from wrapjax.progress import print_progress

    subject = wrapjax.load_subject(folder)
    limit = min(options.limit, 15.0) if options.quick else options.limit
    muscles = options.muscles or surrogate.default_muscles(subject)
    metrics = []

    @cache
    def case() -> Case:
        return nga_case(subject)

    runs = {
        "kernels": lambda: calibration.kernels(case(), quick=options.quick),
        "compile": lambda: calibration.compilation(case()),
        "solve": lambda: solving.solves(case(), quick=options.quick, limit=limit),
        "recompilation": lambda: recompilation.recompilations(case().problem),
        "growth": lambda: _growth(case(), options.figures),
        "roofline": lambda: _roofline(subject, case(), options.figures),
        "paths": lambda: path_methods(subject, wrapjax.fit(subject), quick=options.quick),
        "surrogate": lambda: surrogate.surrogates(subject, muscles, quick=options.quick),
        "engine": lambda: engine.engine_speed(subject, quick=options.quick, full=options.full),
        "devices": lambda: devices.devices(subject, case()),
    }
    for name in GROUPS:
        if name in options.only:
            print_progress(f"measuring: {name}")
            metrics += runs[name]()
    return metrics


def _growth(case: Case, figures: Path | None) -> list[Metric]:
    from benchmarks import charts, growth

    measured, metrics = growth.growth(case.problem)
    if figures:
        charts.draw_growth(measured, figures)
    return metrics


def _roofline(subject: Subject, case: Case, figures: Path | None) -> list[Metric]:
    from benchmarks import charts, roofline

    roof, works, metrics = roofline.roofline(subject, case)
    if figures:
        charts.draw_roofline(roof, works, figures)
    return metrics


if __name__ == "__main__":
    sys.exit(main())
