"""Diagnoses of recorded walking with a hidden electrode, a wrong mass or other filters.

``python -m validation.recorded.knock_outs --out DIR`` diagnoses ``$WRAPJAX_DATA/s1_left`` (or ``--subject``)
completely, once for each change. For a hidden electrode it compares the estimated excitation of its muscles
with the EMG that was recorded. Answers are stored in DIR, so that an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import wrapjax
from benchmarks.machine import pin_threads
from validation.diagnosis.case_answers import calibration_fingerprint
from validation.recorded.manipulations import Manipulation, knock_outs, write_manipulation
from wrapjax.calibration.calibration import Calibration, cached_calibration
from wrapjax.diagnosis.diagnosis import diagnose_calibrated
from wrapjax.diagnosis.effects.unrecorded_excitation import drive_over_cycle
from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.evidence.score_test import Score, score_each
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.errors import InputError
from wrapjax.io.files import write_json
from wrapjax.io.json_and_arrays import load_json
from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax
from wrapjax.subject.subject import Subject

#: Phases of a cycle at which excitation is compared with EMG, and the largest delay in phases.
PHASES, LARGEST_DELAY = 101, 10


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    set_up_jax()
    try:
        rows = [_row(one, options.subject, options.out, options.starts) for one in knock_outs()]
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(table(rows), end="")
    return 0


def _row(change: Manipulation, source: Path, out: Path, starts: int) -> dict[str, Any]:
    """Diagnose a change, or read the answer if its inputs are unchanged."""
    folder, file = out / "subjects" / change.name, out / f"{change.name}.json"
    write_manipulation(source, folder, change)
    question = {**calibration_fingerprint(folder), "starts": starts}
    kept = load_json(file) if file.exists() else None
    if kept is None or kept["question"] != question:
        kept = {"question": question, **diagnosed(folder, starts, source, change.hidden)}
        write_json(file, kept)
    clear_caches_near_map_limit()
    print(change.says, file=sys.stderr, flush=True)
    return {"says": change.says, **kept}


def diagnosed(folder: Path, starts: int, whole: Path, hidden: str) -> dict[str, Any]:
    """Diagnose a recording; for a hidden electrode, compare the estimated excitation with its EMG.

    Parameters
    ----------
    folder, starts
        Subject folder, and starts of its calibration.
    whole
        Subject folder with all electrodes.
    hidden
        Removed channel; empty for none.
    """
    done = diagnose_calibrated(_calibrated(wrapjax.load_subject(folder), starts))
    found = done.result
    out: dict[str, Any] = {
        "outcome": found.outcome,
        "named": list(found.named),
        "ties": [list(tie) for tie in found.ties],
        "probabilities": {one.id: one.probability for one in found.effects[:5]},
        "drive": None,
    }
    others = done.data.context.undriven_muscles
    if hidden and found.linearized is not None and others is not None:
        measured_moment_sd = done.data.measured_moment_sd
        out["drive"] = _drive(
            found.linearized, measured_moment_sd, others.groups, wrapjax.load_subject(whole), hidden
        )
    return out


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format a Markdown table of all changes."""
    drive = "excitation of its muscle group: correlation with EMG, with delay"
    lines = [f"| knocked out | outcome | {drive} |", "|---|---|---|"]
    for row in rows:
        said = f"{row['outcome']} {', '.join(row['named'] or itertools.chain(*row['ties']))}".strip()
        lines.append(f"| {row['says']} | {said} | {_drive_text(row['drive'])} |")
    return "\n".join(lines) + "\n"


def _drive_text(drive: Mapping[str, Any] | None) -> str:
    if drive is None:
        return "-"
    places = [number for number, one in enumerate(drive["groups"], 1) if one["own"]]
    if not places:
        return "no group of the catalogue"
    own = drive["groups"][places[0] - 1]
    rank = f"{own['group']}, rank {places[0]} of {len(drive['groups'])} groups"
    if own["correlation"] is None:
        return f"no excitation ({rank})"
    return f"{own['correlation']:.2f}, {own['correlation_delayed']:.2f} ({rank})"


def _calibrated(subject: Subject, starts: int) -> Calibration:
    alone = replace(subject, other_leg=None)
    return cached_calibration(alone, "NGA", wrapjax.fit(alone, "engine", processes=1), starts=starts)


def _scores(
    linearized: LinearizedModel, measured_moment_sd: Float[np.ndarray, " coordinate"]
) -> tuple[Score, ...]:
    (found,) = score_each(
        linearized.residual.reshape(1, -1), nulls(linearized, measured_moment_sd), linearized.candidates
    )
    return found.scores


def _drive(
    linearized: LinearizedModel,
    measured_moment_sd: Float[np.ndarray, " coordinate"],
    groups: Sequence[tuple[str, tuple[str, ...]]],
    whole: Subject,
    hidden: str,
) -> dict[str, Any]:
    """Compare the excitation of every group without an electrode with the hidden channel."""
    candidate = next(one for one in linearized.candidates if one.id == "missing_drive")
    channel = whole.trials.channels.index(hidden)
    drove = {
        muscle
        for muscle, own in zip(whole.muscles.names, whole.muscle_channels, strict=True)
        if own == channel
    }
    emg = mean_emg(whole, channel)
    # Score each group separately.
    each = tuple(
        replace(candidate, id=group, variants=(shape,))
        for (group, _), shape in zip(groups, candidate.variants, strict=True)
    )
    found = []
    for (group, members), score in zip(
        groups, _scores(replace(linearized, candidates=each), measured_moment_sd), strict=True
    ):
        drive = np.asarray(drive_over_cycle(jnp.asarray(score.effect_sizes), PHASES))
        found.append(
            {
                "group": group,
                "own": bool(drove & set(members)),
                "evidence": score.evidence,
                **correlations(drive, emg),
            }
        )
    return {"groups": sorted(found, key=lambda one: -one["evidence"])}


def mean_emg(subject: Subject, channel: int) -> Float[np.ndarray, " phase"]:
    """Compute the mean of a channel over calibration cycles at `PHASES` phases."""
    trials = subject.trials
    inside = trials.inside
    calibration = [number for number, use in enumerate(trials.uses) if use == "calibration"]
    mean = trials.emg[calibration, channel, inside].mean(axis=0)
    return np.asarray(np.interp(np.linspace(0.0, 1.0, PHASES), np.linspace(0.0, 1.0, mean.size), mean))


def correlations(
    drive: Float[np.ndarray, " phase"], emg: Float[np.ndarray, " phase"]
) -> dict[str, float | None]:
    """Correlate excitation with EMG, undelayed and at the best delay; None for excitation of zero."""
    if np.ptp(drive) == 0.0:
        return {"correlation": None, "correlation_delayed": None}
    # The last phase equals the first of the next cycle.
    found = [
        float(np.corrcoef(drive[:-1], np.roll(emg[:-1], later))[0, 1]) for later in range(LARGEST_DELAY + 1)
    ]
    return {"correlation": found[0], "correlation_delayed": max(found)}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.recorded.knock_outs", description=__doc__)
    data = os.environ.get("WRAPJAX_DATA")
    parser.add_argument(
        "--subject",
        type=Path,
        default=Path(data) / "s1_left" if data else None,
        required=data is None,
        help="subject folder with the channels TibPost and GlutMed (default: $WRAPJAX_DATA/s1_left)",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--starts", type=int, default=4, help="starts of each calibration (default: 4)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
