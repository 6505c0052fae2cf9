"""Linearized models of a bank's cases, stored so that statistics of the score take seconds.

``python -m validation.diagnosis.linearizations --bank BANK --out LINES`` calibrates each case, linearizes it
(see `wrapjax.diagnosis.evidence.linearization`) and writes one file per case. Nothing is scored or refitted,
and the truth is not read. `development_linearizations` reads them with the truth, for development banks only.
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
from validation.blind.case_selection import add_selection_arguments, selection_of
from validation.diagnosis.bank_cases import cases_of, development_truth
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.diagnosis.claims.gates import Recorded
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.null_hypotheses.error_sources import InputErrors, MuscleErrors
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_atomically
from wrapjax.io.json_and_arrays import load_arrays
from wrapjax.muscle.published_laws import GIVEN_LAW

#: Attributes of `LinearizedModel` by their names in files.
_ARRAYS = {
    "residual": "residual",
    "fitted": "fitted_residual",
    "slopes": "slopes",
    "spread": "prior_root",
    "away": "from_prior_mean",
    "nuisances": "nuisances",
    "speeds": "speeds",
}

#: Number of null replicates of each case.
REPLICATES = 20


@dataclass(frozen=True)
class LinearizedCase:
    """Linearized model of a case, what the gates need of its recording, and null replicates (N m)."""

    linearized: LinearizedModel
    recorded: Recorded
    null_residuals: Float[np.ndarray, "replicate row"]


@dataclass(frozen=True)
class Job:
    """Case to linearize, file to write, number of calibration starts, and muscle law."""

    case: Path
    file: Path
    starts: int
    muscle_law: str = GIVEN_LAW


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    try:
        cases = cases_of(options.bank, selection_of(options))
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
    for number, one in enumerate(run_jobs(linearize_case, jobs, workers=options.workers) if jobs else (), 1):
        failed += bool(one.failure)
        print(f"{number}/{len(jobs)} {one.name}: {one.failure or one.value}", file=sys.stderr, flush=True)
    return 1 if failed else 0


def linearize_case(job: Job) -> str:
    """Calibrate and linearize a case, and write the result."""
    import wrapjax
    from wrapjax.diagnosis.claims.claim import recorded_of
    from wrapjax.diagnosis.diagnosis import diagnosis_input
    from wrapjax.diagnosis.evidence.linearization import linearize
    from wrapjax.diagnosis.null_hypotheses.null_replicates import NullModel, null_replicate_residuals
    from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax

    set_up_jax()
    subject = wrapjax.load_subject(job.case)
    calibration = wrapjax.calibrate(
        subject,
        "NGA",
        wrapjax.fit(subject, "engine", processes=1),
        starts=job.starts,
        muscle_law=job.muscle_law,
    )
    case = diagnosis_input(calibration)
    linearized = linearize(case, case.variables)
    model = NullModel(
        case.law.free,
        case.law.with_free_law(case.variables),
        case.calibration_recording,
        linearized,
        linearized.noise,
    )
    replicates = null_replicate_residuals(model, REPLICATES)
    save(LinearizedCase(linearized, recorded_of(case), replicates), job.file)
    clear_caches_near_map_limit()
    return f"{len(linearized.candidates)} effects"


def save(lines: LinearizedCase, file: Path) -> None:
    """Write a linearized case in single precision, which is sufficient for the score."""
    linearized = lines.linearized
    arrays: dict[str, Any] = {name: getattr(linearized, attribute) for name, attribute in _ARRAYS.items()}
    arrays |= {
        "sizes": lines.recorded.measured_moment_sd,
        "angles": lines.recorded.angles,
        "velocities": lines.recorded.velocities,
        "replicates": lines.null_residuals,
        "states": linearized.muscle_errors.states,
        "arms": linearized.muscle_errors.arms,
    }
    for place, block in enumerate(lines.recorded.blocks):
        arrays[f"block_{place}"] = block
    for place, errors in enumerate(linearized.input_errors):
        arrays |= {f"input_{place}": errors.signatures, f"width_{place}": np.array(errors.width)}
    descriptions = []
    for place, one in enumerate(linearized.candidates):
        arrays[f"variants_{place}"] = np.stack(one.variants)
        arrays[f"prior_{place}"] = one.prior_sd
        arrays[f"limit_{place}"] = np.broadcast_to(one.limit, one.prior_sd.shape)
        descriptions.append({"id": one.id, "one_sided": one.one_sided.tolist(), "parts": one.parts})
    arrays["candidates"] = np.array(json.dumps(descriptions))
    single = {
        name: array.astype(np.float32) if array.dtype == np.float64 else array
        for name, array in arrays.items()
    }
    write_atomically(file, lambda temporary: np.savez(temporary, **single))


def load(file: Path) -> LinearizedCase:
    """Read a linearized case."""
    arrays = {
        name: array.astype(float) if array.dtype == np.float32 else array
        for name, array in load_arrays(file).items()
    }
    candidates = tuple(
        Candidate(
            entry["id"],
            tuple(arrays[f"variants_{place}"]),
            arrays[f"prior_{place}"],
            np.array(entry["one_sided"], dtype=bool),
            tuple(tuple(part) for part in entry["parts"]),
            arrays[f"limit_{place}"],
        )
        for place, entry in enumerate(json.loads(str(arrays["candidates"])))
    )
    inputs = sum(name.startswith("input_") for name in arrays)
    blocks = tuple(arrays[f"block_{place}"] for place in range(sum("block_" in name for name in arrays)))
    plain: dict[str, Any] = {attribute: arrays[name] for name, attribute in _ARRAYS.items()}
    linearized = LinearizedModel(
        **plain,
        candidates=candidates,
        input_errors=tuple(
            InputErrors(arrays[f"input_{place}"], float(arrays[f"width_{place}"])) for place in range(inputs)
        ),
        muscle_errors=MuscleErrors(arrays["states"], arrays["arms"]),
    )
    recorded = Recorded(arrays["angles"], arrays["velocities"], blocks, arrays["sizes"])
    return LinearizedCase(linearized, recorded, arrays["replicates"])


def development_linearizations(bank: Path, lines: Path) -> Iterator[tuple[dict[str, Any], LinearizedCase]]:
    """Iterate over truth and linearized model of all linearized cases of a development bank.

    Raises
    ------
    InputError
        If a case belongs to no development bank (see `development_truth`), or files are missing or invalid.
    OSError
        If a truth file is missing.
    """
    for file, truth in development_files(bank, lines).items():
        yield truth, load_valid(file)


def development_files(bank: Path, lines: Path) -> dict[Path, dict[str, Any]]:
    """Find the files of all linearized cases of a development bank, with the truth of each.

    Raises
    ------
    InputError, OSError
        As `development_linearizations`, but for invalid files.
    """
    files = sorted(file for file in lines.glob("*.npz") if not file.name.startswith("."))
    if not files:
        raise InputError(
            Problem(
                str(lines),
                "no linearized cases",
                hint="write them with python -m validation.diagnosis.linearizations",
            )
        )
    return {file: development_truth(bank, file.stem) for file in files}


def load_valid(file: Path) -> LinearizedCase:
    """Read a linearized case; raises an InputError if the file is invalid or of another version."""
    try:
        return load(file)
    except ValueError as error:
        raise InputError(Problem(str(file), str(error))) from None
    except KeyError as error:
        hint = "the file is of another version: linearize the cases again"
        raise InputError(Problem(str(file), f"linearized case without {error}", hint=hint)) from None


def linearizations_parser(module: str, description: str | None) -> argparse.ArgumentParser:
    """Create the parser of a script that reads linearized cases: ``--bank`` and ``--lines``."""
    parser = argparse.ArgumentParser(prog=f"python -m validation.diagnosis.{module}", description=description)
    parser.add_argument("--bank", type=Path, required=True, help="folder of the development bank")
    parser.add_argument("--lines", type=Path, required=True, help="folder of the linearized cases")
    return parser


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.diagnosis.linearizations", description=__doc__
    )
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--starts", type=int, default=2)
    add_selection_arguments(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
