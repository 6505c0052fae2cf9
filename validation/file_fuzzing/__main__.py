"""Feeds rubbish to everything of wrapjax that reads a file.

``python -m validation.file_fuzzing`` changes valid files, byte by byte and by what they are made of, keeps those that
reach new lines of the readers (atheris), and gives 100,000 of them to wrapjax. Each is read, or refused in
sentences that can be printed. Whatever else happens is a finding: any other error, more than 5 s of the
processor, more than 512 MiB beside what was there, a process that dies. Findings are kept under ``--out``
with what was said; ``--replay FILE`` reads one again. The exit status is 1 if there are any. Needs
``pip install --group fuzz``.
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

from validation.file_fuzzing.judgement import judge, judge_apart
from validation.file_fuzzing.readers import READERS
from validation.file_fuzzing.seeds import finished_results

#: Time that a reader may take for all its inputs, in s an input; findings of lost time cost 5 s each.
_PATIENCE_S = 1.0


def main() -> int:
    options = _parser().parse_args()
    with tempfile.TemporaryDirectory() as made:
        finished = options.finished or Path(made) / "finished"
        if not finished.exists():
            finished_results(finished)
        if options.replay:
            return _replay(options.replay, finished, Path(made))
        chosen = [name for name in READERS if not options.only or any(one in name for one in options.only)]
        total = sum(READERS[name].share for name in chosen)
        rows = {}
        for name in chosen:
            count = math.ceil(options.inputs * READERS[name].share / total)
            rows[name] = _fed(name, count, finished, options, Path(made))
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


def _fed(name: str, count: int, finished: Path, options: argparse.Namespace, place: Path) -> dict[str, Any]:
    """Feed one reader in a process of its own."""
    result = place / "result.json"
    result.unlink(missing_ok=True)
    findings = options.out / "".join(letter if letter.isalnum() else "_" for letter in name)
    words = [sys.executable, "-m", "validation.file_fuzzing.child", name, "--inputs", str(count)]
    words += ["--seed", str(options.seed), "--finished", str(finished), "--findings", str(findings)]
    words += ["--result", str(result)]
    environment = os.environ | {"PYTHONHASHSEED": "0"}
    try:
        ended = subprocess.run(
            words,
            env=environment,
            timeout=120.0 + _PATIENCE_S * count,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
    except subprocess.TimeoutExpired:
        return _failed("never came to an end")
    if not result.exists():
        told = ended.stderr.decode(errors="replace").strip().splitlines()[-12:]
        print("\n".join(told), file=sys.stderr)
        return _failed(f"its process ended with {ended.returncode}")
    return json.loads(result.read_text())


def _failed(reason: str) -> dict[str, Any]:
    return {"inputs": 0, "accepted": 0, "refused": 0, "findings": {reason: 1}, "seconds": 0.0}


def _replay(file: Path, finished: Path, place: Path) -> int:
    """Read a finding again and say how that went."""
    name = file.with_suffix(".txt").read_text(encoding="utf-8").splitlines()[0]
    reader = READERS[name]
    prepared = reader.prepare(finished, place)
    prepared.file.write_bytes(file.read_bytes())
    found = (judge_apart if reader.apart else judge)(prepared.read)
    print(f"{name}: {found.outcome}\n{found.detail}")
    return 1 if found.finding else 0


def _line(name: str, row: dict[str, Any]) -> str:
    rate = row["inputs"] / row["seconds"] if row["seconds"] else 0.0
    findings = sum(row["findings"].values())
    cells = (row["inputs"], row["accepted"], row["refused"], findings)
    return f"{name:32s}" + "".join(f"{cell:>10,d}" for cell in cells) + f"{rate:>10,.0f}/s"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.file_fuzzing", description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="of all readers together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="WORD", help="readers whose names hold one of these")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="where findings are kept")
    parser.add_argument("--finished", type=Path, help="folder of finished results, made if it is not there")
    parser.add_argument("--replay", type=Path, metavar="FILE", help="a finding (.input) to read again")
    return parser


if __name__ == "__main__":
    print(f"{'reader':32s}{'inputs':>10s}{'accepted':>10s}{'refused':>10s}{'findings':>10s}{'rate':>12s}")
    sys.exit(main())
