"""Report of a diagnosis as a self-contained HTML page, and the folder that holds it."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

from wrapjax.diagnosis.fits.baseline import ConvergenceCheck
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.io.storage import write_storage
from wrapjax.muscle.personal_law import LAW_PARAMETERS
from wrapjax.muscle.published_laws import PUBLISHED_LAWS
from wrapjax.report import markup
from wrapjax.report.calibration.run_summary import USES, file_stems
from wrapjax.report.diagnosis.effects import evidence_section, signature_section, ties_section
from wrapjax.report.diagnosis.joints import uncertain_joints_section
from wrapjax.report.diagnosis.location import location_section, muscles_section, parts_section
from wrapjax.report.diagnosis.numbers import describe_diagnosis, moment_table
from wrapjax.report.diagnosis.shrinkage import released_section, shrinkage_section
from wrapjax.report.diagnosis.tasks import other_tasks_section
from wrapjax.report.diagnosis.words import INCONCLUSIVE, diagnosis_findings, gate_rows, untested_findings
from wrapjax.report.formatting import DASH, counted, decimals, leg_name, p_value, readable
from wrapjax.report.model_view.page import write_beside_report
from wrapjax.report.model_view.results import shown_diagnosis
from wrapjax.report.provenance import path_from, versions_platform_and_time
from wrapjax.subject.subject import Subject


def convergence_section(result: DiagnosisResult) -> str:
    """Write the report section on the convergence check of the plain model and on the detection threshold."""
    convergence_check = result.convergence_check
    parts = _convergence(result)
    if rows := [*_convergence_rows(convergence_check), *_null_rows(result)]:
        caption = "Convergence of the plain model's fit, and comparison of the evidence with null replicates."
        parts.append(markup.table(("check", "value", "meaning"), rows, caption=caption))
    return markup.section("Convergence and detection threshold", *parts, *_conflicts(convergence_check))


def _convergence(result: DiagnosisResult) -> list[str]:
    convergence_check = result.convergence_check
    if convergence_check.problems:
        examined = result.outcome != "insufficient_data"
        return [
            markup.paragraph(
                "The calibration of the plain model did not converge:"
                if examined
                else "The convergence of the plain model was not examined:"
            ),
            markup.bullets(convergence_check.problems),
        ]
    if not convergence_check.costs:
        return [markup.paragraph("The plain model was not fitted.")]
    return [markup.paragraph("The calibration of the plain model converged.")]


def _conflicts(convergence_check: ConvergenceCheck) -> list[str]:
    if not convergence_check.conflicts:
        return []
    kinds = list(dict.fromkeys(kind for values in convergence_check.conflicts.values() for kind in values))
    return [
        markup.paragraph(
            "Root mean square differences between the parameters of fits to each speed, and to each half of "
            "the cycles. A value well above 1 means that the model cannot fit both parts of the data with "
            "the same parameters, or that some cycles differ from the others."
        ),
        markup.table(
            ("fits", *map(readable, kinds)),
            [
                (readable(name), *(decimals(values.get(kind)) for kind in kinds))
                for name, values in convergence_check.conflicts.items()
            ],
            caption="Differences between parameters, in standard deviations.",
        ),
    ]


def _convergence_rows(convergence_check: ConvergenceCheck) -> list[tuple[str, str, str]]:
    if not convergence_check.costs:
        return []
    costs = ", ".join(f"{cost:.5g}" for cost in convergence_check.costs[:4])
    more = len(convergence_check.costs) - 4
    return [
        (
            counted(len(convergence_check.costs), "start"),
            costs + (f" and {more} more" if more > 0 else ""),
            "final cost of each start, lowest first (no unit)",
        ),
        ("spread", _percent(convergence_check.spread), "relative difference of the two lowest costs"),
        (
            "decrement",
            _percent(convergence_check.decrement),
            "possible further decrease of the cost, as a share of the explainable error",
        ),
    ]


def _null_rows(result: DiagnosisResult) -> list[tuple[str, str, str]]:
    controls = [effect for effect in result.effects if effect.negative_control]
    if not math.isfinite(result.detection_threshold):
        return []
    rows = [
        (
            "detection threshold",
            f"{result.detection_threshold:.1f} nats",
            "evidence that few null replicates exceed",
        ),
        (
            "global p",
            p_value(result.global_p),
            "share of null replicates whose strongest evidence exceeds the strongest evidence here",
        ),
    ]
    if controls:
        strongest = max(controls, key=lambda effect: effect.evidence)
        verdict = "below threshold" if strongest.evidence <= result.detection_threshold else "above threshold"
        rows.append(
            (
                counted(len(controls), "negative control"),
                f"{verdict}, {strongest.evidence:.1f} nats",
                f"strongest evidence for an effect that cannot be present: {readable(strongest.id)}",
            )
        )
    return rows


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if math.isfinite(share) else DASH


def render_diagnosis(subject: Subject, result: DiagnosisResult, note: str = "", link: str = "") -> str:
    """Write the report of a diagnosis as a self-contained HTML page.

    Parameters
    ----------
    subject, result
        Diagnosed subject and result of the diagnosis.
    note
        Important sentence about the data, shown at the top.
    link
        HTML below the title, such as a link to another page.
    """
    title = f"{subject.name}: diagnosis of the model's remaining error"
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
            link,
            *([markup.paragraph(note)] if note else []),
            _verdict_section(subject, result),
            _gates_section(result),
            evidence_section(result),
            other_tasks_section(result),
            shrinkage_section(result),
            released_section(result),
            ties_section(result),
            location_section(result),
            parts_section(result),
            signature_section(result),
            muscles_section(result),
            _untested_section(result),
            _muscle_law_section(result),
            uncertain_joints_section(result.joints),
            convergence_section(result),
            _notes_section(subject, result),
        ],
    )


def _leg(subject: Subject) -> str:
    paresis = {True: " (paretic)", False: " (not paretic)", None: ""}[subject.paretic]
    return f"{leg_name(subject.side)}{paresis}"


def _verdict_section(subject: Subject, result: DiagnosisResult) -> str:
    first, *others = diagnosis_findings(result)
    conclusion = f"{_leg(subject)} of {subject.name}: {first[:1].lower()}{first[1:]}"
    return markup.verdict(
        [conclusion, " ".join(others), *untested_findings(result)],
        fine=result.outcome not in INCONCLUSIVE,
    )


def _gates_section(result: DiagnosisResult) -> str:
    """Write the report section on the gates; empty where none was examined."""
    rows = gate_rows(result)
    if not rows:
        return ""
    return markup.section(
        "What a name has to pass",
        markup.paragraph(
            "An effect is named only if it passes four gates, whatever its probability. Where nothing is "
            "claimed, the first gate concerns the plain model."
        ),
        markup.table(("gate", "question", "figure", "result"), rows, caption="Gates of this diagnosis."),
    )


def _untested_section(result: DiagnosisResult) -> str:
    untested = (*result.not_testable, *result.undetectable)
    if not untested:
        return ""
    return markup.section(
        "Effects that this recording cannot test",
        markup.paragraph("These effects may be present; the diagnosis makes no statement about them."),
        markup.table(
            ("effect", "id", "reason"),
            [(readable(effect.id), effect.id, effect.reason) for effect in untested],
            caption="Effects of the catalogue that these data cannot show.",
        ),
    )


def _muscle_law_section(result: DiagnosisResult) -> str:
    """Write the report section on the person's muscle law; empty without a diagnosis."""
    if not result.law_evidence:
        return ""
    rows = [
        (name, PUBLISHED_LAWS[name].meaning, f"{evidence:.1f}", PUBLISHED_LAWS[name].source)
        for name, evidence in sorted(result.law_evidence.items(), key=lambda entry: -entry[1])
    ]
    parameters = [
        (one.name, one.meaning, f"{result.muscle_law[one.name]:.2f}", f"{one.prior_sd:g}")
        for one in LAW_PARAMETERS
    ]
    return markup.section(
        "Muscle law of the person",
        markup.paragraph(
            "The curves and activation dynamics of all muscles were fitted to this person within a "
            "continuous family of laws. Evidence for a published law is positive where the recording "
            "supports it against the whole family. Values far below zero are approximate, as the model is "
            "linearised about the law that was found. The comparison is that of the plain model: an "
            "effect that is present can distort it."
        ),
        markup.table(
            ("law", "meaning", "evidence, nats", "source"),
            rows,
            caption="Evidence for published muscle laws against the family.",
        ),
        markup.table(
            ("parameter", "meaning", "value", "prior standard deviation"),
            parameters,
            caption="Parameters of the law that was found; all are zero for the law of the NMSM Pipeline.",
        ),
    )


