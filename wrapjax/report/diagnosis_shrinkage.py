"""How far the error shrinks with an effect, and what calibration had put in its place."""

from __future__ import annotations

import numpy as np

from wrapjax.diagnosis.result import Alternative, DiagnosisResult, Released
from wrapjax.report import markup
from wrapjax.report.diagnosis_effects import DRAWN_COLORS
from wrapjax.report.diagnosis_numbers import HELD_OUT, leading
from wrapjax.report.diagnosis_words import percent, words
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Axes,
    Figure,
    counted,
    decimals,
    in_style,
    new_figure,
    panel_grid,
    plain,
)

#: As many parameters are drawn, those that moved most.
MOST_RELEASED = 12
_DASH = "\N{EN DASH}"
_PLACES = {
    "held_out_cycles": (BLUE, "o", "cycles not used to fit it"),
    "held_out_speed": (VERMILION, "D", "speed not used to fit it"),
}


def shrinkage_section(result: DiagnosisResult) -> list[str]:
    """Write the part of the report on how far the error shrinks; nothing where no effect was fitted."""
    if not result.alternatives:
        return []
    parts = []
    accepted = accepted_shares(result)
    if accepted and result.explainable_share.known:
        removed = ", ".join(f"{plain(id)} {100.0 * share:.0f} %" for id, share in accepted.items())
        parts.append(
            markup.picture(
                waterfall_figure(result),
                alternative=f"The whole error and what takes parts of it away: of the explainable error, "
                f"{removed}.",
                caption="The plain model's mean squared error as 100 %, what each accepted effect takes away "
                "(Shapley's share: its average over all orders of adding them), and what is left. One that "
                "adds to the error is red. Dashed: noise, which no model explains; what lies between it and "
                "the end of the last bar is still missing from the model.",
            )
        )
    if any(getattr(one, which).known for one in result.alternatives for which in HELD_OUT):
        parts.append(
            markup.picture(
                shrinkage_figure(result),
                alternative="Share of the explainable error that each fitted effect removes: "
                + "; ".join(_in_words(one) for one in result.alternatives)
                + ".",
                caption="Share of the explainable error that each fitted effect removes where it was not "
                "fitted, with 95 % intervals: 0 % is the plain model, 100 % the noise alone; below zero the "
                "error grows. A mechanism that is really there also holds at another speed.",
            )
        )
    parts.append(
        markup.table(
            ("effect", "unseen cycles", "unseen speed", "gain of each block (nats)", "conflict of speeds"),
            [
                (
                    words(one.ids),
                    *(
                        percent(own) if (own := getattr(one, which)).known else f"{_DASH} ({own.reason})"
                        for which in HELD_OUT
                    ),
                    ", ".join(f"{gain:.1f}" for gain in one.gains) or _DASH,
                    decimals(one.speed_conflict),
                )
                for one in result.alternatives
            ],
            caption="Fitted effects, the most probable first: share of the explainable error removed, with "
            "95 % intervals; by how much each left-out block of cycles became likelier, above zero speaks "
            "for the effect; and the squared difference of the amounts fitted to each speed, in squared "
            "standard deviations: a wrong mechanism usually needs another amount for each speed.",
        )
    )
    return [markup.section("How far the error shrinks", *parts)]


def accepted_shares(result: DiagnosisResult) -> dict[str, float]:
    """Give the shares that add up: those of what is named. Rivals explain the same error, not more of it."""
    return {id: share for id, share in result.shares.items() if id in result.named}


@in_style
def waterfall_figure(result: DiagnosisResult) -> Figure:
    """Draw the whole error, what accepted effects take away, and what is left above noise."""
    explainable = 100.0 * result.explainable_share.value
    steps = [(plain(id), explainable * share) for id, share in accepted_shares(result).items()]
    names = ["plain model", *(name for name, _ in steps), "left"]
    figure = new_figure(PAGE_WIDTH, 0.34 * len(names) + 0.8)
    panel = figure.subplots()
    level = 100.0
    panel.barh(0, level, color=GRAY, height=0.6)
    for row, (_, size) in enumerate(steps, start=1):
        color, sign = (BLUE, "\N{MINUS SIGN}") if size >= 0.0 else (VERMILION, "+")
        panel.barh(row, size, left=level - size, color=color, height=0.6)
        panel.text(max(level, level - size) + 0.8, row, f"{sign}{abs(size):.0f} %", va="center", fontsize=7.5)
        panel.vlines(level, row - 0.7, row + 0.3, color=GRAY, linewidth=0.6)
        level -= size
    panel.barh(len(names) - 1, level, color=GRAY, height=0.6)
    panel.text(level + 0.8, len(names) - 1, f"{level:.0f} %", va="center", fontsize=7.5)
    panel.axvline(100.0 - explainable, color=BLACK, linewidth=0.9, linestyle="--", label="noise")
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    panel.set_yticks(range(len(names)), names, parse_math=False)
    panel.set_ylim(len(names) - 0.4, -0.6)
    panel.tick_params(axis="y", length=0)
    panel.set_xlim(right=108.0)
    panel.set_xlabel("mean squared error (% of the plain model's)")
    figure.legend(loc="outside upper left")
    return figure


