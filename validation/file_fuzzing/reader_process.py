"""Process that fuzzes one reader by atheris (libFuzzer), which keeps inputs that reach new code."""

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

from validation.file_fuzzing.judgement import (
    ACCEPTED,
    REFUSED,
    Judgement,
    judge,
    judge_in_process,
    limit_memory,
)
from validation.file_fuzzing.mutation import mutated, mutated_archive
from validation.file_fuzzing.readers import READERS, READING, Prepared, Reader

#: Number of inputs stored of each kind of finding.
STORED = 3
#: Largest input in bytes; larger ones are slower and reach no other code.
LONGEST = 1 << 16


@dataclass
class Tally:
    """Counts of outcomes, and the folder for findings."""

    reader: str
    folder: Path
    outcomes: Counter[str] = field(default_factory=Counter)

    def add(self, data: bytes, judgement: Judgement) -> None:
        """Count an input, and store it if it is a finding."""
        self.outcomes[judgement.outcome] += 1
        if judgement.finding and self.outcomes[judgement.outcome] <= STORED:
            name = hashlib.sha256(data).hexdigest()[:16]
            (self.folder / f"{name}.input").write_bytes(data)
            (self.folder / f"{name}.txt").write_text(
                f"{self.reader}\n{judgement.outcome}\n{judgement.detail}", encoding="utf-8"
            )

    def content(self, seconds: float) -> dict[str, Any]:
        """Return the counts for JSON."""
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
    with atheris.instrument_imports(include=list(READING)), tempfile.TemporaryDirectory() as temporary:
        prepared = reader.prepare(options.finished, Path(temporary))
        _fuzz(atheris, reader, prepared, options, Path(temporary))


def _fuzz(atheris: Any, reader: Reader, prepared: Prepared, options: argparse.Namespace, place: Path) -> None:
    """Give inputs to a reader; never returns, as libFuzzer does not."""
    tally = Tally(reader.name, options.findings)
    judge_input = judge_in_process if reader.separate_process else judge
    change = mutated_archive if reader.archive else mutated
    corpus = place / "corpus"
    corpus.mkdir()
    options.findings.mkdir(parents=True, exist_ok=True)
    if not reader.separate_process:
        # Read once without a time limit, so that imports do not count against the first input.
        prepared.file.write_bytes(prepared.seeds[0])
        prepared.read()
    for number, seed in enumerate(prepared.seeds):
        (corpus / str(number)).write_bytes(seed)
        prepared.file.write_bytes(seed)
        judgement = judge_input(prepared.read)
        if judgement.outcome != ACCEPTED:
            sys.exit(f"{reader.name}: seed {number} is not valid: {judgement.outcome}\n{judgement.detail}")
    if not reader.separate_process:
        limit_memory()
    began = time.perf_counter()

    def take(data: bytes) -> None:
        prepared.file.write_bytes(data)
        tally.add(data, judge_input(prepared.read))
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
