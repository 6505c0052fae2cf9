"""Comparison of NGA, SGA, LSGA and PGA: errors in the layout of the paper's Table I, and times.

``python -m benchmarks.compare_methods [SUBJECT ...]`` prints Markdown, ``--out FILE.json`` writes JSON. Means
and standard deviations are over legs if there are at least three, otherwise over gait cycles, as the table
titles say.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.machine import commit, describe_machine, pin_threads, versions
from benchmarks.subjects import default_subject
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.comparison.comparison import Comparison
    from wrapjax.comparison.samples import ComparedLeg

_METHODS = ("NGA", "SGA", "LSGA", "PGA")


def main() -> int:
    options = _parser().parse_args()
    # JAX and NumPy read the thread counts once, when they are imported.
    pin_threads(options.threads)
    set_up_jax()
    import wrapjax
    from wrapjax.cli.calibrate import iteration_printer
    from wrapjax.io.files import write_json

    with ExitStack() as stack:
        folders = options.subjects or [stack.enter_context(default_subject(None))]
        done = wrapjax.compare(
            [wrapjax.load_subject(folder) for folder in folders],
            options.methods,
            geometry=options.geometry,
            starts=options.starts,
            callback=iteration_printer(quiet=options.quiet),
            quiet=options.quiet,
        )
        print("\n".join(markdown(done)))
        if options.out:
            about = {
                "schema": 1,
                "date": datetime.now(UTC).isoformat(timespec="seconds"),
                "subjects": [folder.name for folder in folders],
                "geometry": options.geometry,
                "commit": commit(),
                "machine": describe_machine(),
                "versions": versions(),
            }
            write_json(options.out, about | describe(done))
    return 0 if done.converged else 1


def describe(done: Comparison) -> dict[str, Any]:
    """Collect moment errors (N m), changes of geometry (m) and the outcome of each calibration for JSON."""
    from wrapjax.comparison.samples import unit_of_analysis

    return {
        "unit_of_analysis": unit_of_analysis(done.legs, "cycle"),
        "methods": {method: _errors_and_changes(done, method) for method in done.methods},
        "legs": {leg.label: {method: _outcome(leg, method) for method in done.methods} for leg in done.legs},
    }


def _errors_and_changes(done: Comparison, method: str) -> dict[str, Any]:
    return {
        "mae_Nm": [
            {"use": row.use, "speed": row.speed, "coordinate": row.item, "n": row.n}
            | vars(row.spreads[method])
            for row in done.rows
            if row.quantity == "moment_error"
        ],
        "geometry_change_m": [
            {"quantity": row.quantity, "coordinate": row.item, "n": row.n} | vars(row.spreads[method])
            for row in done.rows
            if row.quantity in ("length_change", "moment_arm_change")
        ],
    }


def _outcome(leg: ComparedLeg, method: str) -> dict[str, Any]:
    result = leg.results[method]
    solution = result.solution
    return {
        "geometry": leg.geometry[method],
        "converged": solution.status.converged,
        "message": solution.status.value,
        "starts": len(result.outcomes),
        "iterations": solution.iterations,
        "n_variables": len(result.labels),
        "cost": solution.cost,
        "max_constraint_violation": solution.max_violation,
        "seconds": {"compile": result.compile_seconds, "solve": result.solve_seconds},
    }


def markdown(done: Comparison) -> Iterator[str]:
    """Write Markdown tables of errors by speed, changes of geometry and outcomes of the calibrations."""
    for quantity, title, factor in (
        ("moment_error", "Mean absolute moment error, N m", 1.0),
        ("length_change", "Mean absolute change of muscle-tendon lengths, mm", 1e3),
        ("moment_arm_change", "Mean absolute change of moment arms, mm", 1e3),
    ):
        rows = [row for row in done.rows if row.quantity == quantity]
        if not rows:
            continue
        items = list(dict.fromkeys(row.item for row in rows))
        yield from ("", f"{title}: mean ± standard deviation over {rows[0].unit_of_analysis}s", "")
        yield from _header(["cycles", "method", *items])
        for use, speed in dict.fromkeys((row.use, row.speed) for row in rows):
            cells = {row.item: row for row in rows if (row.use, row.speed) == (use, speed)}
            for method in done.methods:
                spreads = (cells[item].spreads[method] if item in cells else None for item in items)
                texts = ["" if one is None else _mean_and_sd(one.mean, one.sd, factor) for one in spreads]
                yield _line([f"{use}, {speed}", method, *texts])
    names = [
        "leg",
        "method",
        "paths from",
        "variables",
        "iterations",
        "compile (s)",
        "solve (s)",
        "converged",
    ]
    yield from ("", "Outcome of each calibration; iterations of the best start", "")
    yield from _header([*names, "largest violation"])
    for leg in done.legs:
        for method in done.methods:
            one = _outcome(leg, method)
            seconds = one["seconds"]
            yield _line(
                [
                    *(leg.label, method, one["geometry"], str(one["n_variables"]), str(one["iterations"])),
                    *(f"{seconds['compile']:.1f}", f"{seconds['solve']:.1f}"),
                    *("yes" if one["converged"] else "no", f"{one['max_constraint_violation']:.0e}"),
                ]
            )


def _mean_and_sd(mean: float, sd: float, factor: float) -> str:
    text = f"{factor * mean:.2f}"
    return text if sd != sd else f"{text} ± {factor * sd:.2f}"


def _header(names: Sequence[str]) -> Iterator[str]:
    yield _line(names)
    yield _line(["---"] * len(names))


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare_methods", description=__doc__)
    parser.add_argument(
        "subjects",
        type=Path,
        nargs="*",
        metavar="SUBJECT",
        help="subject folders (default: $WRAPJAX_DATA/s1_left if set, otherwise a virtual subject)",
    )
    parser.add_argument(
        "--methods", nargs="+", choices=_METHODS, default=_METHODS, metavar="NAME", help="default: all four"
    )
    parser.add_argument(
        "--geometry",
        choices=("surrogate", "engine"),
        default="surrogate",
        help="path source of NGA and PGA",
    )
    parser.add_argument(
        "--starts", type=int, default=1, metavar="N", help="starts of each calibration (default: 1)"
    )
    parser.add_argument(
        "--threads", type=int, default=1, metavar="N", help="threads of each numerical library (default: 1)"
    )
    parser.add_argument("--quiet", action="store_true", help="print no progress")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file to write the results to")
    return parser


if __name__ == "__main__":
    sys.exit(main())
