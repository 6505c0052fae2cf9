"""The file that a run of the benchmarks leaves, and how it is read again."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.machine import commit, describe_machine, versions
from benchmarks.metric import INFORMATION, Metric
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_json

_SCHEMA = 2


@dataclass(frozen=True)
class EarlierRun:
    """What a run measured, of whom and where.

    Parameters
    ----------
    asked
        Which set of measurements it was, in words; runs of one set measure the same things.
    subject
        Name of the subject's folder.
    processor
        As the machine names it.
    metrics
        By their names.
    """

    asked: str
    subject: str
    processor: str
    metrics: dict[str, Metric]


def write_run(file: Path, asked: str, subject: str, metrics: Sequence[Metric]) -> None:
    """Write what was measured, with machine, versions and commit."""
    content = {
        "schema": _SCHEMA,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "asked": asked,
        "subject": subject,
        "commit": commit(),
        "machine": describe_machine(),
        "versions": versions(),
        "metrics": [metric.as_json() for metric in metrics],
    }
    write_json(file, content)


def read_run(file: Path) -> EarlierRun:
    """Read a run.

    Raises
    ------
    InputError
        Where the file is none.
    """
    try:
        content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        metrics = [Metric(**_numbers(entry)) for entry in content["metrics"]]
        return EarlierRun(
            content["asked"],
            content["subject"],
            content["machine"]["processor"],
            {metric.name: metric for metric in metrics},
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        message = "is no file that a run of the benchmarks wrote"
        raise InputError(Problem(str(file), f"{message} ({error})")) from None


def _numbers(entry: dict[str, Any]) -> dict[str, Any]:
    """JSON has neither NaN nor infinity: both are null, where nothing could be measured or all is allowed."""
    value, tolerance = entry["value"], entry["tolerance"]
    return entry | {
        "value": math.nan if value is None else float(value),
        "tolerance": INFORMATION if tolerance is None else float(tolerance),
    }
