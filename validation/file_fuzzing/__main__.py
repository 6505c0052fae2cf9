"""Fuzzing of all file readers: ``python -m validation.file_fuzzing``.

Valid files are mutated, byte by byte and by their syntax; mutations that reach new lines of the readers are
kept for further mutation (atheris), and 100,000 of them are read by wrapjax. Each must be read, or rejected
with printable messages. Any other result is a finding: another exception, more than 5 s of processor time,
more than 512 MiB of additional memory, or a crash of the process. Findings are written under ``--out``;
``--replay FILE`` reads one again. The exit status is 1 if there are findings. Requires ``pip install --group
fuzz``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from validation.file_fuzzing.judgement import judge, judge_in_process
from validation.file_fuzzing.readers import READERS
from validation.file_fuzzing.seeds import finished_results

#: Time limit of a reader, s per input; findings of exceeded processor time take 5 s each.
_LIMIT_S = 1.0


def main() -> int:
    options = _parser().parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        finished = options.finished or Path(temporary) / "finished"
        if not finished.exists():
            finished_results(finished)
        if options.replay:
            return _replay(options.replay, finished, Path(temporary))
        chosen = [name for name in READERS if not options.only or any(one in name for one in options.only)]
        total = sum(READERS[name].share for name in chosen)
        rows = {}
        for name in chosen:
            count = math.ceil(options.inputs * READERS[name].share / total)
            rows[name] = _fuzz_reader(name, count, finished, options, Path(temporary))
            print(_line(name, rows[name]), flush=True)
    sums = {
        kind: sum(row[kind] for row in rows.values()) for kind in ("inputs", "accepted", "refused", "seconds")
    }
    findings = sum(sum(row["findings"].values()) for row in rows.values())
    print(_line("all", {**sums, "findings": {"all": findings} if findings else {}}))
    for name, row in rows.items():
        for kind, count in row["findings"].items():
            print(f"finding: {name}: {kind} ({count} times)")
    if findings:
        print(f"inputs are in {options.out}; read one again with --replay FILE")
    return 1 if findings else 0


def _fuzz_reader(
    name: str, count: int, finished: Path, options: argparse.Namespace, place: Path
) -> dict[str, Any]:
    """Fuzz one reader in a separate process."""
    result = place / "result.json"
    result.unlink(missing_ok=True)
    findings = options.out / "".join(letter if letter.isalnum() else "_" for letter in name)
    words = [sys.executable, "-m", "validation.file_fuzzing.reader_process", name, "--inputs", str(count)]
    words += ["--seed", str(options.seed), "--finished", str(finished), "--findings", str(findings)]
    words += ["--result", str(result)]
    environment = os.environ | {"PYTHONHASHSEED": "0"}
    try:
        ended = subprocess.run(
            words,
            env=environment,
            timeout=120.0 + _LIMIT_S * count,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
    except subprocess.TimeoutExpired:
        return _failed("time limit exceeded")
    if not result.exists():
        errors = ended.stderr.decode(errors="replace").strip().splitlines()[-12:]
        print("\n".join(errors), file=sys.stderr)
        return _failed(f"its process ended with {ended.returncode}")
    return json.loads(result.read_text())


def _failed(reason: str) -> dict[str, Any]:
    return {"inputs": 0, "accepted": 0, "refused": 0, "findings": {reason: 1}, "seconds": 0.0}


def _replay(file: Path, finished: Path, place: Path) -> int:
    """Read a finding again and print the outcome."""
    name = file.with_suffix(".txt").read_text(encoding="utf-8").splitlines()[0]
    reader = READERS[name]
    prepared = reader.prepare(finished, place)
    prepared.file.write_bytes(file.read_bytes())
    judgement = (judge_in_process if reader.separate_process else judge)(prepared.read)
    print(f"{name}: {judgement.outcome}\n{judgement.detail}")
    return 1 if judgement.finding else 0


def _line(name: str, row: dict[str, Any]) -> str:
    rate = row["inputs"] / row["seconds"] if row["seconds"] else 0.0
    findings = sum(row["findings"].values())
    cells = (row["inputs"], row["accepted"], row["refused"], findings)
    return f"{name:32s}" + "".join(f"{cell:>10,d}" for cell in cells) + f"{rate:>10,.0f}/s"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.file_fuzzing", description=__doc__)
    parser.add_argument(
        "--inputs", type=int, default=100_000, help="number of inputs of all readers together"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--only", nargs="+", metavar="WORD", help="only readers whose names contain one of these"
    )
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder for findings")
    parser.add_argument(
        "--finished", type=Path, help="folder of finished results, written if it does not exist"
    )
    parser.add_argument("--replay", type=Path, metavar="FILE", help="finding (.input) to read again")
    return parser


if __name__ == "__main__":
    print(f"{'reader':32s}{'inputs':>10s}{'accepted':>10s}{'refused':>10s}{'findings':>10s}{'rate':>12s}")
    sys.exit(main())
