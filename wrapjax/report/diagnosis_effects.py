"""Which effect explains the error best: what each would do to the moments, and the evidence for it.

Which effects this recording can tell apart, and what to record to tell the others.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.result import Advice, DiagnosisResult, EffectFinding
from wrapjax.report import markup
from wrapjax.report.diagnosis_numbers import at_speed, speed_label
from wrapjax.report.diagnosis_words import effect_sizes_in_words, listed, loud_controls, meaning, words
from wrapjax.report.moment_curves import mark_gait_cycle
from wrapjax.report.style import (
    BAND_ALPHA,
    BLACK,
    BLUE,
    GREEN,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    counted,
    decimals,
    in_style,
    new_figure,
    panel_grid,
    plain,
)

#: As many fitted effects are drawn, the most probable ones, in these colors.
DRAWN_COLORS = (BLUE, VERMILION, GREEN)
_MOST_OPEN = 10
_DASH = "\N{EN DASH}"
_HEADER = (
    *("effect", "probability", "evidence (nats)"),
    *("detectability (sd)", "amounts", "what to make of it"),
)


def signature_section(result: DiagnosisResult) -> list[str]:
    """Write the part of the report on what fitted effects add; nothing where none was fitted."""
    drawn = result.alternatives[: len(DRAWN_COLORS)]
    if not drawn:
        return []
    names = "; ".join(words(one.ids) for one in drawn)
    return [
        markup.section(
            "What the model lacks, and what effects add",
            markup.picture(
                signature_figure(result),
                alternative=f"Mean moment error over the gait cycle beside what these add: {names}.",
                caption="Black: measured less predicted moment in N m, mean over cycles that the plain model "
                "was not fitted to, with a 95 % interval of that mean (Student's t). Colors: what the model "
                "with an effect predicts beyond the plain one. An effect that explains the error follows the "
                "black line, at every coordinate and at every speed; where the band holds zero there is "
                "nothing to explain. Scales differ between coordinates.",
            ),
        )
    ]


@in_style
def signature_figure(result: DiagnosisResult) -> Figure:
    """Draw the mean residual and what fitted effects add, one row a coordinate, one column a speed."""
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
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        panel.fill_between(percent, mean - half, mean + half, color=BLACK, alpha=BAND_ALPHA, linewidth=0)
        panel.plot(percent, mean, color=BLACK, label="measured less plain model")
        for alternative, color in zip(result.alternatives, DRAWN_COLORS, strict=False):
            added = (alternative.predicted - result.plain)[keep, row].mean(axis=0)
            panel.plot(percent, added, color=color, label=words(alternative.ids))
        if row == 0:
            title = f"{speed_label(speeds[column])} ({counted(int(keep.sum()), 'cycle')})"
            panel.set_title(title, loc="left", fontweight="bold")
        if column == 0:
            panel.set_ylabel(f"{result.coordinates[row]}\n(N m)", parse_math=False)
        if number >= count - len(speeds):
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    labels = panels[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside upper left", ncols=len(labels[1]))
    return figure


def half_interval(curves: Float[np.ndarray, "cycle frame"]) -> Float[np.ndarray, " frame"]:
    """Give half the 95 % interval of a mean over cycles, point by point; NaN of a single cycle."""
    from scipy.special import stdtrit

    count = len(curves)
    if count < 2:
        return np.full(curves.shape[1], np.nan)
    return stdtrit(count - 1, 0.975) * curves.std(axis=0, ddof=1) / math.sqrt(count)


def evidence_section(result: DiagnosisResult) -> list[str]:
    """Write the part of the report on the evidence; nothing where no effect was scored."""
    if not result.effects:
        return []
    lines = [_line(effect) for effect in result.effects]
    rest = [
        ("nothing amiss", decimals(result.none_probability), *[_DASH] * 4),
        ("not in the catalogue", decimals(result.unknown_probability), *[_DASH] * 4),
    ]
    detection_threshold = (
        f" Data without any effect exceed {result.detection_threshold:.1f} nats in few cases (alarm level)."
        if math.isfinite(result.detection_threshold)
        else ""
    )
    caption = (
        "All effects that these data can test, the most probable first; probabilities of all rows sum to "
        "one. Evidence: natural logarithm of how much likelier the error is with the effect than without (3: "
        f"20 times as likely), above zero speaks for it.{detection_threshold} "
        "Detectability: in standard deviations, of an effect of expected size; below 2 "
        "this recording could not show it. Amounts: most plausible value ± standard deviation. Names in "
        "files have underscores for blanks; the last two are none and unknown there."
    )
    parts = [markup.table(_HEADER, lines[:_MOST_OPEN] + rest, caption=caption)]
    if hidden := lines[_MOST_OPEN:]:
        table = markup.table(_HEADER, hidden, caption="The same of the others.")
        parts.append(markup.folded(f"{counted(len(hidden), 'less probable effect')}", table))
    glossary = markup.bullets(meaning(effect.id) for effect in result.effects)
    parts.append(markup.folded("What each effect means", glossary))
    return [markup.section("Evidence for each effect", *_controls(result), *parts)]


def _controls(result: DiagnosisResult) -> list[str]:
    controls = [effect for effect in result.effects if effect.negative_control]
    if not controls:
        return []
    loud = loud_controls(result)
    names = ", ".join(plain(effect.id) for effect in (loud or controls))
    return [
        markup.paragraph(
            f"Negative controls, which must stay quiet in such a recording, did not: {names}."
            if loud
            else f"Negative controls ({names}) stay quiet, as they must in such a recording."
        )
    ]


def _line(effect: EffectFinding) -> tuple[str, ...]:
    mark = " (negative control)" if effect.negative_control else ""
    return (
        plain(effect.id) + mark,
        decimals(effect.probability),
        *map(_one_decimal, (effect.evidence, effect.detectability)),
        effect_sizes_in_words(effect.effect_sizes),
        effect.decision,
    )


def _one_decimal(value: float) -> str:
    return _DASH if not math.isfinite(value) else f"{value:.1f}"


#: Squared standard deviations of an effect that another cannot imitate: below (three standard deviations),
#: it can stand in for it.
BORDER = 9.0
# More rows than these cannot be read.
_MOST_EFFECTS = 14
_LEAST, _MOST = 0.1, 810.0


def ties_section(result: DiagnosisResult) -> list[str]:
    """Write the part of the report on ties; nothing where there is neither a map nor advice."""
    ids, likeness = _shown(result)
    parts = []
    if len(ids) > 1:
        alike = alike_pairs(ids, likeness)
        pairs = "; ".join(f"{plain(one)} and {plain(other)}" for one, other in alike) or "none"
        parts.append(
            markup.picture(
                ties_figure(ids, likeness),
                alternative="Map of how much of each effect another cannot imitate. Not told apart: "
                f"{pairs}.",
                caption="How much of the effect in a row the effect in a column cannot imitate, in squared "
                "standard deviations (logarithmic scale). Red and bold, below 9 (three standard "
                "deviations): it can stand in for it. Two effects that are red both ways cannot be told "
                f"apart by this recording. Not told apart here: {pairs}.",
            )
        )
    if result.advice:
        parts.append(markup.paragraph("What to record to tell them apart:"))
        parts.append(markup.bullets(map(_advice, result.advice)))
    return [markup.section("What can be told apart", *parts)] if parts else []


def alike_pairs(ids: tuple[str, ...], likeness: Float[np.ndarray, "effect effect"]) -> list[tuple[str, str]]:
    """Name the pairs of effects that can imitate each other."""
    return [
        (ids[row], ids[column])
        for row in range(len(ids))
        for column in range(row + 1, len(ids))
        if likeness[row, column] < BORDER and likeness[column, row] < BORDER
    ]


@in_style
def ties_figure(ids: tuple[str, ...], likeness: Float[np.ndarray, "effect effect"]) -> Figure:
    """Draw how much of each effect (row) each other one (column) cannot imitate."""
    from matplotlib.colors import LogNorm

    count = len(ids)
    names = [plain(id) for id in ids]
    figure = new_figure(0.5 * count + 4.2, 0.36 * count + 2.4)
    panel = figure.subplots()
    values = np.where(np.eye(count, dtype=bool), np.nan, np.clip(likeness, _LEAST, _MOST))
    # The palette's middle is the border, so its two colors are the two answers.
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
    panel.set_ylabel("how much of this effect")
    panel.set_xlabel("this one cannot imitate")
    bar = figure.colorbar(image, label="not imitated\n(squared standard deviations)", aspect=14)
    bar.set_ticks([0.1, 1.0, BORDER, 100.0], labels=["0.1", "1", "9: border", "100"])
    bar.minorticks_off()
    bar.ax.axhline(BORDER, color="black", linewidth=1.0)
    return figure


def _shown(result: DiagnosisResult) -> tuple[tuple[str, ...], Float[np.ndarray, "shown shown"]]:
    """Keep the most probable effects of the map."""
    ids, likeness = result.likeness
    probability = {effect.id: effect.probability for effect in result.effects}
    order = sorted(range(len(ids)), key=lambda row: -probability.get(ids[row], 0.0))[:_MOST_EFFECTS]
    return tuple(ids[row] for row in order), likeness[np.ix_(order, order)]


def _advice(advice: Advice) -> str:
    cycles = "" if advice.cycles is None else f", {counted(advice.cycles, 'cycle')} for odds of 20 to 1"
    experiment = advice.experiment[:1].upper() + advice.experiment[1:]
    return f"{experiment} ({advice.minutes} min{cycles}): tells apart {listed(advice.splits)}."
