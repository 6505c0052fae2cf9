"""Means and tests of a comparison as tables of its report, and as CSV in SI units with all digits."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

from wrapjax.comparison.samples import MEAN, ComparedLeg, moment_errors
from wrapjax.comparison.statistics import Spread, TukeyKramer
from wrapjax.report import markup
from wrapjax.report.comparison.summary import Pair, Row
from wrapjax.report.formatting import DASH, decimals, p_value, readable

#: Level of significance of the tests.
SIGNIFICANT = 0.05
_MINUS = " \N{MINUS SIGN} "
#: Display of each SI unit: factor, number of decimals, displayed unit.
_SHOWN = {
    "N m": (1.0, 2, "N m"),
    "m": (1e3, 2, "mm"),
    "s": (1e3, 2, "ms"),
    "N": (1.0, 1, "N"),
    "1": (1.0, 3, "1"),
    "rad": (180.0 / math.pi, 2, "degrees"),
}


def mean_table(rows: Sequence[Row], methods: Sequence[str], *, caption: str) -> str:
    """Write a table of means by speed and method, one column an item, laid out as Ao et al.'s Table I."""
    items = list(dict.fromkeys(row.item for row in rows))
    speeds = list(dict.fromkeys(row.speed for row in rows))
    cells = {(row.speed, row.item): row for row in rows}
    lines = []
    for speed in speeds:
        for method in methods:
            name = method if len(speeds) == 1 else f"{speed}: {method}"
            own_rows = [cells.get((speed, item)) for item in items]
            lines.append((name, *(DASH if row is None else _marked(row, method) for row in own_rows)))
    return markup.table(("method" if len(speeds) == 1 else "speed: method", *items), lines, caption=caption)


def parameter_table(rows: Sequence[Row], methods: Sequence[str], *, caption: str) -> str:
    """Write a table of mean parameters, one row a parameter, one column a method."""
    lines = [
        (readable(row.item), shown_unit(row), *(_marked(row, method) for method in methods)) for row in rows
    ]
    return markup.table(("parameter", "unit", *methods), lines, caption=caption)


def variance_table(rows: Sequence[Row], *, caption: str) -> str:
    """Write a table of the analyses of variance, one row an item."""
    lines = []
    for row in rows:
        one_way, repeated = row.variance, row.repeated
        lines.append(
            (
                row.item,
                str(row.n),
                *(
                    (DASH, DASH, DASH)
                    if one_way is None
                    else (
                        f"{one_way.between_df}, {one_way.within_df}",
                        decimals(one_way.f),
                        p_value(one_way.p),
                    )
                ),
                *(
                    (DASH, DASH, DASH, DASH)
                    if repeated is None
                    else (
                        f"{repeated.effect_df}, {repeated.error_df}",
                        decimals(repeated.f),
                        decimals(repeated.epsilon),
                        p_value(repeated.p_corrected),
                    )
                ),
            )
        )
    header = ("coordinate", "n", "one-way: df", "F", "p", "repeated: df", "F", "epsilon", "p")
    return markup.table(header, lines, caption=caption)


def paired_table(rows: Sequence[Row], *, caption: str) -> str:
    """Write a table of paired tests, one row for each item and pair of methods."""
    lines = []
    for row in rows:
        for pair in row.paired:
            lines.append((f"{row.item}: {_MINUS.join(pair)}", *_paired_cells(row, pair)))
    header = ("coordinate", "n", "difference", "95 % CI", "t", "p", "p (Holm)", "d_z")
    return markup.table(header, lines, caption=caption)


def tukey_table(rows: Sequence[Row], *, caption: str) -> str:
    """Write a table of Tukey-Kramer tests, one row an item, one column a pair: difference and p."""
    pairs = list(rows[0].tukey)
    lines = [(row.item, *(_difference_and_p(row, row.tukey[pair]) for pair in pairs)) for row in rows]
    return markup.table(("coordinate", *map(_MINUS.join, pairs)), lines, caption=caption)