def _notes_section(subject: Subject, result: DiagnosisResult) -> str:
    parts = [
        markup.bullets(
            [
                "The effect that explains an error best need not be present: effects that are not in the "
                "catalogue, or cannot be tested with these data, may explain it better.",
                "Measured and predicted moments of every cycle are in moments/; gap.json contains all "
                "numbers.",
                f"Subject folder {subject.folder.name}, model {subject.model_file.name}.",
                f"{versions_platform_and_time()}.",
            ]
        )
    ]
    if result.seconds:
        rows = [(readable(name), f"{time:.1f}") for name, time in result.seconds.items()]
        rows.append(("total", f"{sum(result.seconds.values()):.1f}"))
        parts.append(markup.table(("step", "seconds"), rows, caption="Computing time.", total=True))
    return markup.section("Notes", *parts)


def write_diagnosis(
    subject: Subject,
    result: DiagnosisResult,
    folder: Path,
    *,
    force: bool = False,
    note: str = "",
    motion: bool = False,
) -> None:
    """Write ``gap.json``, the moments of every recording and ``report.html``.

    Parameters
    ----------
    subject, result
        Diagnosed subject and result of the diagnosis.
    folder
        Folder to write; it appears when it is complete.
    force
        Whether to replace an existing folder.
    note
        Important sentence about the data for the report.
    motion
        Whether to write a page beside the report that shows the error on the model in motion.

    Raises
    ------
    InputError
        If the folder exists and ``force`` is not set, or cannot be created.
    """
    with new_folder(folder, force=force) as target:
        folder_of_subject = {"subject_folder": path_from(target, subject.folder)}
        write_json(target / "gap.json", describe_diagnosis(subject, result) | folder_of_subject)
        for recording, stem in file_stems(tuple(dict.fromkeys(result.recordings))).items():
            write_storage(target / "moments" / f"{stem}.sto", moment_table(result, recording))
        link = write_beside_report(target, shown_diagnosis(target, subject)) if motion else ""
        write_text(target / "report.html", render_diagnosis(subject, result, note, link))
