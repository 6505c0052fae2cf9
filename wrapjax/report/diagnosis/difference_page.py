"""Page and JSON of the difference between two conditions of one person."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.diagnosis.conditions.condition_contrast import DifferenceResult
from wrapjax.diagnosis.effects.effect import Effect
from wrapjax.diagnosis.evidence.score_test import Score
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.report import markup
from wrapjax.report.cycle_panels import label_gait_cycles
from wrapjax.report.formatting import counted, decimals, leg_name, readable
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    PAGE_WIDTH,
    Figure,
    draw_zero_line,
    head_column,
    in_style,
    legend_above,
    panel_grid,
)

#: Version of the layout of ``difference.json``.
SCHEMA = 1
#: Number of effects that the page lists.
_SHOWN = 12


def difference_findings(difference: DifferenceResult) -> list[str]:
    """Write sentences on what differs, how far it is explained, and from how many cycles."""
    first, second = difference.conditions
    contrast = difference.contrast
    names = [
        f"{direction.id} in {_condition(difference, direction.first)}" for _, direction in difference.leading
    ]
    threshold = f"{contrast.threshold:.1f} nats"
    if difference.outcome == "none":
        found = f"No effect of the catalogue is above the threshold of {threshold} in one condition alone."
    elif difference.outcome == "unknown":
        found = _unexplained(difference)
    elif difference.outcome == "named":
        score = difference.leading[0][0]
        evidence = f"{score.evidence:.1f} nats, threshold {threshold}"
        found = f"What differs is best explained by {names[0]} ({evidence})."
    else:
        found = f"Several effects explain the difference about as well: {', '.join(names)}."
    share = contrast.explained
    if difference.outcome == "none" or not math.isfinite(share):
        explained = ""
    else:
        explained = (
            f"The strongest explains {100.0 * share:.0f} % of the difference above noise on cycles that its "
            "size was not determined on."
        )
    size = float(np.sqrt(np.mean(contrast.difference**2)))
    noise = float(np.sqrt(np.mean(contrast.noise**2)))
    amount = (
        f"The residuals of {counted(difference.cycles[0], 'cycle')} of {first} and {difference.cycles[1]} of "
        f"{second} differ by {size:.2f} N m (root mean square); cycle noise alone makes {noise:.2f} N m."
    )
    return [found, explained, amount]


def _unexplained(difference: DifferenceResult) -> str:
    """Write why no effect is named although something differs."""
    contrast = difference.contrast
    reason = "the difference"
    if difference.leading:
        direction = difference.leading[0][1]
        reason = f"what the strongest ({direction.id} in {_condition(difference, direction.first)})"
        if contrast.remaining <= contrast.allowed_remaining:
            reason += " explains does not hold on cycles that its size was not determined on"
        else:
            reason += " leaves of the difference"
    if contrast.remaining > contrast.allowed_remaining:
        reason += f" has {contrast.remaining:.2f} times the variance of known errors, chance at most "
        reason += f"{contrast.allowed_remaining:.2f} times"
    return f"Something differs that no effect of the catalogue explains: {reason}."


def _condition(difference: DifferenceResult, first: bool) -> str:
    return f"'{difference.conditions[0 if first else 1]}'"


def _sizes(score: Score, effect: Effect) -> list[dict[str, Any]]:
    return [
        {"name": one.name, "value": value, "sd": sd, "unit": one.unit}
        for one, value, sd in zip(
            effect.parameters, score.effect_sizes.tolist(), score.sd.tolist(), strict=True
        )
        if sd > 0.0
    ]


def describe_difference(difference: DifferenceResult) -> dict[str, Any]:
    """Describe a difference of conditions as plain numbers and strings: the content of ``difference.json``.

    Returns
    -------
    dict
        ``outcome`` (``none``, ``named``, ``tie`` or ``unknown``) with the effects in ``named`` or ``ties``;
        ``remaining`` and ``allowed_remaining`` of the difference, in variances of the null hypothesis;
        ``effects``, the strongest evidence first, each with the condition that has it; ``explained_share`` on
        unseen cycles, null where the difference does not exceed noise; ``where``, the difference by
        coordinate, speed and phase (N m), with what the strongest effect explains.
    """
    contrast = difference.contrast
    leading = [
        {"id": direction.id, "condition": difference.conditions[0 if direction.first else 1]}
        for _, direction in difference.leading
    ]
    phases = contrast.difference.shape[-1]
    where = [
        {
            "coordinate": name,
            "speed_m_s": None if math.isnan(speed) else speed,
            "phase_percent": [100.0 * phase / phases, 100.0 * (phase + 1) / phases],
            "difference_Nm": float(contrast.difference[row, column, phase]),
            "explained_Nm": float(contrast.predicted[row, column, phase]),
            "measured_difference_Nm": float(difference.measured_difference[row, column, phase]),
        }
        for row, speed in enumerate(difference.speeds.tolist())
        for column, name in enumerate(difference.coordinates)
        for phase in range(phases)
    ]
    return {
        "schema": SCHEMA,
        "subject": difference.subject.name,
        "conditions": list(difference.conditions),
        "cycles": list(difference.cycles),
        "outcome": difference.outcome,
        "named": leading if difference.outcome == "named" else [],
        "ties": leading if difference.outcome == "tie" else [],
        "threshold_nats": contrast.threshold,
        "remaining": contrast.remaining,
        "allowed_remaining": contrast.allowed_remaining,
        "explained_share": contrast.explained if math.isfinite(contrast.explained) else None,
        "effects": [
            {
                "id": direction.id,
                "condition": difference.conditions[0 if direction.first else 1],
                "evidence_nats": score.evidence,
                "detectability": score.detectability,
                "parameters": _sizes(score, difference.effects[direction.id]),
            }
            for score, direction in zip(contrast.scores, contrast.directions, strict=True)
        ],
        "where": sorted(where, key=lambda one: -abs(one["difference_Nm"])),
        "not_testable": [{"id": one.id, "reason": one.reason} for one in difference.not_testable],
    }


@in_style
def difference_figure(difference: DifferenceResult) -> Figure:
    """Draw the difference of the residuals over the gait cycle, and what the strongest effect explains."""
    contrast = difference.contrast
    columns = len(difference.speeds)
    count = len(difference.coordinates) * columns
    width = PAGE_WIDTH if columns > 1 else PAGE_WIDTH / 2
    figure, panels = panel_grid(count, columns, width=width, panel_height=1.6, sharex=True, sharey="row")
    percent = 100.0 * np.arange(contrast.difference.shape[-1]) / contrast.difference.shape[-1]
    for number, panel in enumerate(panels):
        row, column = divmod(number, columns)
        noise = float(contrast.noise[row])
        draw_zero_line(panel)
        panel.axhspan(-noise, noise, color=GRAY, alpha=0.25, linewidth=0, label="one s.d. of cycle noise")
        panel.plot(percent, contrast.difference[column, row], color=BLACK, label="difference of residuals")
        if difference.outcome != "none":
            panel.plot(percent, contrast.predicted[column, row], color=BLUE, label="strongest effect")
        panel.set_title(difference.coordinates[row], loc="left", parse_math=False)
        if columns > 1 and row == 0:
            speed = float(difference.speeds[column])
            head_column(panel, "speed not given" if math.isnan(speed) else f"{speed:g} m/s")
    label_gait_cycles(panels, columns, y="moment (N m)")
    legend_above(figure, panels[0])
    return figure


def render_difference(difference: DifferenceResult) -> str:
    """Write the report of a difference of conditions as a self-contained HTML page."""
    subject, contrast = difference.subject, difference.contrast
    first, second = difference.conditions
    rows = [
        (
            direction.id,
            difference.conditions[0 if direction.first else 1],
            decimals(score.evidence, 1),
            decimals(score.detectability, 1),
            "; ".join(
                f"{readable(one['name'])} {one['value']:.3g} ± {one['sd']:.2g}"
                + ("" if one["unit"] == "1" else f" {one['unit']}")
                for one in _sizes(score, difference.effects[direction.id])[:3]
            ),
        )
        for score, direction in list(zip(contrast.scores, contrast.directions, strict=True))[:_SHOWN]
    ]
    return markup.page(
        f"{subject.name}: {first} against {second}",
        [
            markup.header(
                f"{subject.name}: {first} against {second}",
                f"{leg_name(subject.side)}, {subject.mass_kg:g} kg.",
            ),
            markup.verdict(difference_findings(difference), fine=difference.outcome in ("none", "named")),
            markup.section(
                "Where the conditions differ",
                markup.picture(
                    difference_figure(difference),
                    alternative=f"Difference of the residuals of {first} and {second} over the gait cycle.",
                    caption=f"Mean residual (measured less predicted moment, N m) of {first} less that of "
                    f"{second} at the same speed. The model was calibrated to both together, so that its "
                    "errors that are the same in both cancel.",
                ),
            ),
            markup.section(
                "Effects of one condition alone",
                markup.table(
                    ("effect", "condition", "evidence, nats", "detectability", "size"),
                    rows,
                    caption=f"The {len(rows)} effects with the strongest evidence, each in one condition and "
                    "not in the other. The threshold is the evidence that 5 % of random reassignments of the "
                    f"cycles to the conditions exceed, {contrast.threshold:.1f} nats.",
                ),
            ),
            markup.section(
                "Not testable",
                markup.bullets([f"{one.id}: {one.reason}" for one in difference.not_testable] or ["None."]),
            ),
            markup.section("Notes", markup.bullets(list(subject.notes) or ["None."])),
        ],
    )


def write_difference(difference: DifferenceResult, folder: Path, *, force: bool = False) -> None:
    """Write ``difference.json`` and ``report.html`` into a new folder."""
    with new_folder(folder, force=force) as place:
        write_json(place / "difference.json", describe_difference(difference))
        write_text(place / "report.html", render_difference(difference))
