"""Throughput of a cohort in subjects per minute, with one worker and with several.

``python -m benchmarks.cohort`` simulates 32 virtual subjects and calibrates all of them by NGA, first with
one worker, then with two; ``--diagnose`` also diagnoses them. Each pass has its own cache, which holds only
the programs compiled for the first subject, so no result is reused. Run it on an otherwise idle machine.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.machine import commit, describe_machine, pin_threads, versions
from wrapjax.jax_setup import set_up_jax


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    with tempfile.TemporaryDirectory() as temporary:
        place = options.place or Path(temporary)
        subjects = _write_subjects(place / "subjects", options.subjects)
        _pass(subjects[:1], place / "first", 1, options, compiled=None)
        passes = {}
        for workers in (1, options.workers):
            seconds = _pass(
                subjects, place / f"workers_{workers}", workers, options, compiled=place / "first" / "cache"
            )
            passes[workers] = 60.0 * len(subjects) / seconds
            print(f"{workers} workers: {seconds:.0f} s, {passes[workers]:.2f} subjects a minute", flush=True)
    ratio = passes[options.workers] / passes[1]
    print(f"{options.workers} workers process {ratio:.2f} times as many subjects as one")
    if options.out:
        from wrapjax.io.files import write_json

        content = {
            "schema": 1,
            "subjects": len(subjects),
            "starts": options.starts,
            "diagnose": options.diagnose,
            "subjects_per_minute": passes,
            "ratio": ratio,
            "commit": commit(),
            "machine": describe_machine(),
            "versions": versions(),
        }
        write_json(options.out, content)
    return 0


def _write_subjects(place: Path, count: int) -> list[Path]:
    """Simulate the virtual subjects that do not exist yet."""
    set_up_jax()
    from wrapjax.datasets.virtual_person.virtual_subject import write_virtual_subject

    folders = [place / f"virtual_{seed:02d}" for seed in range(count)]
    for seed, folder in enumerate(folders):
        if not folder.exists():
            write_virtual_subject(folder, seed=seed)
    return folders


def _pass(
    subjects: Sequence[Path], place: Path, workers: int, options: argparse.Namespace, *, compiled: Path | None
) -> float:
    """Time a cohort (s) that starts with compiled programs and no cached results."""
    from wrapjax.cohorts.cohort import cohort

    shutil.rmtree(place, ignore_errors=True)
    cache = place / "cache"
    cache.mkdir(parents=True)
    if compiled is not None:
        shutil.copytree(compiled / "compiled", cache / "compiled")
    os.environ["WRAPJAX_CACHE"] = str(cache)  # workers inherit it
    began = time.perf_counter()
    done = cohort(
        subjects,
        place / "cohort",
        diagnose=options.diagnose,
        workers=workers,
        starts=options.starts,
        quiet=False,
    )
    seconds = time.perf_counter() - began
    if done.failed:
        raise RuntimeError(f"throughput cannot be measured, subjects failed: {done.failed}")
    return seconds


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cohort", description=__doc__)
    parser.add_argument("--subjects", type=int, default=32)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument(
        "--place", type=Path, help="working folder that keeps the subjects (default: temporary)"
    )
    parser.add_argument("--out", type=Path, help="JSON file to write the throughput to")
    return parser


if __name__ == "__main__":
    sys.exit(main())
