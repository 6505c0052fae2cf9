"""A cohort in numbers: the content of ``cohort.json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from wrapjax.report.provenance import package_versions
from wrapjax.report.summary import USES
from wrapjax.subject.legs import name_without_side

#: Version of the layout of ``cohort.json``.
SCHEMA = 1


def describe_cohort(
    method: str, diagnosed: bool, subjects: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Describe a cohort as plain numbers and words.

    Parameters
    ----------
    method
        Of every calibration.
    diagnosed
        Whether subjects were diagnosed, too.
    subjects
        By name: what is known of each. Its ``state`` is ``waiting``, ``failed`` (with a ``message``) or
        ``done`` (with ``mae_Nm`` and ``rmse_Nm`` as in ``summary.json``, and a ``diagnosis``).

    Returns
    -------
    dict
        All of it, and under ``population``, over the subjects that are done: ``mae_Nm`` and ``rmse_Nm`` by
        use and coordinate (names without side) as ``n``, ``mean``, ``sd`` (None below two), ``min``,
        ``median`` and ``max`` in N m; how many diagnoses had which outcome, and how many named or tied
        which effect.
    """
    done = [one for one in subjects.values() if one["state"] == "done"]
    gaps = [one["diagnosis"] for one in done if one["diagnosis"] is not None]
    named = Counter(name for gap in gaps for name in gap["named"])
    tied = Counter(name for gap in gaps for name in {one for tie in gap["ties"] for one in tie})
    return {
        "schema": SCHEMA,
        "method": method,
        "diagnosed": diagnosed,
        "subjects": {name: dict(one) for name, one in subjects.items()},
        "population": {
            "n": len(done),
            "converged": sum(one["converged"] for one in done),
            "failed": sum(one["state"] == "failed" for one in subjects.values()),
            "waiting": sum(one["state"] == "waiting" for one in subjects.values()),
            **{kind: {use: _errors(done, kind, use) for use in USES} for kind in ("mae_Nm", "rmse_Nm")},
            "outcomes": dict(Counter(gap["outcome"] for gap in gaps).most_common()),
            "named": dict(named.most_common()),
            "tied": dict(tied.most_common()),
        },
        "versions": package_versions(),
    }


def errors_by_coordinate(subjects: list[Mapping[str, Any]], kind: str, use: str) -> dict[str, list[float]]:
    """Gather one error (N m) a subject by coordinate, left and right alike; ``mean`` comes last."""
    found: dict[str, list[float]] = {}
    for one in subjects:
        for name, value in (one[kind][use] or {}).items():
            found.setdefault(name_without_side(name), []).append(value)
    return {name: found[name] for name in sorted(found, key=lambda name: name == "mean")}


def _errors(subjects: list[Mapping[str, Any]], kind: str, use: str) -> dict[str, dict[str, Any]]:
    return {
        name: {
            "n": len(values),
            "mean": float(np.mean(values)),
            "sd": float(np.std(values, ddof=1)) if len(values) > 1 else None,
            "min": min(values),
            "median": float(np.median(values)),
            "max": max(values),
        }
        for name, values in errors_by_coordinate(subjects, kind, use).items()
    }
