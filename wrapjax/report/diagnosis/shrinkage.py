"""Report sections of a diagnosis on the shrinkage of the error and on compensating parameters."""

from __future__ import annotations

import numpy as np

from wrapjax.diagnosis.fits.verification import ReleasedParameter, VerifiedRefit
from wrapjax.diagnosis.null_hypotheses.noise_floor import Estimate
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.report import markup
from wrapjax.report.diagnosis.effects import DRAWN_COLORS
from wrapjax.report.diagnosis.numbers import HELD_OUT, reported_refits
from wrapjax.report.diagnosis.words import effect_names, share_with_interval
from wrapjax.report.formatting import DASH, counted, decimals, readable
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
    in_style,
    label_rows,
    legend_above,
    new_figure,
    panel_grid,
)

#: Number of parameters that are drawn, those that changed most.
MOST_RELEASED = 12
# Color, marker and label of each kind of held-out data.
_MARKERS = {
    "held_out_cycles": (BLUE, "o", "held-out cycles"),
    "held_out_speed": (VERMILION, "D", "held-out speed"),
}


def shrinkage_section(result: DiagnosisResult) -> str:
    """Write the report section on shrinkage of the error; empty if no effect was refitted."""
    if not result.refits:
        return ""
    parts = []
    accepted = accepted_shares(result)
    if accepted and result.explainable_share.known:
        removed = ", ".join(f"{readable(id)} {100.0 * share:.0f} %" for id, share in accepted.items())
        parts.append(
            markup.picture(
                waterfall_figure(result),
                alternative="Total error and its decrease by each effect, as shares of the explainable "
                f"error: {removed}.",
                caption="Mean squared error of the plain model as 100 %, its decrease by each accepted "
                "effect (Shapley value: average over all orders of adding the effects), and the remaining "
                "error. An effect that increases the error is red. Dashed: noise floor, the error that a "
                "correct model would leave; the difference between it and the end of the last bar is not "
                "yet explained.",
            )
        )
    if any(getattr(refit, which).known for refit in result.refits for which in HELD_OUT):
        parts.append(
            markup.picture(
                shrinkage_figure(result),
                alternative="Share of the explainable error that each refitted effect removes: "
                + "; ".join(map(_shrinkage_in_words, result.refits))
                + ".",
                caption="Share of the explainable error that each refitted effect removes on held-out data, "
                "with 95 % intervals: 0 % is the plain model, 100 % the noise floor; below zero the error "
                "increases. A mechanism that is present should also reduce the error at another speed.",
            )
        )
    parts.append(
        markup.table(
            (
                *("effect", "held-out cycles", "held-out speed"),
                *("gain of each block (nats)", "difference between speeds"),
            ),
            [
                (
                    effect_names(refit.ids),
                    *(_share_or_reason(getattr(refit, which)) for which in HELD_OUT),
                    ", ".join(f"{gain:.1f}" for gain in refit.gains) or DASH,
                    decimals(refit.speed_conflict),
                )
                for refit in result.refits
            ],
            caption="Refitted effects, the most probable first. Share of the explainable error removed, "
            "with 95 % intervals. Gain: increase of the log likelihood of each held-out block of cycles; "
            "values above zero support the effect. Difference between speeds: squared difference of the "
            "effect sizes fitted to each speed, in squared standard deviations; a wrong mechanism usually "
            "requires a different effect size at each speed.",
        )
    )
    return markup.section("Shrinkage of the error", *parts)


def _share_or_reason(estimate: Estimate) -> str:
    return share_with_interval(estimate) if estimate.known else f"{DASH} ({estimate.reason})"


def accepted_shares(result: DiagnosisResult) -> dict[str, float]:
    """Select the shares of the named effects, which add up; other effects explain the same error."""
    return {id: share for id, share in result.shares.items() if id in result.named}


@in_style
def waterfall_figure(result: DiagnosisResult) -> Figure:
    """Draw the total error, its decrease by each accepted effect, and the remaining error above the noise."""
    explainable = 100.0 * result.explainable_share.value
    steps = [(readable(id), explainable * share) for id, share in accepted_shares(result).items()]
    names = ["plain model", *(name for name, _ in steps), "remaining"]
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
    panel.axvline(100.0 - explainable, color=BLACK, linewidth=0.9, linestyle="--", label="noise floor")
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    label_rows([panel], names)
    panel.set_xlim(right=108.0)
    panel.set_xlabel("mean squared error (% of the plain model's)")
    legend_above(figure, panel)
    return figure


