"""The report of a diagnosis: one page that opens anywhere, offline."""

from __future__ import annotations

from datetime import UTC, datetime

from wrapjax.gap.result import GapResult
from wrapjax.report import markup
from wrapjax.report.gap.certificate_section import certificate_section
from wrapjax.report.gap.effects_section import evidence_section, signature_section
from wrapjax.report.gap.muscles_section import muscles_section
from wrapjax.report.gap.shrinkage_section import released_section, shrinkage_section
from wrapjax.report.gap.ties_section import ties_section
from wrapjax.report.gap.where_section import where_section
from wrapjax.report.gap.words import SILENT, findings, untested
from wrapjax.report.provenance import made_with
from wrapjax.report.summary import USES
from wrapjax.report.wording import counted, plain
from wrapjax.subject import Subject

_SIDES = {"l": "left", "r": "right"}


def render_gap(subject: Subject, result: GapResult, note: str = "") -> str:
    """Write the report of a diagnosis as one HTML page with nothing outside it.

    Parameters
    ----------
    subject, result
        Whose, and what came of it.
    note
        A sentence about the data that readers must not miss.
    """
    title = f"{subject.name}: what the model leaves out"
    counts = {use: result.uses.count(use) for use in USES}
    under = (
        f"{_leg(subject)}, {subject.mass_kg:g} kg, {counted(len(result.coordinates), 'coordinate')}, "
        f"{counted(counts['calibration'], 'gait cycle')} for calibration and {counts['validation']} for "
        f"validation. {datetime.now(UTC).date().isoformat()}."
    )
    return markup.page(
        title,
        [
            markup.header(title, under),
            *([markup.paragraph(note)] if note else []),
            _verdict(subject, result),
            *_untested_section(result),
            *where_section(result),
            *signature_section(result),
            *evidence_section(result),
            *shrinkage_section(result),
            *released_section(result),
            *ties_section(result),
            *muscles_section(result),
            certificate_section(result),
            _notes(subject, result),
        ],
    )


def _leg(subject: Subject) -> str:
    paresis = {True: " (paretic)", False: " (not paretic)", None: ""}[subject.paretic]
    return f"{_SIDES[subject.side].capitalize()} leg{paresis}"


def _verdict(subject: Subject, result: GapResult) -> str:
    first, *others = findings(result)
    said = f"{_leg(subject)} of {subject.name}: {first[:1].lower()}{first[1:]}"
    return markup.verdict([said, " ".join(others), *untested(result)], fine=result.outcome not in SILENT)


def _untested_section(result: GapResult) -> list[str]:
    if not result.not_testable:
        return []
    return [
        markup.section(
            "What this recording cannot test",
            markup.paragraph("These effects may be there all the same: nothing is said of them."),
            markup.table(
                ("effect", "in files", "why not"),
                [(plain(one.id), one.id, one.reason) for one in result.not_testable],
                caption="Effects of the catalogue that these data lack something for.",
            ),
        )
    ]


def _notes(subject: Subject, result: GapResult) -> str:
    parts = [
        markup.bullets(
            [
                "What explains an error best need not be there: effects that are not in the catalogue, or "
                "cannot be tested with these data, may explain it better.",
                "Moments before and after, of every cycle, are in moments/; gap.json holds all numbers.",
                f"Subject folder {subject.folder.name}, model {subject.model_file.name}.",
                f"{made_with()}.",
            ]
        )
    ]
    if result.seconds:
        rows = [(plain(name), f"{own:.1f}") for name, own in result.seconds.items()]
        rows.append(("together", f"{sum(result.seconds.values()):.1f}"))
        parts.append(markup.table(("step", "seconds"), rows, caption="How long it took.", total=True))
    return markup.section("Notes", *parts)
