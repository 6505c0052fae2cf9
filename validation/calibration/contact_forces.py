"""Joint contact forces of a healthy walker by NGA and by PGA.

``python -m validation.calibration.contact_forces SUBJECT`` calibrates by both methods with exact paths,
computes the contact forces of both runs, and prints the peaks in bodyweights and their phases in the gait
cycle, of hip, knee and ankle and of both condyles of the knee. The default subject is ``healthy_overground``
of ``$WRAPJAX_DATA``, or downloaded.
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
    from wrapjax.contact_forces.contact_result import ContactResult

#: Default recording.
RECORDING = "healthy_overground"
METHODS = ("NGA", "PGA")


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    set_up_jax()
    import wrapjax
    from wrapjax.cli.contact import contact_table

    with _subject_folder(options.subject) as place, tempfile.TemporaryDirectory() as folder:
        subject = wrapjax.load_subject(place)
        runs = [Path(folder) / method for method in METHODS]
        for method, run in zip(METHODS, runs, strict=True):
            done = wrapjax.calibrate(subject, method, wrapjax.exact_geometry(subject), starts=options.starts)
            done.save(run)
            error = abs(done.result.measured - done.result.modelled).mean()
            print(f"{method}: {error:.2f} N m over all cycles; {done.status.value}", file=sys.stderr)
        forces = wrapjax.contact(*runs, condyle_distance=options.condyle_distance)
        print("\n".join(peak_table(forces.result)))
        print(f"\n{contact_table(forces)}", file=sys.stderr)
    return 0 if forces.converged else 1


def peak_table(result: ContactResult) -> list[str]:
    """Format a Markdown table: mean peaks over cycles in bodyweights, and their gait phases (%)."""
    from wrapjax.comparison.statistics import spread
    from wrapjax.contact_forces.contact_result import peak_windows, peaks

    lines = [
        "| | " + " | ".join(f"{run.label} | at" for run in result.runs) + " |",
        "|---|" + "---|---|" * len(result.runs),
    ]
    for part in result.parts:
        for measure, window in peak_windows(part).items():
            cells = []
            for run in result.runs:
                run_peaks = peaks(result.curves(run, part), result.phase, window)
                size, place = spread(run_peaks.force / result.bodyweight).mean, spread(run_peaks.phase).mean
                cells.append(f"{size:.2f} | {place:.0f} %")
            lines.append(f"| {part}, {measure.replace('_', ' ')} | {' | '.join(cells)} |")
    return lines


@contextmanager
def _subject_folder(given: Path | None) -> Iterator[Path]:
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
    parser.add_argument("--starts", type=int, default=4, help="starts of each calibration (default: 4)")
    parser.add_argument(
        "--condyle-distance",
        type=float,
        default=0.04,
        metavar="M",
        help="distance between the condylar contact points of the knee, m (default: 0.04)",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
