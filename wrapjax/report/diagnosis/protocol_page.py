"""Page and JSON of the trials that would tell most."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.diagnosis.claims.decision import TIE_DISTANCE
from wrapjax.diagnosis.evidence.score_test import MIN_DETECTABILITY
from wrapjax.diagnosis.protocol.result import ProtocolResult
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.report import markup
from wrapjax.report.formatting import DASH, counted, decimals
from wrapjax.report.style import (
    BLUE,
    DOT,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    in_style,
    label_rows,
    legend_above,
    new_figure,
)

#: Version of the layout of ``protocol.json``.
SCHEMA = 1
# Pairs of effects that are listed for each trial.
_MOST_PAIRS = 6
# Smallest detectability that the figure shows, and its ticks.
_LEAST_SHOWN = 0.1
_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def protocol_findings(protocol: ProtocolResult) -> list[str]:
    """Write sentences on what the trials add."""
    both = (protocol.before, protocol.after)
    visible = [int(np.sum(one.detectability >= MIN_DETECTABILITY)) for one in both]
    medians = [float(np.median(one.detectability)) for one in both]
    first, further = protocol.advised[0], counted(len(protocol.advised), "further trial")
    return [
        f"Record first: {first.trial.what} ({first.conditions}; {first.trial.minutes} min).",
        f"With {protocol.basis}, {visible[0]} of {len(protocol.effects)} effects are visible (detectability "
        f"d' of {MIN_DETECTABILITY:g} or more), with {further} {visible[1]}; the median d' rises from "
        f"{medians[0]:.1f} to {medians[1]:.1f}.",
    ]


def protocol_rows(protocol: ProtocolResult) -> list[tuple[str, ...]]:
    """Tabulate the advised trials: what, posture, effort, minutes, nats, d', pairs distinguished."""
    rows: list[tuple[str, ...]] = []
    for number, one in enumerate(protocol.advised, start=1):
        pairs = [f"{first} / {second}" for first, second in one.splits[:_MOST_PAIRS]]
        if len(one.splits) > _MOST_PAIRS:
            pairs.append(f"{len(one.splits) - _MOST_PAIRS} more")
        rows.append(
            (
                str(number),
                f"{one.trial.what} ({one.trial.task})",
                ", ".join(f"{name} {value:g}" for name, value in one.trial.posture.items()) or DASH,
                one.trial.effort,
                str(one.trial.minutes),
                decimals(one.information, 2),
                decimals(one.expected_evidence, 1),
                decimals(float(np.median(one.detected.detectability)), 1),
                "; ".join(pairs) or DASH,
            )
        )
    return rows


#: Header of `protocol_rows`.
HEADER = (
    "",
    "trial",
    "held, degrees",
    "effort",
    "minutes",
    "adds, nats",
    "expected evidence, nats",
    "median d'",
    "tells apart",
)


def describe_protocol(protocol: ProtocolResult) -> dict[str, Any]:
    """Describe a protocol as plain numbers and strings: the content of ``protocol.json``.

    Returns
    -------
    dict
        ``trials``: the advised ones in their order, each with ``information_nats`` that it adds to the ones
        before, ``expected_evidence_nats`` (median over the undecided effects), detectability d' of each
        effect with it and those before it, and ``splits``, pairs distinguished; ``considered``, all trials
        with what each adds alone; ``effects`` with d' before and after.
    """
    ids = protocol.effects
    return {
        "schema": SCHEMA,
        "subject": protocol.name,
        "basis": protocol.basis,
        "median_detectability": {
            "before": float(np.median(protocol.before.detectability)),
            "after": float(np.median(protocol.after.detectability)),
        },
        "expected_evidence_nats": protocol.expected_before,
        "trials": [
            {
                "id": one.trial.id,
                "task": one.trial.task,
                "experiment": one.trial.what,
                "posture_deg": one.trial.posture,
                "effort": one.trial.effort,
                "minutes": one.trial.minutes,
                "information_nats": one.information,
                "expected_evidence_nats": one.expected_evidence,
                "median_detectability": float(np.median(one.detected.detectability)),
                "detectability": dict(zip(ids, one.detected.detectability.tolist(), strict=True)),
                "splits": [list(pair) for pair in one.splits],
            }
            for one in protocol.advised
        ],
        "effects": [
            {"id": id, "weight": weight, "detectability_before": before, "detectability_after": after}
            for id, weight, before, after in zip(
                ids,
                protocol.weights.tolist(),
                protocol.before.detectability.tolist(),
                protocol.after.detectability.tolist(),
                strict=True,
            )
        ],
        "considered": [
            {"id": trial.id, "experiment": trial.what, "minutes": trial.minutes, "information_nats": nats}
            for trial, nats in protocol.considered
        ],
        "seconds": protocol.seconds,
    }


