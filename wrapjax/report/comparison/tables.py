"""A comparison as CSV tables: SI units, all digits."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

from wrapjax.report.comparison.numbers import Row
from wrapjax.report.comparison.samples import ComparedLeg, moment_errors

MEAN_COLUMNS = (
    *("quantity", "use", "speed", "item", "method", "mean", "sd", "unit"),
    *("unit_of_analysis", "n"),
)
TEST_COLUMNS = (
    *("quantity", "use", "speed", "item", "test", "method", "against", "unit_of_analysis", "n"),
    *("difference", "low", "high", "unit", "statistic", "df", "error_df", "p", "p_adjusted", "d_z"),
)
CYCLE_COLUMNS = ("leg", "trial", "use", "speed_m_s", "coordinate", "method", "mae_Nm")


def means_csv(rows: Sequence[Row]) -> str:
    """Write mean and standard deviation of every quantity, one line a method."""
    return _written(
        MEAN_COLUMNS,
        (
            (
                *(row.quantity, row.use, row.speed, row.item, method, own.mean, own.sd, row.unit),
                *(row.unit_of_analysis, row.n),
            )
            for row in rows
            for method, own in row.spreads.items()
        ),
    )


def differences_csv(rows: Sequence[Row]) -> str:
    """Write every test, one line each.

    ``p_adjusted`` is Greenhouse and Geisser's for repeated measures, Holm's over items for paired tests.
    """
    return _written(TEST_COLUMNS, (line for row in rows for line in _test_lines(row)))


def cycles_csv(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> str:
    """Write the mean absolute moment error of every cycle: what tests of moment errors are made of."""
    lines = []
    for leg in legs:
        errors = {method: moment_errors(leg.results[method]) for method in methods}
        recorded = leg.recorded
        for place, (trial, use, speed) in enumerate(
            zip(recorded.trials, recorded.uses, recorded.speeds.tolist(), strict=True)
        ):
            for method, own in errors.items():
                for coordinate, values in own.items():
                    lines.append((leg.label, trial, use, speed, coordinate, method, float(values[place])))
    return _written(CYCLE_COLUMNS, lines)


def _test_lines(row: Row) -> Iterable[tuple[Any, ...]]:
    about = (row.quantity, row.use, row.speed, row.item)
    over = (row.unit_of_analysis, row.n)
    no_difference = ("", "", "", "")
    if row.variance is not None:
        one = row.variance
        numbers = (one.f, one.between_df, one.within_df, one.p)
        yield (*about, "anova", "", "", *over, *no_difference, *numbers, "", "")
    if row.repeated is not None:
        repeated = row.repeated
        numbers = (repeated.f, repeated.effect_df, repeated.error_df, repeated.p)
        corrected = repeated.p_corrected
        yield (*about, "repeated_measures_anova", "", "", *over, *no_difference, *numbers, corrected, "")
    for pair, tukey in row.tukey.items():
        if tukey is not None:
            interval = (tukey.difference, tukey.low, tukey.high, row.unit)
            yield (*about, "tukey_kramer", *pair, *over, *interval, "", "", "", tukey.p, "", "")
    for pair, test in row.paired.items():
        if test is not None:
            interval = (test.difference, test.low, test.high, row.unit)
            adjusted = row.p_holm.get(pair, "")
            yield (
                *about,
                "paired_t",
                *pair,
                *over,
                *interval,
                test.t,
                test.df,
                "",
                test.p,
                adjusted,
                test.d_z,
            )


def _written(columns: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    # What is not defined, or not known, is an empty cell.
    writer.writerows(
        ["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in line] for line in lines
    )
    return text.getvalue()