def muscle_tests_table(rows: Sequence[Row], *, caption: str) -> str:
    """Write a table of paired tests of the average over muscles, and the number of muscles that differ."""
    muscles = [row for row in rows if row.item != MEAN]
    lines = []
    for row in rows:
        if row.item == MEAN:
            for pair in row.paired:
                *cells, _holm, effect = _paired_cells(row, pair)
                counts = [
                    sum(
                        _differs(muscle, pair) and sign * _difference(muscle, pair) > 0.0
                        for muscle in muscles
                    )
                    for sign in (1, -1)
                ]
                numbers = [f"{count} of {len(muscles)}" for count in counts]
                lines.append((_MINUS.join(pair), *cells, effect, *numbers))
    header = ("methods", "n", "difference", "95 % CI", "t", "p", "d_z", "muscles higher", "lower")
    return markup.table(header, lines, caption=caption)


def shown_unit(row: Row) -> str:
    """Look up the unit in which a row is displayed."""
    return _SHOWN.get(row.unit, (1.0, 2, row.unit))[2]


def mean_and_deviation(row: Row, spread: Spread) -> str:
    """Write a mean and its standard deviation in the displayed unit; a single value has no deviation."""
    mean = _shown(row, spread.mean)
    return mean if math.isnan(spread.sd) else f"{mean} ± {_shown(row, spread.sd)}"


def _paired_cells(row: Row, pair: Pair) -> tuple[str, ...]:
    test = row.paired[pair]
    if test is None:
        return (str(row.n), *[DASH] * 6)
    interval = DASH if math.isnan(test.low) else f"{_shown(row, test.low)} to {_shown(row, test.high)}"
    return (
        str(test.n),
        _shown(row, test.difference),
        interval,
        decimals(test.t),
        p_value(test.p),
        p_value(row.p_holm.get(pair, math.nan)),
        decimals(test.d_z),
    )


def _difference_and_p(row: Row, test: TukeyKramer | None) -> str:
    if test is None or math.isnan(test.p):
        return DASH
    return f"{_shown(row, test.difference)} ({p_value(test.p)})"


def _marked(row: Row, method: str) -> str:
    """Write a mean with a mark if it differs significantly from the first method's."""
    first = next(iter(row.spreads))
    mark = "* " if _differs(row, (method, first)) else ""
    return f"{mark}{mean_and_deviation(row, row.spreads[method])}"


def _differs(row: Row, pair: Pair) -> bool:
    """Determine whether a pair differs significantly, with Holm's correction where it applies."""
    test = row.paired.get(pair)
    return test is not None and row.p_holm.get(pair, test.p) < SIGNIFICANT


def _difference(row: Row, pair: Pair) -> float:
    test = row.paired.get(pair)
    return math.nan if test is None else test.difference


def _shown(row: Row, value: float) -> str:
    factor, places, _ = _SHOWN.get(row.unit, (1.0, 2, row.unit))
    return decimals(factor * value, places)


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
    """Write mean and standard deviation of every quantity as CSV, one line per method."""
    return _csv(
        MEAN_COLUMNS,
        (
            (
                *(row.quantity, row.use, row.speed, row.item, method, spread.mean, spread.sd, row.unit),
                *(row.unit_of_analysis, row.n),
            )
            for row in rows
            for method, spread in row.spreads.items()
        ),
    )


def differences_csv(rows: Sequence[Row]) -> str:
    """Write every test as CSV, one line per test.

    ``p_adjusted`` has Greenhouse and Geisser's correction for repeated measures, Holm's for paired tests.
    """
    return _csv(TEST_COLUMNS, (line for row in rows for line in _test_lines(row)))


def cycles_csv(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> str:
    """Write the mean absolute moment error of every cycle as CSV: the data of the tests of moment errors."""
    lines = []
    for leg in legs:
        errors = {method: moment_errors(leg.results[method]) for method in methods}
        recorded = leg.recorded
        for place, (trial, use, speed) in enumerate(
            zip(recorded.trials, recorded.uses, recorded.speeds.tolist(), strict=True)
        ):
            for method, by_coordinate in errors.items():
                for coordinate, values in by_coordinate.items():
                    lines.append((leg.label, trial, use, speed, coordinate, method, float(values[place])))
    return _csv(CYCLE_COLUMNS, lines)


def _test_lines(row: Row) -> Iterable[tuple[Any, ...]]:
    about = (row.quantity, row.use, row.speed, row.item)
    over = (row.unit_of_analysis, row.n)
    no_difference = ("", "", "", "")
    if row.variance is not None:
        one_way = row.variance
        numbers = (one_way.f, one_way.between_df, one_way.within_df, one_way.p)
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


def _csv(columns: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    # Values that are not defined or unknown become empty cells.
    writer.writerows(
        ["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in line] for line in lines
    )
    return text.getvalue()
