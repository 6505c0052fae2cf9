"""The page of lengths to start from, as one HTML file that opens anywhere, offline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from wrapjax.calibrate.initial_lengths import LONGEST, SHORTEST
from wrapjax.report import markup
from wrapjax.report.initialisation.figures import PassiveCurves, passive_figure, range_figure
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.wording import counted, decimals


def render_initialisation(content: dict[str, Any], passive: Sequence[PassiveCurves]) -> str:
    """Write what lengths were found, and why, as a page with nothing outside it.

    Parameters
    ----------
    content
        Of ``initialisation.json``.
    passive
        Recorded and modelled passive moments; empty where none were recorded.
    """
    title = f"{content['subject']}: lengths to start from"
    parts = [
        markup.header(title, f"Of {counted(len(content['muscles']), 'muscle')}."),
        _verdict(content),
    ]
    if passive:
        parts.append(_passive_section(content, passive))
    parts += [_lengths_section(content), _notes()]
    return markup.page(title, parts)


def _verdict(content: dict[str, Any]) -> str:
    fine = content["converged"]
    first = "Lengths were found." if fine else f"Lengths are not final. {content['message']}"
    errors = [
        f"Passive moments about {name} are missed by {decimals(own['after'])} N m on average, by "
        f"{decimals(own['before'])} N m with the model's own lengths."
        for name, own in content["passive_mae_Nm"].items()
    ]
    said = [*errors, *content["notes"]]
    return markup.verdict([first, *said], fine=fine)


def _passive_section(content: dict[str, Any], passive: Sequence[PassiveCurves]) -> str:
    return markup.section(
        "Passive moments",
        markup.picture(
            passive_figure(passive),
            alternative="Recorded passive moments over the joint's angle, and what muscles at rest make.",
            caption="Moments while somebody else moved the leg: recorded, and what muscles at rest make with "
            "the model's lengths (gray) and with those found (blue).",
        ),
        markup.table(
            ("coordinate", "before", "after"),
            [
                (name, decimals(own["before"]), decimals(own["after"]))
                for name, own in content["passive_mae_Nm"].items()
            ],
            caption="Mean absolute error in N m.",
        ),
    )


def _lengths_section(content: dict[str, Any]) -> str:
    rows = []
    for muscle, own in content["muscles"].items():
        cells = [muscle]
        for name in ("optimal_fiber_length_m", "tendon_slack_length_m"):
            pair = own[name]
            cells += [f"{1e3 * pair['before']:.1f}", f"{1e3 * pair['after']:.1f}"]
            cells.append(f"{100.0 * (pair['after'] / pair['before'] - 1.0):.0f}")
        rows.append(cells)
    header = [f"{kind}, {what}" for kind in ("fiber", "slack") for what in ("before", "after", "change (%)")]
    return markup.section(
        "Lengths",
        markup.picture(
            range_figure(content["muscles"], SHORTEST, LONGEST),
            alternative="Range of normalised fiber lengths in walking, before and after, by muscle.",
            caption="Shortest to longest normalised fiber length in walking, with the model's lengths (gray) "
            "and with those found (blue).",
        ),
        markup.table(("muscle", *header), rows, caption="Optimal fiber and tendon slack lengths in mm."),
    )


def _notes() -> str:
    return markup.section(
        "Notes",
        markup.bullets(
            [
                "Name muscle_parameters.csv in subject.toml, under [model], to calibrate from these.",
                "Strengths and pennation stay what the model says.",
                f"{versions_in_words()}.",
            ]
        ),
    )