@in_style
def shrinkage_figure(result: DiagnosisResult) -> Figure:
    """Draw the share that each refitted effect removes on held-out cycles and at a held-out speed."""
    shown = result.refits
    figure = new_figure(PAGE_WIDTH, 0.42 * len(shown) + 1.0)
    panel = figure.subplots()
    for place, (which, (color, marker, label)) in enumerate(_MARKERS.items()):
        estimates = [(row, getattr(refit, which)) for row, refit in enumerate(shown)]
        known = [(row, estimate) for row, estimate in estimates if estimate.known]
        if not known:
            continue
        rows = np.array([row for row, _ in known]) + (-0.14, 0.14)[place]
        values, low, high = (
            100.0 * np.array([getattr(estimate, part) for _, estimate in known])
            for part in ("value", "low", "high")
        )
        panel.hlines(rows, low, high, color=color, linewidth=1.4)
        panel.plot(values, rows, marker, color=color, markersize=5, label=label)
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    panel.axvline(100.0, color=BLACK, linewidth=0.9, linestyle="--", label="noise floor")
    label_rows([panel], [effect_names(refit.ids) for refit in shown])
    panel.set_xlabel("share of the explainable error removed (%)")
    legend_above(figure, panel)
    return figure


def released_section(result: DiagnosisResult) -> str:
    """Write the report section on calibrated parameters that change with an effect; empty if none does."""
    shown = [refit for refit in reported_refits(result) if most_released(refit)]
    shown = shown[: len(DRAWN_COLORS)]
    if not shown:
        return ""
    first = most_released(shown[0])[0]
    return markup.section(
        "Calibrated parameters that compensated for the missing effect",
        markup.picture(
            released_figure(shown),
            alternative="Calibrated parameters that change most when an effect is included in the model; "
            f"with {effect_names(shown[0].ids)}, {first.label} changes by {_change(first):+.1f} prior "
            "standard deviations.",
            caption="Calibrated parameters that change most when the effect is included in the model, in "
            "prior standard deviations: from the value without the effect (zero) to the value with it "
            "(marker). Large changes mean that the parameter had compensated for the missing effect. A "
            "diamond marks a parameter that was at a bound without the effect and could not compensate "
            "further.",
        ),
    )


@in_style
def released_figure(shown: list[VerifiedRefit]) -> Figure:
    """Draw changes of parameters in prior standard deviations, one panel an effect."""
    most = max(len(most_released(refit)) for refit in shown)
    figure, panels = panel_grid(
        len(shown),
        min(2, len(shown)),
        width=PAGE_WIDTH if len(shown) > 1 else 0.7 * PAGE_WIDTH,
        panel_height=0.19 * most + 0.6,
    )
    for panel, refit in zip(panels, shown, strict=True):
        _draw_released(panel, most_released(refit))
        panel.set_title(effect_names(refit.ids), loc="left")
    legend_above(figure, *panels)
    return figure


def _draw_released(panel: Axes, parameters: list[ReleasedParameter]) -> None:
    rows, changes = np.arange(len(parameters)), np.array([_change(parameter) for parameter in parameters])
    at_bound = np.array([parameter.at_bound for parameter in parameters])
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    panel.hlines(rows, 0.0, changes, color=LIGHT_GRAY, linewidth=1.8, zorder=0)
    if not at_bound.all():
        panel.plot(
            changes[~at_bound],
            rows[~at_bound],
            "o",
            color=GREEN,
            markersize=5,
            label="between its bounds before",
        )
    if at_bound.any():
        panel.plot(
            changes[at_bound], rows[at_bound], "D", color=VERMILION, markersize=5, label="at a bound before"
        )
    label_rows([panel], [readable_label(parameter.label) for parameter in parameters])
    panel.margins(x=0.1)
    panel.set_xlabel("change (prior standard deviations)")


def most_released(refit: VerifiedRefit) -> list[ReleasedParameter]:
    """Select the parameters that changed most, largest change first; unchanged parameters are omitted."""
    changed = [parameter for parameter in refit.released if abs(_change(parameter)) > 1e-6]
    return sorted(changed, key=lambda parameter: -abs(_change(parameter)))[:MOST_RELEASED]


def readable_label(label: str) -> str:
    """Write the label ``soleus_l.emg_scale`` of a parameter as ``soleus_l: emg scale``."""
    owner, dot, name = label.partition(".")
    return f"{owner}: {readable(name)}" if dot else label


def _change(released: ReleasedParameter) -> float:
    """Compute the change of a parameter in prior standard deviations; 0 if it has no prior."""
    scale = released.sd
    return (released.after - released.before) / scale if np.isfinite(scale) and scale > 0.0 else 0.0


def _shrinkage_in_words(refit: VerifiedRefit) -> str:
    estimate = refit.held_out_cycles
    share = share_with_interval(estimate) if estimate.known else "unknown"
    count = counted(len(refit.gains), "block")
    return f"{effect_names(refit.ids)} {share} on held-out cycles ({count})"
