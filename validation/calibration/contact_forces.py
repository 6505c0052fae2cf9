"""Say what a walker's joints bear by NGA and by PGA, as the README reports it.

``python -m validation.calibration.contact_forces SUBJECT`` calibrates by both methods along exact paths, asks for the
contact forces of both runs side by side, and prints every peak in bodyweights and where in the gait cycle it
is: of hip, knee and ankle, and of either side of the knee. Without SUBJECT it takes ``healthy_overground``:
that of ``$WRAPJAX_DATA``, or downloaded.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.machine import pin_threads
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.contact_forces.result import ContactResult

#: The walker of the README.
RECORDING = "healthy_overground"
METHODS = ("NGA", "PGA")


def main() -> int:
    options = _parser().parse_args()
    # Before JAX is loaded, which reads it once.
    pin_threads()
    set_up_jax()
    import wrapjax
    from wrapjax.cli.contact import contact_table

    with _walker(options.subject) as place, tempfile.TemporaryDirectory() as folder:
        subject = wrapjax.load_subject(place)
        runs = [Path(folder) / method for method in METHODS]
        for method, run in zip(METHODS, runs, strict=True):
            done = wrapjax.calibrate(subject, method, wrapjax.exact_geometry(subject), starts=options.starts)
            done.save(run)
            error = abs(done.result.measured - done.result.modelled).mean()
            print(f"{method}: {error:.2f} N m over all cycles; {done.status.value}", file=sys.stderr)
        found = wrapjax.contact(*runs, condyle_distance=options.condyle_distance)
        print("\n".join(peak_table(found.result)))
        print(f"\n{contact_table(found)}", file=sys.stderr)
    return 0 if found.converged else 1


def peak_table(result: ContactResult) -> list[str]:
    """Give a table in Markdown: mean peaks over cycles in bodyweights, and where in the gait cycle (%)."""
    from wrapjax.comparison.statistics import spread
    from wrapjax.contact_forces.result import peak_windows, peaks

    lines = [
        "| | " + " | ".join(f"{run.label} | at" for run in result.runs) + " |",
        "|---|" + "---|---|" * len(result.runs),
    ]
    for part in result.parts:
        for measure, window in peak_windows(part).items():
            cells = []
            for run in result.runs:
                found = peaks(result.curves(run, part), result.phase, window)
                size, place = spread(found.force / result.bodyweight).mean, spread(found.phase).mean
                cells.append(f"{size:.2f} | {place:.0f} %")
            lines.append(f"| {part}, {measure.replace('_', ' ')} | {' | '.join(cells)} |")
    return lines


@contextmanager
def _walker(given: Path | None) -> Iterator[Path]:
    if given:
        yield given
    elif os.environ.get("WRAPJAX_DATA"):
        yield Path(os.environ["WRAPJAX_DATA"]) / RECORDING
    else:
        import wrapjax

        with tempfile.TemporaryDirectory() as folder:
            yield wrapjax.fetch(RECORDING, Path(folder) / RECORDING, quiet=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.calibration.contact_forces", description=__doc__
    )
    parser.add_argument("subject", type=Path, nargs="?", metavar="SUBJECT", help="subject folder")
    parser.add_argument("--starts", type=int, default=4, help="of each calibration (default: 4)")
    parser.add_argument(
        "--condyle-distance",
        type=float,
        default=0.04,
        metavar="M",
        help="between the points where the knee's condyles touch, m (default: 0.04)",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
