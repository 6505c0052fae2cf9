"""Means, standard deviations and tests of compared methods, and the content of ``comparison.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from typing import Any

from wrapjax.comparison import samples
from wrapjax.comparison.samples import MEAN, ComparedLeg, Samples
from wrapjax.comparison.statistics import (
    MINIMUM_UNITS,
    Anova,
    PairedTest,
    RepeatedAnova,
    Spread,
    TukeyKramer,
    anova,
    holm,
    paired_test,
    repeated_anova,
    spread,
    tukey_kramer,
)
from wrapjax.model.parameters import QUANTITIES
from wrapjax.report.calibration.run_summary import USES
from wrapjax.report.formatting import counted
from wrapjax.report.provenance import package_versions

#: Version of the layout of ``comparison.json``.
SCHEMA = 1
#: Value of ``use`` where cycles of all uses are included.
EVERY_USE = "all"

#: A method and the method that it is compared with.
Pair = tuple[str, str]


@dataclass(frozen=True)
class Row:
    """One quantity of one item by every method.

    Parameters
    ----------
    quantity, unit
        Name of the quantity and its SI unit.
    use, speed
        Cycles that are included.
    item
        Coordinate, muscle or parameter, without ``_l`` and ``_r``; ``mean`` is the mean over all of them.
    unit_of_analysis, n
        Kind and number of observations.
    spreads
        Mean and standard deviation by method.
    variance, repeated
        One-way and repeated-measures analysis of variance; None if not requested or too few observations.
    tukey, paired
        Tukey-Kramer and paired tests by pair of methods; None as above.
    p_holm
        p values of the paired tests with Holm's correction for the number of items.
    """

    quantity: str
    unit: str
    use: str
    speed: str
    item: str
    unit_of_analysis: str
    n: int = 0
    spreads: dict[str, Spread] = field(default_factory=dict)
    variance: Anova | None = None
    repeated: RepeatedAnova | None = None
    tukey: dict[Pair, TukeyKramer | None] = field(default_factory=dict)
    paired: dict[Pair, PairedTest | None] = field(default_factory=dict)
    p_holm: dict[Pair, float] = field(default_factory=dict)


def comparison_rows(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> tuple[Row, ...]:
    """Compute means and tests of all quantities.

    Moment errors are compared by use and speed with all tests, each method against the first. Changes of
    geometry, muscle forces, activations and parameters are compared over all cycles with paired tests of all
    pairs; methods that do not change paths are excluded from the tests of geometry.
    """
    cycle, muscle = (samples.unit_of_analysis(legs, within) for within in ("cycle", "muscle"))
    everything = samples.all_cycles(legs)
    against_first = [(method, methods[0]) for method in methods[1:]]
    rows: list[Row] = []
    for use in USES:
        for kind in samples.group_by_speed(legs, use):
            read = samples.collect_samples(legs, methods, samples.moment_errors, cycle, kind)
            about = Row("moment_error", "N m", use, kind.label, "", cycle)
            rows += [_with_variance(row, read) for row in _rows(about, read, methods, against_first)]
    for name, unit, reading in _BY_CYCLE:
        read = samples.collect_samples(legs, methods, reading, cycle, everything)
        about = Row(name, unit, EVERY_USE, everything.label, "", cycle)
        rows += _rows(about, read, methods, _pairs_that_differ(read, methods))
    for name in samples.freed_parameters(legs):
        read = samples.collect_samples(legs, methods, samples.parameter(name), muscle)
        about = Row("parameter", QUANTITIES[name].unit, EVERY_USE, everything.label, "", muscle)
        rows += _rows(about, read, methods, _pairs_that_differ(read, methods))
    return _adjusted(rows)


_BY_CYCLE: tuple[tuple[str, str, samples.QuantityReader], ...] = (
    ("length_change", "m", samples.length_changes),
    ("moment_arm_change", "m", samples.moment_arm_changes),
    ("muscle_force", "N", samples.muscle_forces),
    ("activation", "1", samples.activations),
)


def _pairs_that_differ(read: Samples, methods: Sequence[str]) -> list[Pair]:
    """List all pairs of methods that have a nonzero value."""
    nonzero = [
        method for row, method in enumerate(methods) if any(values[row].any() for values in read.values())
    ]
    return [(second, first) for first, second in combinations(nonzero, 2)]


def _rows(about: Row, read: Samples, methods: Sequence[str], pairs: Sequence[Pair]) -> list[Row]:
    """Make one row for each item, with paired tests."""
    rows = []
    for item, values in read.items():
        by_method = dict(zip(methods, values, strict=True))
        spreads = {method: spread(numbers) for method, numbers in by_method.items()}
        paired = {pair: paired_test(by_method[pair[0]], by_method[pair[1]]) for pair in pairs}
        rows.append(replace(about, item=item, n=values.shape[1], spreads=spreads, paired=paired))
    return rows


def _with_variance(row: Row, read: Samples) -> Row:
    """Add the analyses of variance and the Tukey-Kramer tests."""
    groups, methods = list(read[row.item]), list(row.spreads)
    tests = tukey_kramer(groups)
    tukey: dict[Pair, TukeyKramer | None] = {
        (methods[second], methods[first]): None if tests is None else tests[first, second]
        for first, second in combinations(range(len(methods)), 2)
    }
    return replace(row, variance=anova(groups), repeated=repeated_anova(groups), tukey=tukey)


def _adjusted(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Apply Holm's correction to the paired tests for the number of items of each quantity, use and speed."""
    families: dict[tuple[str, str, str, Pair], dict[int, float]] = {}
    for place, row in enumerate(rows):
        for pair, test in row.paired.items():
            if test is not None and row.item != MEAN:
                families.setdefault((row.quantity, row.use, row.speed, pair), {})[place] = test.p
    adjusted = list(rows)
    for (*_, pair), family in families.items():
        for place, p in holm(family).items():
            adjusted[place] = replace(adjusted[place], p_holm=adjusted[place].p_holm | {pair: p})
    return tuple(adjusted)


