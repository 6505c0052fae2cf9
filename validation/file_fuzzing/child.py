"""One reader, fed in a process of its own by atheris (libFuzzer), which keeps inputs that reach new code."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from validation.file_fuzzing.judgement import ACCEPTED, REFUSED, Judgement, judge, judge_apart, limit_memory
from validation.file_fuzzing.mutation import mutated, mutated_archive
from validation.file_fuzzing.readers import READERS, READING, Prepared, Reader

#: Inputs that are kept of each kind of finding.
KEPT = 3
#: Longest input in bytes; longer ones are slower, and reach no other code.
LONGEST = 1 << 16


@dataclass
class Tally:
    """What came of the inputs so far, and where findings are kept."""

    reader: str
    folder: Path
    outcomes: Counter[str] = field(default_factory=Counter)

    def add(self, data: bytes, judgement: Judgement) -> None:
        """Count an input; keep it if it is a finding."""
        self.outcomes[judgement.outcome] += 1
        if judgement.finding and self.outcomes[judgement.outcome] <= KEPT:
            name = hashlib.sha256(data).hexdigest()[:16]
            (self.folder / f"{name}.input").write_bytes(data)
            (self.folder / f"{name}.txt").write_text(
                f"{self.reader}\n{judgement.outcome}\n{judgement.detail}", encoding="utf-8"
            )

    def content(self, seconds: float) -> dict[str, Any]:
        """Say it in plain values."""
        findings = {kind: n for kind, n in self.outcomes.items() if kind not in (ACCEPTED, REFUSED)}
        return {
            "inputs": self.outcomes.total(),
            "accepted": self.outcomes[ACCEPTED],
            "refused": self.outcomes[REFUSED],
            "findings": findings,
            "seconds": seconds,
        }


def main() -> None:
    options = _parser().parse_args()
    reader = READERS[options.reader]
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is not installed: pip install --group fuzz")
    sys.setrecursionlimit(1000)
    with atheris.instrument_imports(include=list(READING)), tempfile.TemporaryDirectory() as made:
        prepared = reader.prepare(options.finished, Path(made))
        _feed(atheris, reader, prepared, options, Path(made))


def _feed(atheris: Any, reader: Reader, prepared: Prepared, options: argparse.Namespace, place: Path) -> None:
    """Hand input after input to a reader; never returns, as libFuzzer does not."""
    tally = Tally(reader.name, options.findings)
    asked = judge_apart if reader.apart else judge
    change = mutated_archive if reader.archive else mutated
    corpus = place / "corpus"
    corpus.mkdir()
    options.findings.mkdir(parents=True, exist_ok=True)
    if not reader.apart:
        # Once without a clock: what is imported on the way is loaded once, and no input is to blame for it.
        prepared.file.write_bytes(prepared.seeds[0])
        prepared.read()
    for number, seed in enumerate(prepared.seeds):
        (corpus / str(number)).write_bytes(seed)
        prepared.file.write_bytes(seed)
        judgement = asked(prepared.read)
        if judgement.outcome != ACCEPTED:
            sys.exit(f"{reader.name}: seed {number} is not valid: {judgement.outcome}\n{judgement.detail}")
    if not reader.apart:
        limit_memory()
    began = time.perf_counter()

    def take(data: bytes) -> None:
        prepared.file.write_bytes(data)
        tally.add(data, asked(prepared.read))
        if tally.outcomes.total() >= options.inputs:
            options.result.write_text(json.dumps(tally.content(time.perf_counter() - began)))
            sys.stderr.flush()
            os._exit(0)

    def mutate(data: bytes, longest: int, seed: int) -> bytes:
        dice = random.Random(seed)
        if dice.random() < 0.25:
            return atheris.Mutate(data, longest)
        return change(data, dice, prepared.seeds)[:longest]

    words = [f"-seed={options.seed + 1}", f"-max_len={LONGEST}", "-timeout=1000", "-rss_limit_mb=0"]
    words += [
        "-malloc_limit_mb=0",
        "-len_control=0",
        "-mutate_depth=1",
        "-verbosity=0",
        f"-artifact_prefix={options.findings}/",
    ]
    atheris.Setup([sys.argv[0], str(corpus), *words], take, custom_mutator=mutate)
    atheris.Fuzz()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser()
    parser.add_argument("reader", choices=READERS)
    parser.add_argument("--inputs", type=int, required=True)
    parser.add_argument("--seed", type=int, required=True)
    for name in ("finished", "findings", "result"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    return parser


if __name__ == "__main__":
    main()