@in_style
def shrinkage_figure(result: DiagnosisResult) -> Figure:
    """Draw the share that each fitted effect removes on unseen cycles and at an unseen speed."""
    shown = result.alternatives
    figure = new_figure(PAGE_WIDTH, 0.42 * len(shown) + 1.0)
    panel = figure.subplots()
    for place, (which, (color, marker, label)) in enumerate(_PLACES.items()):
        known = [(row, getattr(one, which)) for row, one in enumerate(shown) if getattr(one, which).known]
        if not known:
            continue
        rows = np.array([row for row, _ in known]) + (-0.14, 0.14)[place]
        values, low, high = (
            100.0 * np.array([getattr(own, part) for _, own in known]) for part in ("value", "low", "high")
        )
        panel.hlines(rows, low, high, color=color, linewidth=1.4)
        panel.plot(values, rows, marker, color=color, markersize=5, label=label)
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    panel.axvline(100.0, color=BLACK, linewidth=0.9, linestyle="--", label="noise alone")
    panel.set_yticks(range(len(shown)), [words(one.ids) for one in shown], parse_math=False)
    panel.set_ylim(len(shown) - 0.4, -0.6)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("share of the explainable error removed (%)")
    figure.legend(loc="outside upper left", ncols=3)
    return figure


def released_section(result: DiagnosisResult) -> list[str]:
    """Write the part of the report on calibrated parameters that an effect set free; nothing without."""
    shown = [one for one in leading(result) if most_released(one)][: len(DRAWN_COLORS)]
    if not shown:
        return []
    first = most_released(shown[0])[0]
    return [
        markup.section(
            "Calibrated parameters that stood in for it",
            markup.picture(
                released_figure(shown),
                alternative="Calibrated parameters that moved most once an effect was there to take their "
                f"part; with {words(shown[0].ids)}, {first.label} by {_moved(first):+.1f} prior standard "
                "deviations.",
                caption="Calibrated parameters that moved most once the effect was in the model, in standard "
                "deviations of what calibration expects of them (its prior): from where they were without it "
                "(zero) to where they are with it (dot). Those far from zero had been bent to stand in for "
                "what was missing. A diamond stood on a bound before, so it could not bend further.",
            ),
        )
    ]


@in_style
def released_figure(shown: list[Alternative]) -> Figure:
    """Draw by how many prior deviations parameters moved, one panel an effect."""
    most = max(len(most_released(one)) for one in shown)
    figure, panels = panel_grid(
        len(shown),
        min(2, len(shown)),
        width=PAGE_WIDTH if len(shown) > 1 else 0.7 * PAGE_WIDTH,
        panel_height=0.19 * most + 0.6,
    )
    for panel, alternative in zip(panels, shown, strict=True):
        _draw_released(panel, most_released(alternative))
        panel.set_title(words(alternative.ids), loc="left")
    found = [panel.get_legend_handles_labels() for panel in panels]
    one_each = {label: handle for own in found for handle, label in zip(*own, strict=True)}
    figure.legend(one_each.values(), one_each.keys(), loc="outside upper left", ncols=2)
    return figure


def _draw_released(panel: Axes, parameters: list[Released]) -> None:
    rows, moves = np.arange(len(parameters)), np.array([_moved(one) for one in parameters])
    stuck = np.array([one.at_bound for one in parameters])
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    panel.hlines(rows, 0.0, moves, color=LIGHT_GRAY, linewidth=1.8, zorder=0)
    if not stuck.all():
        panel.plot(moves[~stuck], rows[~stuck], "o", color=GREEN, markersize=5, label="was free to move")
    if stuck.any():
        panel.plot(moves[stuck], rows[stuck], "D", color=VERMILION, markersize=5, label="stood on a bound")
    panel.set_yticks(rows, [plain_label(one.label) for one in parameters], parse_math=False)
    panel.set_ylim(len(parameters) - 0.4, -0.6)
    panel.tick_params(axis="y", length=0)
    panel.margins(x=0.1)
    panel.set_xlabel("change (prior standard deviations)")


def most_released(alternative: Alternative) -> list[Released]:
    """Give the parameters that moved most, the farthest first; those that did not move are left out."""
    moved = [one for one in alternative.released if abs(_moved(one)) > 1e-6]
    return sorted(moved, key=lambda one: -abs(_moved(one)))[:MOST_RELEASED]


def plain_label(label: str) -> str:
    """Write ``soleus_l.emg_scale`` for readers: ``soleus_l: emg scale``."""
    owner, dot, name = label.partition(".")
    return f"{owner}: {plain(name)}" if dot else label


def _moved(released: Released) -> float:
    """Give how far a parameter moved, in prior deviations; 0 where nothing is expected of it."""
    scale = released.sd
    return (released.after - released.before) / scale if np.isfinite(scale) and scale > 0.0 else 0.0


def _in_words(alternative: Alternative) -> str:
    own = alternative.held_out_cycles
    share = percent(own) if own.known else "not known"
    count = counted(len(alternative.gains), "block")
    return f"{words(alternative.ids)} {share} on unseen cycles ({count})"
