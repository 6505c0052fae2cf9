"""Interruption test of commands: ``python -m validation.interruption``.

Each of fit, calibrate, diagnose and cohort is run on a small simulated subject without interruption. Then the
command is repeatedly started, killed with all its processes by SIGKILL at a random time of its duration,
checked for incomplete files, and resumed with ``--resume``; half of the runs are killed up to three times. In
the end all numbers must equal those of the uninterrupted run, and no other file may remain. Compiled programs
are reused. The exit status is 1 if there was a fault.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.machine import pin_threads
from validation.interruption.file_checks import incomplete_files, largest_difference, remaining_files
from validation.interruption.walking_subject import write_walking_subject

COMMANDS = ("fit", "calibrate", "diagnose", "cohort")
#: Earliest kill as a share of the uninterrupted run; before it Python only imports modules.
EARLIEST = 0.15
#: A run that takes this many times as long as the uninterrupted one counts as hanging.
HANGING = 20.0


@dataclass
class Tally:
    """Results of the interruptions of one command."""

    kills: int = 0
    runs: int = 0
    largest: float = 0.0
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Case:
    """Command with its subjects, and the result of its uninterrupted run."""

    command: str
    subjects: tuple[Path, ...]
    compiled: Path
    expected: Path
    seconds: float
    status: int


def main() -> int:
    options = _parser().parse_args()
    pin_threads()
    generator = random.Random(options.seed)
    tallies = {}
    with tempfile.TemporaryDirectory() as temporary:
        place = options.place or Path(temporary)
        subjects = _subjects(place / "subjects")
        for command in options.command or COMMANDS:
            case = _run_uninterrupted(command, subjects, place)
            print(f"{command}: {case.seconds:.1f} s uninterrupted, exit status {case.status}", flush=True)
            tallies[command] = Tally()
            share = options.times / len(options.command or COMMANDS)
            while tallies[command].kills < share:
                known = len(tallies[command].faults)
                _interrupt(case, place / "work", generator, tallies[command])
                print(f"  {tallies[command].kills} kills", flush=True)
                for fault in tallies[command].faults[known:]:
                    print(f"  fault: {fault}", flush=True)
            # Print here and not only at the end, because a long run may itself be stopped.
            print(_row(command, tallies[command]), flush=True)
    print(f"\n{'command':12s}{'kills':>8s}{'results':>9s}{'largest difference':>20s}  faults")
    for command, tally in tallies.items():
        print(_row(command, tally))
    return 1 if any(tally.faults for tally in tallies.values()) else 0


def _row(command: str, tally: Tally) -> str:
    cells = f"{tally.kills:>8d}{tally.runs:>9d}{tally.largest:>20.1e}"
    return f"{command:12s}{cells}  {len(tally.faults) or 'none'}"


def _subjects(place: Path) -> tuple[Path, ...]:
    """Write two subjects of two muscles each, with as many cycles as a diagnosis requires."""
    return tuple(write_walking_subject(place / name, seed) for seed, name in enumerate(("anna", "ben")))


def _words(case_command: str, subjects: Sequence[Path], out: Path) -> list[str]:
    from wrapjax.diagnosis.effects.catalogue import CATALOGUE

    first = str(subjects[0])
    without = sorted(set(CATALOGUE) - {"joint_damping", "curve_family"})
    words = {
        "fit": ["fit", first],
        "calibrate": ["calibrate", first, "--method", "NGA", "--starts", "3"],
        "diagnose": ["diagnose", first, "--starts", "2", "--without", *without],
        "cohort": ["cohort", *map(str, subjects), "--diagnose", "--starts", "2", "--workers", "1"],
    }[case_command]
    return [sys.executable, "-m", "wrapjax", *words, "--out", str(out), "--quiet", "--threads", "1"]


def _run_uninterrupted(command: str, subjects: tuple[Path, ...], place: Path) -> Case:
    """Run a command twice, first to compile, then to measure its duration and keep its result."""
    compiled = place / "compiled"
    compiled.mkdir(parents=True, exist_ok=True)
    # Always in the same folder, because it is part of the key of JAX's compilation cache.
    for _ in range(2):
        here = _new_folder(place / "work", compiled)
        began = time.monotonic()
        ended = subprocess.run(
            _words(command, subjects, here / "out"), env=_environment(here), capture_output=True, text=True
        )
        seconds = time.monotonic() - began
        if ended.returncode not in (0, 1) or not (here / "out").is_dir():
            raise RuntimeError(f"{command} fails without interruption: {ended.stderr}")
    expected = place / "expected" / command
    shutil.rmtree(expected, ignore_errors=True)
    shutil.copytree(here / "out", expected)
    return Case(command, subjects, compiled, expected, seconds, ended.returncode)


def _new_folder(place: Path, compiled: Path) -> Path:
    """Create a working folder whose cache holds compiled programs only."""
    shutil.rmtree(place, ignore_errors=True)
    (place / "cache").mkdir(parents=True)
    (place / "cache" / "compiled").symlink_to(compiled.resolve())
    return place


def _environment(place: Path) -> dict[str, str]:
    return os.environ | {"WRAPJAX_CACHE": str(place / "cache")}


def _interrupt(case: Case, place: Path, generator: random.Random, tally: Tally) -> None:
    """Kill a command one to three times, let it finish, and check its files."""
    here = _new_folder(place, case.compiled)
    out = here / "out"
    for _ in range(generator.choice((1, 1, 2, 3))):
        after = generator.uniform(EARLIEST, 1.0) * case.seconds
        ended = _run(case, here, after)
        if ended is not None:
            break
        tally.kills += 1
        tally.faults += [f"killed after {after:.2f} s: {fault}" for fault in incomplete_files(here)]
    # A kill may occur between the complete result and the removal of its lock file, which then blocks
    # nothing.
    ended_by_kill = ended is None and _complete(case.command, out)
    if not _complete(case.command, out):
        ended = _run(case, here, HANGING * case.seconds + 60.0)
        if ended != (case.status, ""):
            tally.faults.append(f"resumed run ended with {ended}, expected {case.status}")
            return
    tally.runs += 1
    difference, fault = largest_difference(case.expected, out)
    tally.largest = max(tally.largest, difference)
    tally.faults += [fault] if fault else []
    tally.faults += incomplete_files(here)
    remaining = [name for name in remaining_files(here) if not (ended_by_kill and name == ".out.lock")]
    tally.faults += [f"remaining file: {name}" for name in remaining]


def _complete(command: str, out: Path) -> bool:
    """Check whether a command finished; the folder of a cohort exists from the start."""
    return command != "cohort" and out.exists()


def _run(case: Case, place: Path, after: float) -> tuple[int, str] | None:
    """Start or resume a command, and kill all its processes after a time (s); None if it was killed."""
    out = place / "out"
    words = _words(case.command, case.subjects, out)
    if (place / ".out.unfinished").exists() or out.exists() or case.command == "diagnose":
        words.append("--resume")
    process = subprocess.Popen(
        words,
        env=_environment(place),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _, errors = process.communicate(timeout=after)
        return process.returncode, "" if process.returncode in (0, 1) else errors
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.interruption", description=__doc__)
    parser.add_argument("--times", type=int, default=200, help="total number of kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--command", nargs="+", choices=COMMANDS, help="commands to test (default: all)")
    parser.add_argument(
        "--place", type=Path, help="working folder that keeps compiled programs (default: temporary)"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
