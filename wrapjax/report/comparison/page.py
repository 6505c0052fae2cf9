"""Report of a comparison of calibration methods as a self-contained HTML page, and the files beside it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from wrapjax.comparison.samples import ALL_SPEEDS, MEAN, ComparedLeg, unit_of_analysis
from wrapjax.io.files import write_json, write_text
from wrapjax.report import markup
from wrapjax.report.calibration.run_summary import USES
from wrapjax.report.comparison.figures import (
    compared_moment_arms_figure,
    compared_moments_figure,
    drawn_together,
    methods_that_move,
    most_moved,
)
from wrapjax.report.comparison.summary import Row, describe_comparison, note
from wrapjax.report.comparison.tables import (
    cycles_csv,
    differences_csv,
    mean_table,
    means_csv,
    muscle_tests_table,
    paired_table,
    parameter_table,
    tukey_table,
    variance_table,
)
from wrapjax.report.formatting import DASH, counted, decimals
from wrapjax.report.paths.moved_paths import MOST_MUSCLES, moved_paths
from wrapjax.report.paths.path_views import path_views
from wrapjax.report.provenance import versions_in_words


def render_comparison(legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row]) -> str:
    """Write the report of a comparison as a self-contained HTML page."""
    subject = legs[0].label if len(legs) == 1 else counted(len(legs), "leg")
    title = f"{subject}: {', '.join(methods[:-1])} and {methods[-1]} compared"
    cycles = [f"{sum(leg.recorded.uses.count(use) for leg in legs)} for {use}" for use in USES]
    under = f"Gait cycles: {', '.join(cycles)}. {datetime.now(UTC).date().isoformat()}."
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict_section(legs, methods, rows),
            _errors_section(legs, methods, rows),
            _moments_section(legs, methods),
            _paths_section(legs, methods, rows),
            _muscles_section(methods, rows),
            _runs_section(legs, methods),
            _notes_section(),
        ],
    )


def comparison_findings(
    legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row]
) -> list[str]:
    """Write sentences on convergence and moment errors of the compared calibrations."""
    failed = [
        f"{leg.label} by {method}"
        for leg in legs
        for method in methods
        if not leg.results[method].solution.status.converged
    ]
    count = len(legs) * len(methods)
    first = f"All {count} calibrations converged."
    if failed:
        first = f"{len(failed)} of {count} calibrations did not converge: {', '.join(failed)}."
    sentences = [first]
    for use in USES:
        row = _mean_error_row(rows, use)
        if row is None:
            sentences.append(f"There are no {use} cycles.")
            continue
        means = [f"{method} {decimals(row.spreads[method].mean)} N m" for method in methods]
        sentences.append(f"Mean absolute moment error on {use} cycles: {', '.join(means)}.")
    return sentences


def _mean_error_row(rows: Sequence[Row], use: str) -> Row | None:
    key = ("moment_error", use, ALL_SPEEDS, MEAN)
    return next((row for row in rows if (row.quantity, row.use, row.speed, row.item) == key), None)


def _verdict_section(legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row]) -> str:
    first, *others = comparison_findings(legs, methods, rows)
    converged = all(result.solution.status.converged for leg in legs for result in leg.results.values())
    return markup.verdict([first, " ".join(others), note(legs)], fine=converged)


def _errors_section(legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row]) -> str:
    parts = []
    for use in USES:
        errors = [row for row in rows if row.quantity == "moment_error" and row.use == use]
        if not errors:
            continue
        all_speeds = [row for row in errors if row.speed == ALL_SPEEDS]
        parts += [
            mean_table(
                errors,
                methods,
                caption=f"{use.capitalize()} cycles: mean absolute error of joint moments in N m, mean ± "
                f"standard deviation over {errors[0].unit_of_analysis}s. * differs from {methods[0]}: "
                "paired t-test, p < 0.05 after Holm's correction for the number of coordinates (no "
                "correction for the mean over coordinates).",
            ),
        ]
        if not any(row.variance for row in all_speeds):
            parts.append(markup.paragraph(f"Too few {errors[0].unit_of_analysis}s for tests."))
            continue
        parts += [
            variance_table(
                all_speeds,
                caption=f"{use.capitalize()} cycles, {ALL_SPEEDS}: tests of any difference between methods. "
                "One-way analysis of variance, which treats methods as independent groups, and "
                "repeated-measures analysis of variance (p with Greenhouse and Geisser's correction), which "
                f"accounts for the methods' use of the same {errors[0].unit_of_analysis}s.",
            ),
            tukey_table(
                all_speeds,
                caption=f"{use.capitalize()} cycles, {ALL_SPEEDS}: differences between pairs of methods in "
                "N m (below zero: smaller error), in brackets p of Tukey and Kramer's post-hoc test of the "
                "one-way analysis of variance.",
            ),
            paired_table(
                all_speeds,
                caption=f"{use.capitalize()} cycles, {ALL_SPEEDS}: paired comparison of each method with "
                f"{methods[0]}. Differences in N m with 95 % confidence intervals, t-tests with Holm's "
                "correction for the number of coordinates, and Cohen's d for paired values.",
            ),
        ]
    return markup.section("Moment errors", *parts)


def _moments_section(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> str:
    unit = unit_of_analysis(legs, "cycle")
    pictures = [
        markup.picture(
            compared_moments_figure(group, methods),
            alternative=f"Joint moments of {label} over the gait cycle: measured, and modelled after "
            f"calibration by {', '.join(methods)}.",
            caption=f"Net joint moments of {label} in N m over the gait cycle: measured (black, mean ± one "
            f"standard deviation over {unit}s) and each method's mean. A positive moment acts towards larger "
            "values of the coordinate, as OpenSim defines it.",
        )
        for label, group in drawn_together(legs, unit)
    ]
    return markup.section("Joint moments", *pictures)


def _paths_section(legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row]) -> str:
    moving = methods_that_move(legs, methods)
    if not moving:
        return markup.section("Muscle paths", markup.paragraph("No method changed a muscle path."))
    unit = unit_of_analysis(legs, "cycle")
    most = MOST_MUSCLES if len(legs) == 1 else 2
    parts = []
    for quantity, words in (("length_change", "muscle-tendon lengths"), ("moment_arm_change", "moment arms")):
        changes = [row for row in rows if row.quantity == quantity]
        parts.append(
            mean_table(
                changes,
                moving,
                caption=f"Mean absolute change of {words} in mm against the nominal paths, over the muscles "
                f"that span a coordinate ('{MEAN}': over all) and all cycles; mean ± standard deviation over "
                f"{unit}s.",
            )
        )
        if len(moving) > 1:
            parts.append(
                paired_table(
                    changes,
                    caption=f"Changes of {words}: differences between methods in mm, with 95 % confidence "
                    "intervals and paired t-tests.",
                )
            )
    for label, together in drawn_together(legs, unit):
        if not most_moved(together, methods):
            continue
        muscle, coordinate = most_moved(together, methods)[0]
        parts.append(
            markup.picture(
                compared_moment_arms_figure(together, methods),
                alternative=f"Moment arms of {label} before and after calibration; that of {muscle} about "
                f"{coordinate} changed most.",
                caption=f"Moment arms of {label} in mm over the gait cycle, all cycles: nominal (dashed) "
                "and by each method that changes paths, mean ± one standard deviation. Shown are those that "
                "changed most on average by any method, largest change first. Scales differ.",
            )
        )
    parts += [
        path_views(moved_paths(leg.subject, result, leg.model, most), of=f"{leg.label} by {method}")
        for leg in legs
        if leg.model is not None
        for method, result in leg.results.items()
    ]
    return markup.section("Muscle paths", *parts)


def _muscles_section(methods: Sequence[str], rows: Sequence[Row]) -> str:
    tables = [
        muscle_tests_table(
            [row for row in rows if row.quantity == quantity],
            caption=f"{words}, mean over the gait cycle, all cycles: averages over muscles, and number of "
            "muscles that differ (paired t-test, p < 0.05 after Holm's correction for the number of "
            "muscles). Individual muscles: tests.csv.",
        )
        for quantity, words in (
            ("muscle_force", "Tendon forces in N"),
            ("activation", "Muscle activations (0 to 1)"),
        )
    ]
    parameters = [row for row in rows if row.quantity == "parameter"]
    if parameters:
        tables.append(
            parameter_table(
                parameters,
                methods,
                caption="Calibrated parameters, mean ± standard deviation over "
                f"{parameters[0].unit_of_analysis}s. * differs from {methods[0]}: paired t-test, p < 0.05 "
                "after Holm's correction for the number of parameters.",
            )
        )
    return markup.section("Muscle forces, activations and parameters", *tables)


def _runs_section(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> str:
    lines = []
    for leg in legs:
        for method in methods:
            result = leg.results[method]
            lines.append(
                (
                    f"{leg.label}, {method}",
                    "yes" if result.solution.status.converged else "no",
                    f"{result.solution.cost:#.5g}",
                    str(len(result.outcomes)),
                    str(len(result.solution.variables)),
                    leg.geometry.get(method, DASH),
                    f"{result.compile_seconds:.1f}",
                    f"{result.solve_seconds:.1f}",
                    leg.folders[method],
                )
            )
    header = (
        *("calibration", "converged", "cost", "starts", "variables", "path source"),
        *("compilation (s)", "solution (s)", "folder with its report"),
    )
    caption = (
        "Result of each calibration. Path source: surrogate, fitted polynomials; engine, exact wrapping. The "
        "two differ by the error of the polynomials even before calibration."
    )
    return markup.section("Calibrations", markup.table(header, lines, caption=caption))


def _notes_section() -> str:
    return markup.section(
        "Notes",
        markup.bullets(
            [
                "A lower error is no evidence that the changed paths or parameters are closer to the "
                "subject's anatomy.",
                "All means are in means.csv, all tests in tests.csv, the error of every cycle in "
                "cycles.csv; comparison.json contains the same in machine-readable form. Names are without "
                "'_l' and '_r'.",
                "d_z: mean of the paired differences divided by their standard deviation (Cohen 1988).",
                "A dash means not defined, or too few observations.",
                f"{versions_in_words()}.",
            ]
        ),
    )


def write_comparison(
    legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row], folder: Path
) -> None:
    """Write ``comparison.json``, ``means.csv``, ``tests.csv``, ``cycles.csv`` and ``report.html``."""
    write_json(folder / "comparison.json", describe_comparison(legs, methods, rows))
    write_text(folder / "means.csv", means_csv(rows))
    write_text(folder / "tests.csv", differences_csv(rows))
    write_text(folder / "cycles.csv", cycles_csv(legs, methods))
    write_text(folder / "report.html", render_comparison(legs, methods, rows))
