"""Contact forces as plain text for a terminal."""

from __future__ import annotations

import textwrap

from wrapjax.api.runs.contact_force import Contact
from wrapjax.api.tables.comparison import mean_and_deviation


def contact_table(contact: Contact) -> str:
    """Show what the forces are, and the peaks of each joint by each run."""
    from wrapjax.contact.result import peaks, stretches
    from wrapjax.evaluate.statistics import spread
    from wrapjax.report.contact.numbers import compared_peaks, tests_reason
    from wrapjax.report.contact.page import sentences, undriven_sentences

    result = contact.result
    lines = [textwrap.fill(sentences(result)[0], 100), ""]
    lines.append(f"{'peak':24s}{'run':16s}{'bodyweights':>18s}{'N':>18s}{'% of cycle':>14s}")
    for part in result.parts:
        for measure, stretch in stretches(part).items():
            for run in result.runs:
                found = peaks(result.curves(run, part), result.phase, stretch)
                of_units = ((found.force / result.bodyweight, 2), (found.force, 0), (found.phase, 0))
                cells = [mean_and_deviation(spread(own), digits) for own, digits in of_units]
                name = f"{part}, {measure.replace('_', ' ')}"
                lines.append(f"{name:24s}{run.label:16s}{cells[0]:>18s}{cells[1]:>18s}{cells[2]:>14s}")
    lines.append("")
    if reason := tests_reason(result):
        lines.append(f"not tested: {reason}")
    for joint, measure, test in compared_peaks(result):
        if test is not None:
            lines.append(
                f"{joint}, {measure.replace('_', ' ')}: {result.runs[1].label} less {result.runs[0].label} "
                f"{test.difference:+.3f} bodyweights (95 % {test.low:.3f} to {test.high:.3f}), paired t-test "
                f"over {test.n} cycles: p = {test.p:.2g}"
            )
    lines += [textwrap.fill(sentence, 100) for sentence in undriven_sentences(result)]
    return "\n".join([*lines, *sentences(result)[1 + len(result.runs) :]])
