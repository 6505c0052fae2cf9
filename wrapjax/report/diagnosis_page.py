"""The report of a diagnosis: one page that opens anywhere, offline.

The folder of a diagnosis, written whole or not at all.

Whether the diagnosis can be built on: the plain model's fit, and what it was weighed against.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

from wrapjax.diagnosis.result import ConvergenceCheck, DiagnosisResult
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.io.storage import write_storage
from wrapjax.report import markup
from wrapjax.report.diagnosis_effects import evidence_section, signature_section, ties_section
from wrapjax.report.diagnosis_location import muscles_section, where_section
from wrapjax.report.diagnosis_numbers import describe_diagnosis, moment_table
from wrapjax.report.diagnosis_shrinkage import released_section, shrinkage_section
from wrapjax.report.diagnosis_words import SILENT, findings, untested
from wrapjax.report.provenance import made_with
from wrapjax.report.run_summary import USES, file_stems
from wrapjax.report.style import counted, decimals, plain
from wrapjax.subject.subject import Subject

_DASH = "\N{EN DASH}"


def convergence_section(result: DiagnosisResult) -> str:
    """Write the part of the report on how far the diagnosis can be trusted, problems first."""
    convergence_check = result.convergence_check
    parts = _fit(convergence_check)
    if rows := [*_fit_rows(convergence_check), *_null_rows(result)]:
        caption = "The plain model's fit, and what evidence was weighed against."
        parts.append(markup.table(("check", "value", "what it says"), rows, caption=caption))
    return markup.section("How far to trust it", *parts, *_conflicts(convergence_check))


def _fit(convergence_check: ConvergenceCheck) -> list[str]:
    if convergence_check.problems:
        return [
            markup.paragraph("The plain model was not fitted as well as it can be:"),
            markup.bullets(convergence_check.problems),
        ]
    if not convergence_check.costs:
        return [markup.paragraph("The plain model was not fitted.")]
    return [markup.paragraph("The plain model was fitted as well as it can be.")]


def _conflicts(convergence_check: ConvergenceCheck) -> list[str]:
    if not convergence_check.conflicts:
        return []
    kinds = list(dict.fromkeys(kind for own in convergence_check.conflicts.values() for kind in own))
    return [
        markup.paragraph(
            "How far fits to each speed and to each half of the cycles are apart, root mean square. Well "
            "above 1: the model cannot fit both at once, or some cycles are not like the others."
        ),
        markup.table(
            ("", *map(plain, kinds)),
            [
                (plain(name), *(decimals(own.get(kind)) for kind in kinds))
                for name, own in convergence_check.conflicts.items()
            ],
            caption="Conflicts, in standard deviations.",
        ),
    ]


def _fit_rows(convergence_check: ConvergenceCheck) -> list[tuple[str, str, str]]:
    if not convergence_check.costs:
        return []
    costs = ", ".join(f"{cost:.5g}" for cost in convergence_check.costs[:4])
    more = len(convergence_check.costs) - 4
    return [
        (
            counted(len(convergence_check.costs), "start"),
            costs + (f" and {more} more" if more > 0 else ""),
            "cost where each start ended, lowest first (no unit)",
        ),
        ("spread", _percent(convergence_check.spread), "relative difference of the two lowest costs"),
        (
            "decrement",
            _percent(convergence_check.decrement),
            "by how much the cost could still fall, as a share of the explainable error",
        ),
    ]


def _null_rows(result: DiagnosisResult) -> list[tuple[str, str, str]]:
    controls = [effect for effect in result.effects if effect.negative_control]
    if not math.isfinite(result.detection_threshold):
        return []
    rows = [
        (
            "alarm level",
            f"{result.detection_threshold:.1f} nats",
            "evidence that data without any effect exceed in few cases",
        ),
        (
            "global p",
            _probability(result.global_p),
            "share of data without any effect whose strongest evidence exceeds what was found",
        ),
    ]
    if controls:
        strongest = max(controls, key=lambda effect: effect.evidence)
        quiet = "quiet" if strongest.evidence <= result.detection_threshold else "not quiet"
        rows.append(
            (
                counted(len(controls), "negative control"),
                f"{quiet}, {strongest.evidence:.1f} nats",
                f"strongest evidence for an effect that must stay quiet: {plain(strongest.id)}",
            )
        )
    return rows


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if math.isfinite(share) else _DASH


def _probability(p: float) -> str:
    if not math.isfinite(p):
        return _DASH
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


_SIDES = {"l": "left", "r": "right"}


def render_diagnosis(subject: Subject, result: DiagnosisResult, note: str = "") -> str:
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
            convergence_section(result),
            _notes(subject, result),
        ],
    )


def _leg(subject: Subject) -> str:
    paresis = {True: " (paretic)", False: " (not paretic)", None: ""}[subject.paretic]
    return f"{_SIDES[subject.side].capitalize()} leg{paresis}"


def _verdict(subject: Subject, result: DiagnosisResult) -> str:
    first, *others = findings(result)
    said = f"{_leg(subject)} of {subject.name}: {first[:1].lower()}{first[1:]}"
    return markup.verdict([said, " ".join(others), *untested(result)], fine=result.outcome not in SILENT)


def _untested_section(result: DiagnosisResult) -> list[str]:
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


def _notes(subject: Subject, result: DiagnosisResult) -> str:
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


def write_diagnosis(
    subject: Subject, result: DiagnosisResult, folder: Path, *, force: bool = False, note: str = ""
) -> None:
    """Write ``gap.json``, the moments of every recording and ``report.html``.

    Parameters
    ----------
    subject, result
        What was diagnosed, and what came of it.
    folder
        Where to; it appears when complete.
    force
        Replace a folder that exists.
    note
        A sentence about the data for the report.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or cannot be created.
    """
    with new_folder(folder, force=force) as gap:
        write_json(gap / "gap.json", describe_diagnosis(subject, result))
        for recording, stem in file_stems(tuple(dict.fromkeys(result.recordings))).items():
            write_storage(gap / "moments" / f"{stem}.sto", moment_table(result, recording))
        write_text(gap / "report.html", render_diagnosis(subject, result, note))