def describe_comparison(
    legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row]
) -> dict[str, Any]:
    """Describe a comparison: the content of ``comparison.json``, in SI units."""
    quantities: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        quantities.setdefault(row.quantity, []).append(_describe_row(row))
    return {
        "schema": SCHEMA,
        "methods": list(methods),
        "reference": methods[0],
        "unit_of_analysis": samples.unit_of_analysis(legs, "cycle"),
        "note": note(legs),
        "legs": [
            {
                "leg": leg.label,
                "subject": leg.subject.name,
                "side": leg.subject.side,
                "cycles": {use: leg.recorded.uses.count(use) for use in USES},
                "runs": {
                    method: {
                        "folder": leg.folders[method],
                        "converged": result.solution.status.converged,
                        "message": result.solution.status.value,
                        "cost": result.solution.cost,
                        "starts": len(result.outcomes),
                        "n_variables": len(result.solution.variables),
                        "geometry": leg.geometry.get(method),
                        "seconds": {"compile": result.compile_seconds, "solve": result.solve_seconds},
                    }
                    for method, result in leg.results.items()
                },
            }
            for leg in legs
        ],
        "versions": package_versions(),
        "quantities": quantities,
    }


def note(legs: Sequence[ComparedLeg]) -> str:
    """Write the unit of analysis and what can be inferred from the tests."""
    count = len(legs)
    if samples.unit_of_analysis(legs, "cycle") == "leg":
        return (
            f"Unit of analysis: leg (n = {count}). The cycles of a leg, and the parameters of its muscles, "
            "are averaged before testing."
        )
    return (
        f"Unit of analysis: cycle (of {counted(count, 'leg')}; parameters: muscle). Cycles of one leg are "
        "not independent, nor are its muscles: p values and intervals are descriptive and cannot be "
        f"generalized to other people. With {MINIMUM_UNITS} or more legs, the leg is the unit."
    )


def _describe_row(row: Row) -> dict[str, Any]:
    """Describe a row; values that are not defined or have too few observations are null."""
    content: dict[str, Any] = {
        "use": row.use,
        "speed": row.speed,
        "item": row.item,
        "unit": row.unit,
        "unit_of_analysis": row.unit_of_analysis,
        "n": row.n,
        "methods": {method: vars(values) for method, values in row.spreads.items()},
    }
    if row.tukey:
        content |= {
            "anova": _plain(row.variance),
            "repeated_measures_anova": _plain(row.repeated),
            "tukey_kramer": [_pair(pair) | _numbers(test, TukeyKramer) for pair, test in row.tukey.items()],
        }
    content["paired_t"] = [
        _pair(pair) | _numbers(test, PairedTest) | {"p_holm": row.p_holm.get(pair)}
        for pair, test in row.paired.items()
    ]
    return content


def _pair(pair: Pair) -> dict[str, str]:
    return {"method": pair[0], "against": pair[1]}


def _plain(test: Anova | RepeatedAnova | None) -> dict[str, Any] | None:
    return None if test is None else vars(test)


def _numbers(test: TukeyKramer | PairedTest | None, kind: type) -> dict[str, Any]:
    return {entry.name: None if test is None else getattr(test, entry.name) for entry in fields(kind)}
