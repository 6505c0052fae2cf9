"""Report sections of a diagnosis on effects: their changes of the moments, their evidence, and ties."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.claims.advice import Advice
from wrapjax.diagnosis.result import DiagnosisResult, EffectFinding
from wrapjax.report import markup
from wrapjax.report.cycle_panels import label_gait_cycles
from wrapjax.report.diagnosis.numbers import at_speed, speed_label
from wrapjax.report.diagnosis.words import (
    effect_list,
    effect_meaning,
    effect_names,
    effect_sizes_in_words,
    positive_controls,
    shown_effects,
)
from wrapjax.report.formatting import DASH, counted, decimals, readable
from wrapjax.report.style import (
    BAND_ALPHA,
    BLACK,
    BLUE,
    GREEN,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    draw_zero_line,
    in_style,
    legend_above,
    new_figure,
    panel_grid,
)

#: Colors of the refitted effects that are drawn, the most probable ones.
DRAWN_COLORS = (BLUE, VERMILION, GREEN)
# Added to the caption of the probabilities where a gate refuses the claim.
_REFUSED = (
    " Since a gate refuses the strongest effect, the model may be wrong in another way, and no effect is "
    "given a larger probability than the last two rows together."
)
# Number of effects in the visible part of the table.
_MOST_OPEN = 10
_HEADER = (
    *("effect", "probability", "evidence (nats)"),
    *("detectability (SD)", "effect sizes", "assessment"),
)


def signature_section(result: DiagnosisResult) -> str:
    """Write the report section on moments added by refitted effects; empty if no effect was refitted."""
    drawn = result.refits[: len(DRAWN_COLORS)]
    if not drawn:
        return ""
    names = "; ".join(effect_names(refit.ids) for refit in drawn)
    return markup.section(
        "Moment error, and moments added by effects",
        markup.picture(
            signature_figure(result),
            alternative="Mean moment error over the gait cycle, and moments added by these effects: "
            f"{names}.",
            caption="Black: measured minus predicted moment in N m, mean over held-out cycles, with the 95 "
            "% confidence interval of the mean (Student's t). Colors: moment predicted by the model with an "
            "effect minus that of the plain model. An effect that explains the error follows the black line "
            "at every coordinate and at every speed; where the band includes zero, the error does not differ "
            "significantly from zero. Scales differ between coordinates.",
        ),
    )


@in_style
def signature_figure(result: DiagnosisResult) -> Figure:
    """Draw the mean residual and moments added by effects, one row a coordinate, one column a speed."""
    speeds = np.unique(result.speeds).tolist()  # NaNs count as one, the last
    count = len(speeds) * len(result.coordinates)
    figure, panels = panel_grid(
        count, len(speeds), width=PAGE_WIDTH, panel_height=1.6, sharex=True, sharey="row"
    )
    percent = np.linspace(0.0, 100.0, result.time.shape[1])
    for number, panel in enumerate(panels):
        row, column = divmod(number, len(speeds))
        keep = at_speed(result.speeds, speeds[column])
        residual = (result.measured - result.plain)[keep, row]
        mean, half = residual.mean(axis=0), half_interval(residual)
        draw_zero_line(panel)
        panel.fill_between(percent, mean - half, mean + half, color=BLACK, alpha=BAND_ALPHA, linewidth=0)
        panel.plot(percent, mean, color=BLACK, label="measured minus plain model")
        for refit, color in zip(result.refits, DRAWN_COLORS, strict=False):
            added = (refit.predicted - result.plain)[keep, row].mean(axis=0)
            panel.plot(percent, added, color=color, label=effect_names(refit.ids))
        if row == 0:
            title = f"{speed_label(speeds[column])} ({counted(int(keep.sum()), 'cycle')})"
            panel.set_title(title, loc="left", fontweight="bold")
        if column == 0:
            panel.set_ylabel(f"{result.coordinates[row]}\n(N m)", parse_math=False)
    label_gait_cycles(panels, len(speeds))
    legend_above(figure, panels[0])
    return figure


def half_interval(curves: Float[np.ndarray, "cycle frame"]) -> Float[np.ndarray, " frame"]:
    """Compute half the 95 % confidence interval of a mean over cycles in each frame; NaN for one cycle."""
    from scipy.special import stdtrit

    count = len(curves)
    if count < 2:
        return np.full(curves.shape[1], np.nan)
    return stdtrit(count - 1, 0.975) * curves.std(axis=0, ddof=1) / math.sqrt(count)


def evidence_section(result: DiagnosisResult) -> str:
    """Write the report section on the evidence for each effect; empty if no effect was scored."""
    if not result.effects:
        return ""
    shown, gates = shown_effects(result), result.gates
    rows = [_effect_row(effect) for effect in shown]
    names = {effect.id for effect in shown}
    others = [effect for effect in result.effects if effect.id not in names]
    rest = [
        *(
            [(f"{len(others)} others", decimals(sum(one.probability for one in others)), *[DASH] * 4)]
            if others
            else []
        ),
        ("no effect", decimals(result.none_probability), *[DASH] * 4),
        ("not in the catalogue", decimals(result.unknown_probability), *[DASH] * 4),
    ]
    detection_threshold = (
        f" The detection threshold, which few null replicates exceed, is {result.detection_threshold:.1f} "
        "nats."
        if math.isfinite(result.detection_threshold)
        else ""
    )
    caption = (
        "Effects that these data can test with a probability of at least 0.005, the most probable first; the "
        "probabilities of all rows sum to one. Evidence: log Bayes factor, the natural logarithm of the "
        "ratio of the likelihood of the error with the effect to that without it (3: 20 times as likely); "
        "values above zero support the "
        f"effect.{detection_threshold} Detectability: signal-to-noise ratio of an effect of expected size, "
        "in standard deviations; below 2, this recording could not show the effect. Effect sizes: most "
        "plausible value ± standard deviation. Ids in files have underscores instead of spaces; the last two "
        "rows are none and unknown there."
        + (_REFUSED if gates is not None and gates.of_claim and gates.failed else "")
    )
    parts = [markup.table(_HEADER, rows[:_MOST_OPEN] + rest, caption=caption)]
    if hidden := rows[_MOST_OPEN:]:
        table = markup.table(_HEADER, hidden, caption="Less probable effects, columns as above.")
        parts.append(markup.folded(f"{counted(len(hidden), 'less probable effect')}", table))
    meanings = markup.bullets(effect_meaning(effect.id) for effect in shown)
    parts.append(markup.folded("Meaning of each effect", meanings))
    return markup.section("Evidence for each effect", *_controls(result), *parts)


def _controls(result: DiagnosisResult) -> list[str]:
    controls = [effect for effect in result.effects if effect.negative_control]
    if not controls:
        return []
    false_positives = positive_controls(result)
    names = effect_list(effect.id for effect in (false_positives or controls))
    return [
        markup.paragraph(
            "Evidence for negative controls, which cannot be present in such a recording, exceeds the "
            f"detection threshold: {names}."
            if false_positives
            else "As expected, the evidence for negative controls, which cannot be present in such a "
            f"recording, does not exceed the detection threshold ({names})."
        )
    ]


def _effect_row(effect: EffectFinding) -> tuple[str, ...]:
    mark = " (negative control)" if effect.negative_control else ""
    return (
        readable(effect.id) + mark,
        decimals(effect.probability),
        decimals(effect.evidence, 1),
        decimals(effect.detectability, 1),
        effect_sizes_in_words(effect.effect_sizes),
        effect.decision,
    )


#: Part of an effect that another cannot reproduce, in squared standard deviations, below which the two cannot
#: be distinguished (three standard deviations).
BORDER = 9.0
# Largest number of effects for which the numbers in the map are readable.
_MOST_EFFECTS = 14
# Range of the color scale.
_LEAST, _MOST = 0.1, 810.0


def ties_section(result: DiagnosisResult) -> str:
    """Write the report section on ties; empty if there is neither a map nor advice."""
    ids, likeness = _most_probable(result)
    parts = []
    if len(ids) > 1:
        alike = alike_pairs(ids, likeness)
        pairs = "; ".join(f"{readable(first)} and {readable(second)}" for first, second in alike) or "none"
        parts.append(
            markup.picture(
                ties_figure(ids, likeness),
                alternative="Map of the part of each effect that another cannot reproduce. Not "
                f"distinguishable: {pairs}.",
                caption="Part of the effect in a row that the effect in a column cannot reproduce, in "
                "squared standard deviations (logarithmic scale). Red and bold, below 9 (three standard "
                "deviations): the effect in the column can replace the effect in the row. This recording "
                f"cannot distinguish two effects that are red in both directions: {pairs}.",
            )
        )
    if result.advice:
        parts.append(markup.paragraph("Recordings that would tell more:"))
        parts.append(markup.bullets(map(_advice, result.advice)))
    return markup.section("Which effects can be distinguished", *parts) if parts else ""


def alike_pairs(ids: tuple[str, ...], likeness: Float[np.ndarray, "effect effect"]) -> list[tuple[str, str]]:
    """List the pairs of effects of which each can reproduce the other."""
    return [
        (ids[row], ids[column])
        for row in range(len(ids))
        for column in range(row + 1, len(ids))
        if likeness[row, column] < BORDER and likeness[column, row] < BORDER
    ]


@in_style
def ties_figure(ids: tuple[str, ...], likeness: Float[np.ndarray, "effect effect"]) -> Figure:
    """Draw the part of each effect (row) that each other effect (column) cannot reproduce."""
    from matplotlib.colors import LogNorm

    count = len(ids)
    names = [readable(id) for id in ids]
    figure = new_figure(0.5 * count + 4.2, 0.36 * count + 2.4)
    panel = figure.subplots()
    values = np.where(np.eye(count, dtype=bool), np.nan, np.clip(likeness, _LEAST, _MOST))
    # The border is in the middle of the color map, so its two colors show on which side a value is.
    norm = LogNorm(BORDER**2 / _MOST, _MOST)
    panel.set_facecolor("#EDEDED")
    image = panel.pcolormesh(values, cmap="RdBu", norm=norm, edgecolor="white", linewidth=0.6)
    for row, column in np.argwhere(np.isfinite(values)).tolist():
        away = abs(np.log(values[row, column] / BORDER)) / np.log(_MOST / BORDER)
        panel.text(
            column + 0.5,
            row + 0.5,
            f"{likeness[row, column]:.2g}"
            if likeness[row, column] < 9.95
            else f"{likeness[row, column]:.0f}",
            ha="center",
            va="center",
            fontsize=7.5,
            fontweight="bold" if likeness[row, column] < BORDER else "normal",
            color="white" if away > 0.7 else "black",
        )
    at = np.arange(count) + 0.5
    panel.set_yticks(at, names, parse_math=False)
    panel.set_xticks(at, names, rotation=40, ha="right", rotation_mode="anchor", parse_math=False)
    panel.set_ylim(count, 0)
    panel.tick_params(length=0)
    panel.spines[["left", "bottom"]].set_visible(False)
    panel.set_ylabel("part of this effect")
    panel.set_xlabel("that this effect cannot reproduce")
    bar = figure.colorbar(image, label="not reproduced\n(squared standard deviations)", aspect=14)
    bar.set_ticks([0.1, 1.0, BORDER, 100.0], labels=["0.1", "1", "9: limit", "100"])
    bar.minorticks_off()
    bar.ax.axhline(BORDER, color="black", linewidth=1.0)
    return figure


def _most_probable(result: DiagnosisResult) -> tuple[tuple[str, ...], Float[np.ndarray, "shown shown"]]:
    """Select the most probable effects of the map."""
    ids, likeness = result.distinguishability
    probability = {effect.id: effect.probability for effect in result.effects}
    order = sorted(range(len(ids)), key=lambda row: -probability.get(ids[row], 0.0))[:_MOST_EFFECTS]
    return tuple(ids[row] for row in order), likeness[np.ix_(order, order)]


def _advice(advice: Advice) -> str:
    cycles = "" if advice.cycles is None else f", {counted(advice.cycles, 'cycle')} for odds of 20 to 1"
    added = "" if advice.information is None else f"adds {advice.information:.2f} nats"
    apart = f"distinguishes {effect_list(advice.splits)}" if advice.splits else ""
    experiment = advice.experiment[:1].upper() + advice.experiment[1:]
    found = "; ".join(part for part in (added, apart) if part)
    return f"{experiment} ({advice.minutes} min{cycles}): {found}."
