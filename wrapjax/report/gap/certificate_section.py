"""Whether the diagnosis can be built on: the plain model's fit, and what it was weighed against."""

from __future__ import annotations

import math

from wrapjax.gap.result import Certificate, GapResult
from wrapjax.report import markup
from wrapjax.report.wording import counted, decimals, plain

_DASH = "\N{EN DASH}"


def certificate_section(result: GapResult) -> str:
    """Write the part of the report on how far the diagnosis can be trusted, problems first."""
    certificate = result.certificate
    parts = _fit(certificate)
    if rows := [*_fit_rows(certificate), *_null_rows(result)]:
        caption = "The plain model's fit, and what evidence was weighed against."
        parts.append(markup.table(("check", "value", "what it says"), rows, caption=caption))
    return markup.section("How far to trust it", *parts, *_conflicts(certificate))


def _fit(certificate: Certificate) -> list[str]:
    if certificate.problems:
        return [
            markup.paragraph("The plain model was not fitted as well as it can be:"),
            markup.bullets(certificate.problems),
        ]
    if not certificate.costs:
        return [markup.paragraph("The plain model was not fitted.")]
    return [markup.paragraph("The plain model was fitted as well as it can be.")]


def _conflicts(certificate: Certificate) -> list[str]:
    if not certificate.conflicts:
        return []
    kinds = list(dict.fromkeys(kind for own in certificate.conflicts.values() for kind in own))
    return [
        markup.paragraph(
            "How far fits to each speed and to each half of the cycles are apart, root mean square. Well "
            "above 1: the model cannot fit both at once, or some cycles are not like the others."
        ),
        markup.table(
            ("", *map(plain, kinds)),
            [
                (plain(name), *(decimals(own.get(kind)) for kind in kinds))
                for name, own in certificate.conflicts.items()
            ],
            caption="Conflicts, in standard deviations.",
        ),
    ]


def _fit_rows(certificate: Certificate) -> list[tuple[str, str, str]]:
    if not certificate.costs:
        return []
    costs = ", ".join(f"{cost:.5g}" for cost in certificate.costs[:4])
    more = len(certificate.costs) - 4
    return [
        (
            counted(len(certificate.costs), "start"),
            costs + (f" and {more} more" if more > 0 else ""),
            "cost where each start ended, lowest first (no unit)",
        ),
        ("spread", _percent(certificate.spread), "relative difference of the two lowest costs"),
        (
            "decrement",
            _percent(certificate.decrement),
            "by how much the cost could still fall, as a share of the explainable error",
        ),
    ]


def _null_rows(result: GapResult) -> list[tuple[str, str, str]]:
    controls = [effect for effect in result.effects if effect.negative_control]
    if not math.isfinite(result.alarm):
        return []
    rows = [
        (
            "alarm level",
            f"{result.alarm:.1f} nats",
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
        quiet = "quiet" if strongest.evidence <= result.alarm else "not quiet"
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
