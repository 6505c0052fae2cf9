"""Straight lines of a bank's cases, kept so that constants of the score can be tried in seconds.

``python -m validation.diagnosis.linearizations --bank BANK --out LINES`` calibrates each case, draws its straight lines (see
`wrapjax.diagnosis.linearization`) and keeps them, one file a case. Nothing is scored or refitted here, and
the truth is not looked at. `development_lines` gives lines with it, of development banks alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.machine import pin_threads
from validation.blind.case_selection import add_lot, lot_of
from validation.diagnosis.bank_cases import cases_of, development_truth
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null_covariance import InputErrors, MuscleErrors
from wrapjax.diagnosis.projection import Candidate
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_atomically
from wrapjax.io.json_and_arrays import load_arrays

_ARRAYS = ("residual", "fitted", "slopes", "spread", "away", "nuisances", "speeds")


@dataclass(frozen=True)
class Lines:
    """A case's straight lines, and standard deviations of its measured moments (N m)."""

    gap: LinearizedModel
    sizes: Float[np.ndarray, " coordinate"]


@dataclass(frozen=True)
class Job:
    case: Path
    file: Path
    starts: int


def main() -> int:
    options = _parser().parse_args()
    # Before JAX is loaded, which reads it once.
    pin_threads()
    try:
        cases = cases_of(options.bank, lot_of(options))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    out = options.out.resolve()
    jobs = {
        case.name: Job(case, file, options.starts)
        for case in cases
        if not (file := out / f"{case.name}.npz").exists()
    }
    failed = 0
    for number, one in enumerate(run_jobs(draw, jobs, workers=options.workers) if jobs else (), 1):
        failed += bool(one.failure)
        print(f"{number}/{len(jobs)} {one.name}: {one.failure or one.value}", file=sys.stderr, flush=True)
    return 1 if failed else 0


def draw(job: Job) -> str:
    """Calibrate a case and keep its straight lines."""
    import wrapjax
    from wrapjax.diagnosis.diagnosis import diagnosis_input
    from wrapjax.diagnosis.pipeline import linearize_effects
    from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax

    set_up_jax()
    subject = wrapjax.load_subject(job.case)
    calibration = wrapjax.calibrate(
        subject, "NGA", wrapjax.fit(subject, "engine", processes=1), starts=job.starts
    )
    case = diagnosis_input(calibration)
    _, _, gap = linearize_effects(case, case.variables)
    save(Lines(gap, case.measured_sizes), job.file)
    clear_caches_near_map_limit()
    return f"{len(gap.candidates)} effects"


def save(lines: Lines, file: Path) -> None:
    """Keep in single precision: a sixth figure decides nothing."""
    gap = lines.gap
    arrays: dict[str, Any] = {name: getattr(gap, name) for name in _ARRAYS}
    arrays |= {"sizes": lines.sizes, "states": gap.muscle_errors.states, "arms": gap.muscle_errors.arms}
    for place, errors in enumerate(gap.input_errors):
        arrays |= {f"input_{place}": errors.signatures, f"width_{place}": np.array(errors.width)}
    told = []
    for place, one in enumerate(gap.candidates):
        arrays[f"variants_{place}"] = np.stack(one.variants)
        arrays[f"prior_{place}"] = one.prior_sd
        arrays[f"limit_{place}"] = np.broadcast_to(one.limit, one.prior_sd.shape)
        told.append({"id": one.id, "one_sided": one.one_sided.tolist(), "parts": one.parts})
    arrays["candidates"] = np.array(json.dumps(told))
    small = {name: own.astype(np.float32) if own.dtype == np.float64 else own for name, own in arrays.items()}
    write_atomically(file, lambda temporary: np.savez(temporary, **small))


def load(file: Path) -> Lines:
    """Read lines back."""
    arrays = {
        name: own.astype(float) if own.dtype == np.float32 else own for name, own in load_arrays(file).items()
    }
    candidates = tuple(
        Candidate(
            told["id"],
            tuple(arrays[f"variants_{place}"]),
            arrays[f"prior_{place}"],
            np.array(told["one_sided"], dtype=bool),
            tuple(tuple(part) for part in told["parts"]),
            arrays[f"limit_{place}"],
        )
        for place, told in enumerate(json.loads(str(arrays["candidates"])))
    )
    inputs = sum(name.startswith("input_") for name in arrays)
    gap = LinearizedModel(
        **{name: arrays[name] for name in _ARRAYS},
        candidates=candidates,
        input_errors=tuple(
            InputErrors(arrays[f"input_{place}"], float(arrays[f"width_{place}"])) for place in range(inputs)
        ),
        muscle_errors=MuscleErrors(arrays["states"], arrays["arms"]),
    )
    return Lines(gap, arrays["sizes"])


def development_lines(bank: Path, lines: Path) -> Iterator[tuple[dict[str, Any], Lines]]:
    """Give the truth and the lines of all cases of a development bank whose lines are there.

    Raises
    ------
    InputError
        If a case is of no development bank (see `development_truth`), or there are no lines, or no whole
        ones.
    OSError
        If a truth is missing.
    """
    files = sorted(file for file in lines.glob("*.npz") if not file.name.startswith("."))
    if not files:
        raise InputError(
            Problem(
                str(lines), "no lines", hint="draw them with python -m validation.diagnosis.linearizations"
            )
        )
    truths = [development_truth(bank, file.stem) for file in files]
    for file, truth in zip(files, truths, strict=True):
        try:
            own = load(file)
        except ValueError as error:
            raise InputError(Problem(str(file), str(error))) from None
        except KeyError as error:
            hint = "they are of another version: draw them anew"
            raise InputError(Problem(str(file), f"lines without {error}", hint=hint)) from None
        yield truth, own


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.diagnosis.linearizations", description=__doc__
    )
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--starts", type=int, default=2)
    add_lot(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
