"""JSON files of benchmark runs."""

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
    """Metrics of an earlier run, with its subject and processor.

    Parameters
    ----------
    asked
        Name of the set of metrics; runs of one set measure the same metrics.
    subject
        Name of the subject's folder.
    processor
        Model name of the processor.
    metrics
        Metrics by name.
    """

    asked: str
    subject: str
    processor: str
    metrics: dict[str, Metric]


def write_run(file: Path, asked: str, subject: str, metrics: Sequence[Metric]) -> None:
    """Write metrics with machine, package versions and commit."""
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
    """Read the file of a run.

    Raises
    ------
    InputError
        If the file is not one that a benchmark run wrote.
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
        message = "not a file of a benchmark run"
        raise InputError(Problem(str(file), f"{message} ({error})")) from None


def _numbers(entry: dict[str, Any]) -> dict[str, Any]:
    """Replace null by NaN (not measured) or infinity (any tolerance), which JSON cannot represent."""
    value, tolerance = entry["value"], entry["tolerance"]
    return entry | {
        "value": math.nan if value is None else float(value),
        "tolerance": INFORMATION if tolerance is None else float(tolerance),
    }