@in_style
def detectability_figure(protocol: ProtocolResult) -> Figure:
    """Draw the detectability of every effect before and after the advised trials."""
    after = protocol.after.detectability
    order = np.argsort(-after)
    figure = new_figure(0.75 * PAGE_WIDTH, 0.2 * len(order) + 1.0)
    panel = figure.subplots()
    panel.axvline(MIN_DETECTABILITY, color=GRAY, linewidth=0.8, linestyle="--", label="visible from here")
    rows = np.arange(len(order))

    def shown(values: np.ndarray) -> np.ndarray:
        return np.maximum(values[order], _LEAST_SHOWN)

    before = shown(protocol.before.detectability)
    panel.hlines(rows, before, shown(after), color=LIGHT_GRAY, linewidth=2.5, zorder=1)
    panel.plot(before, rows, "o", color=GRAY, label="before", **DOT)
    if len(protocol.advised) > 1:
        first = shown(protocol.advised[0].detected.detectability)
        panel.plot(first, rows, "o", color=BLUE, label="with the first trial", **DOT)
    label = f"with all {len(protocol.advised)}" if len(protocol.advised) > 1 else "with it"
    panel.plot(shown(after), rows, "o", color=VERMILION, label=label, **DOT)
    panel.set_xscale("log")
    panel.set_xlim(left=_LEAST_SHOWN)
    ticks = [value for value in _TICKS if value <= panel.get_xlim()[1]]
    panel.set_xticks(ticks, [f"{value:g}" for value in ticks])
    panel.minorticks_off()
    panel.set_xlabel("detectability d' of an effect of its prior size")
    label_rows([panel], [protocol.effects[place] for place in order])
    legend_above(figure, panel)
    return figure


def render_protocol(protocol: ProtocolResult) -> str:
    """Write the report of a protocol as a self-contained HTML page."""
    considered = [(trial.what, str(trial.minutes), decimals(nats, 2)) for trial, nats in protocol.considered]
    return markup.page(
        f"{protocol.name}: what to record next",
        [
            markup.header(f"{protocol.name}: what to record next", f"Known: {protocol.basis}."),
            markup.verdict(protocol_findings(protocol), fine=True),
            markup.section(
                "Trials that would tell most",
                markup.table(
                    HEADER,
                    protocol_rows(protocol),
                    caption="Each trial is the best after the ones before it. It adds information (nats) on "
                    "which effect is present, and how large; the expected evidence is the median over the "
                    "undecided effects of the expected log Bayes factor of an effect of its prior size. Two "
                    f"effects are distinguished where they are {np.sqrt(TIE_DISTANCE):g} standard deviations "
                    "from each other in either direction.",
                ),
            ),
            markup.section(
                "Detectability of each effect",
                markup.picture(
                    detectability_figure(protocol),
                    alternative="Detectability of each effect before and after the advised trials.",
                    caption="Calibrated parameters, the muscle law, muscles without EMG, noise and errors of "
                    "muscle force are uncertain in all of it. Values below "
                    f"{_LEAST_SHOWN:g} are drawn there.",
                ),
            ),
            markup.section(
                "All trials that were compared",
                markup.table(
                    ("trial", "minutes", "adds alone, nats"),
                    considered,
                    caption="Information that each trial alone would add to what is known.",
                ),
            ),
        ],
    )


def write_protocol(protocol: ProtocolResult, folder: Path, *, force: bool = False) -> None:
    """Write ``protocol.json`` and ``report.html`` into a new folder."""
    with new_folder(folder, force=force) as place:
        write_json(place / "protocol.json", describe_protocol(protocol))
        write_text(place / "report.html", render_protocol(protocol))
