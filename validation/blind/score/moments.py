"""Accuracy of the shrinkage and of the map of explainable error that an answer states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.anatomy import COORDINATES
from validation.blind.gait import FILE_RATE
from validation.blind.score.records import Answer, Case, Truth

BIN = 5


@dataclass(frozen=True)
class Predicted:
    """Predicted moments of a trial without and with the named effects, (coordinate, frame) in N m."""

    time: np.ndarray
    before: np.ndarray
    after: np.ndarray | None


@lru_cache(maxsize=8)
def _table(path: Path) -> dict[str, np.ndarray]:
    lines = path.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if line.strip().lower() == "endheader") + 1
    names = lines[start].split()
    values = np.array([[float(word) for word in line.split()] for line in lines[start + 1 :] if line.strip()])
    return dict(zip(names, values.T, strict=True))


def predicted(answer: Answer, recording: int, use: str) -> Predicted | None:
    """Read ``moments/<trial>.sto`` of an answer; None if there is none."""
    path = answer.folder / "moments" / f"walk_{recording + 1}_{use}.sto"
    if not path.exists():
        return None
    columns = _table(path)

    def rows(word: str) -> np.ndarray | None:
        found = [columns.get(f"{c}_moment_{word}", columns.get(f"{c}_{word}")) for c in COORDINATES]
        return None if any(row is None for row in found) else np.array(found)

    before = rows("before")
    return None if before is None else Predicted(columns["time"], before, rows("after"))


def cycles_of(truth: Truth, recording: int, use: str) -> list[tuple[float, float]]:
    pairs = [(a, b) for a, b in truth.raw["cycles"][recording]]
    split = truth.raw["calibration_cycles"] if recording < len(truth.raw["cycles"]) - 1 else 0
    return pairs[:split] if use == "calibration" else pairs[split:]


def _clean_at(truth: Truth, recording: int, time: np.ndarray) -> np.ndarray:
    grid = np.arange(truth.clean.shape[-1]) / FILE_RATE
    return np.array([np.interp(time, grid, row) for row in truth.clean[recording]])


def _measured_at(bank: Path, truth: Truth, recording: int, time: np.ndarray) -> np.ndarray:
    columns = _table(bank / "cases" / truth.id / "trials" / f"walk_{recording + 1}" / "moments.sto")
    return np.array([np.interp(time, columns["time"], columns[f"{c}_moment"]) for c in COORDINATES])


def oracle_shrinkage(bank: Path, case: Case, which: str) -> float | None:
    """Compute shrinkage with the true noise floor, over held-out cycles or over the held-out speed."""
    last = len(case.truth.raw["cycles"]) - 1
    recordings = [last] if which == "held_out_speed" else list(range(last))
    before: list[np.floating] = []
    after: list[np.floating] = []
    for recording in recordings:
        found = predicted(case.answer, recording, "validation")
        if found is None or found.after is None:
            return None
        for start, end in cycles_of(case.truth, recording, "validation"):
            time = np.linspace(start, end, 101)
            measured = _measured_at(bank, case.truth, recording, time)
            for total, values in ((before, found.before), (after, found.after)):
                at = np.array([np.interp(time, found.time, row) for row in values])
                total.append(np.mean((at - measured) ** 2))
    floor = case.truth.raw["floor_Nm2"][which]
    gap = np.mean(before) - floor
    return float((np.mean(before) - np.mean(after)) / gap) if gap > 0 else None


def shrinkage_estimate(value: Any) -> tuple[float, tuple[float, float]] | None:
    """Return estimate and interval of a shrinkage in ``gap.json``; None if there is none."""
    if not isinstance(value, dict) or value.get("estimate") is None:
        return None
    interval = value.get("ci95") or (np.nan, np.nan)
    middle = value["estimate"]
    # For a tie the estimate is the range over its members.
    middle = float(np.mean(middle)) if isinstance(middle, (list, tuple)) else float(middle)
    return middle, (float(interval[0]), float(interval[1]))


def map_pairs(case: Case) -> np.ndarray:
    """Compute true and stated explainable RMS of each coordinate, phase bin and speed, (entry, 2) in N m."""
    stated = {
        (w["coordinate"], int(w["phase_percent"][0]), round(float(w["speed_m_s"]), 3)): float(
            w["explainable_rms_Nm"]
        )
        for w in case.answer.raw.get("where") or []
        if w.get("explainable_rms_Nm") is not None
    }
    pairs = []
    for recording, speed in enumerate(case.truth.raw["speeds_m_s"]):
        parts = []
        for use in ("calibration", "validation"):
            found = predicted(case.answer, recording, use)
            if found is None:
                continue
            for start, end in cycles_of(case.truth, recording, use):
                time = np.linspace(start, end, 101)
                at = np.array([np.interp(time, found.time, row) for row in found.before])
                parts.append(_clean_at(case.truth, recording, time) - at)
        if not parts:
            continue
        mean = np.mean(parts, axis=0)
        for row, coordinate in enumerate(COORDINATES):
            for start in range(0, 100, BIN):
                key = (coordinate, start, round(float(speed), 3))
                if key in stated:
                    true = np.sqrt(np.mean(mean[row, start : start + BIN + 1] ** 2))
                    pairs.append((true, stated[key]))
    return np.array(pairs).reshape(-1, 2)


def r_squared(pairs: np.ndarray) -> float:
    true, stated = pairs.T
    return float(1.0 - np.sum((stated - true) ** 2) / np.sum((true - true.mean()) ** 2))
