"""Kills commands at random moments, goes on with ``--resume``, and compares what comes of it.

``python -m validation.interruption`` makes up a small subject and does each of fit, calibrate, diagnose and cohort
once undisturbed. Then, again and again, it starts the command, kills it with all its processes by SIGKILL at
a moment drawn from the time that it takes, looks whether any file that can be seen is half written, and goes
on; half of the runs may be killed up to three times. In the end every number has to be that of the
undisturbed run, and nothing may be left beside the result. Compiled programs are kept from run to run. The
exit status is 1 if anything was amiss.
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
from validation.interruption.inspection import half_written, largest_difference, left_over
from validation.interruption.walker import write_walker

COMMANDS = ("fit", "calibrate", "diagnose", "cohort")
#: Kills before this share of an undisturbed run hit what every Python program does when it starts.
EARLIEST = 0.15
#: A run that takes this many times as long as the undisturbed one hangs.
HANGING = 20.0


@dataclass
class Tally:
    """What came of killing one command."""

    kills: int = 0
    runs: int = 0
    largest: float = 0.0
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Case:
    """A command with what it works on, and how it ended undisturbed."""

    command: str
    subjects: tuple[Path, ...]
    compiled: Path
    undisturbed: Path
    seconds: float
    status: int


def main() -> int:
    options = _parser().parse_args()
    pin_threads()
    dice = random.Random(options.seed)
    tallies = {}
    with tempfile.TemporaryDirectory() as made:
        place = options.place or Path(made)
        subjects = _subjects(place / "subjects")
        for command in options.command or COMMANDS:
            case = _undisturbed(command, subjects, place)
            print(f"{command}: {case.seconds:.1f} s undisturbed, ends with {case.status}", flush=True)
            tallies[command] = Tally()
            share = options.times / len(options.command or COMMANDS)
            while tallies[command].kills < share:
                known = len(tallies[command].faults)
                _disturb(case, place / "work", dice, tallies[command])
                print(f"  {tallies[command].kills} kills", flush=True)
                for fault in tallies[command].faults[known:]:
                    print(f"  amiss: {fault}", flush=True)
            # Here, and not in the end alone: a long run may itself be stopped.
            print(_row(command, tallies[command]), flush=True)
    print(f"\n{'command':12s}{'kills':>8s}{'results':>9s}{'largest difference':>20s}  amiss")
    for command, tally in tallies.items():
        print(_row(command, tally))
    return 1 if any(tally.faults for tally in tallies.values()) else 0


def _row(command: str, tally: Tally) -> str:
    cells = f"{tally.kills:>8d}{tally.runs:>9d}{tally.largest:>20.1e}"
    return f"{command:12s}{cells}  {len(tally.faults) or 'nothing'}"


def _subjects(place: Path) -> tuple[Path, ...]:
    """Make up two persons of two muscles each, with as many cycles as a diagnosis asks for."""
    return tuple(write_walker(place / name, seed) for seed, name in enumerate(("anna", "ben")))


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


def _undisturbed(command: str, subjects: tuple[Path, ...], place: Path) -> Case:
    """Run twice: once to compile, once to see how long it takes and what comes of it."""
    compiled = place / "compiled"
    compiled.mkdir(parents=True, exist_ok=True)
    # Always in the same place: JAX knows compiled programs by the folder that they are kept in, too.
    for _ in range(2):
        here = _fresh(place / "work", compiled)
        began = time.monotonic()
        ended = subprocess.run(
            _words(command, subjects, here / "out"), env=_environment(here), capture_output=True, text=True
        )
        seconds = time.monotonic() - began
        if ended.returncode not in (0, 1) or not (here / "out").is_dir():
            raise RuntimeError(f"{command} fails undisturbed: {ended.stderr}")
    kept = place / "undisturbed" / command
    shutil.rmtree(kept, ignore_errors=True)
    shutil.copytree(here / "out", kept)
    return Case(command, subjects, compiled, kept, seconds, ended.returncode)


def _fresh(place: Path, compiled: Path) -> Path:
    """Make a folder with a cache that knows nothing but compiled programs."""
    shutil.rmtree(place, ignore_errors=True)
    (place / "cache").mkdir(parents=True)
    (place / "cache" / "compiled").symlink_to(compiled.resolve())
    return place


def _environment(place: Path) -> dict[str, str]:
    return os.environ | {"WRAPJAX_CACHE": str(place / "cache")}


def _disturb(case: Case, place: Path, dice: random.Random, tally: Tally) -> None:
    """Kill a command once or more, let it come to its end, and look at what it wrote."""
    here = _fresh(place, case.compiled)
    out = here / "out"
    for _ in range(dice.choice((1, 1, 2, 3))):
        after = dice.uniform(EARLIEST, 1.0) * case.seconds
        ended = _run(case, here, after)
        if ended is not None:
            break
        tally.kills += 1
        tally.faults += [f"killed after {after:.2f} s: {fault}" for fault in half_written(here)]
    # A kill may fall between a whole result and the removal of the lock beside it, which bars nobody then.
    ended_by_kill = ended is None and _complete(case.command, out)
    if not _complete(case.command, out):
        ended = _run(case, here, HANGING * case.seconds + 60.0)
        if ended != (case.status, ""):
            tally.faults.append(f"went on, and ended with {ended} in place of {case.status}")
            return
    tally.runs += 1
    difference, fault = largest_difference(case.undisturbed, out)
    tally.largest = max(tally.largest, difference)
    tally.faults += [fault] if fault else []
    tally.faults += half_written(here)
    left = [name for name in left_over(here) if not (ended_by_kill and name == ".out.lock")]
    tally.faults += [f"left beside the result: {name}" for name in left]


def _complete(command: str, out: Path) -> bool:
    """Say whether a command came to its end; a cohort's folder is there from the start."""
    return command != "cohort" and out.exists()


def _run(case: Case, place: Path, after: float) -> tuple[int, str] | None:
    """Begin or go on, and kill all that was begun after so many s; None if it was killed."""
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
        _, told = process.communicate(timeout=after)
        return process.returncode, "" if process.returncode in (0, 1) else told
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.interruption", description=__doc__)
    parser.add_argument("--times", type=int, default=200, help="kills of all commands together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--command", nargs="+", choices=COMMANDS, help="only these")
    parser.add_argument("--place", type=Path, help="where to work, and keep what is compiled")
    return parser


if __name__ == "__main__":
    sys.exit(main())
